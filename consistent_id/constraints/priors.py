"""What to assume of parameters that are not identifiable from the data."""

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from consistent_id.errors import ProblemError

Distance = Literal["pullback", "euclidean", "entropic"]
"""How far a robot is from the nominal one; see `distances`."""


INSIDE = 0.1
"""Share of its nominal body that every link contains, where the data allow it: no
thinner than a third of the drawing."""


@dataclass(frozen=True, slots=True)
class PointToSet:
    """Among all estimates that fit nearly best, take the one nearest to the nominal.

    Parameters
    ----------
    slack : float, optional
        Relative increase of the weighted misfit norm that counts as "nearly best".  By
        default what one standard error costs, of all that the data determine together
        (``chi^2 <= 1``, noise correlated as the residuals are).
    distance : {"pullback", "euclidean", "entropic"}
        See `distances`.
    inside : float
        Share of its nominal body that every link is to contain, so that it stays off
        the boundary of physical consistency; zero for none.  It is reduced to what
        moves all that the data determine by a quarter of a standard error, and the
        slack by what it takes.

    Notes
    -----
    Where a link has no nominal body, a ball of its typical mass and length stands in
    (`reference_bodies`); friction and drive terms are drawn to zero.
    """

    slack: float | None = None
    distance: Distance = "pullback"
    inside: float = INSIDE

    def __post_init__(self) -> None:
        if self.slack is not None and not 0.0 < self.slack < 1.0:
            raise ProblemError(f"slack is {self.slack}, expected between 0 and 1")
        _require_known(self.distance, self.inside)

    def relative_slack(self, error: float, least: float) -> float:
        """Return the slack, given the squared misfit of one standard error.

        Parameters
        ----------
        error : float
            Squared misfit that a move by one standard error adds.
        least : float
            Squared misfit of the best fit.
        """
        return misfit_increase(error, least) if self.slack is None else self.slack


@dataclass(frozen=True, slots=True)
class Penalty:
    """Weigh the distance to nominal against the misfit.

    ``minimise ||R x - z||^2 + weight r^2 distance(x)^2`` over the constraints, with
    ``r`` the residual norm of least squares: with a weight of one, a distance of one
    costs as much as all that least squares leaves unexplained.

    Parameters
    ----------
    weight : float
        Positive; `cross_validated` chooses it from the training data.
    distance : {"pullback", "euclidean", "entropic"}
    inside : float
        See `PointToSet`.
    """

    weight: float
    distance: Distance = "pullback"
    inside: float = INSIDE

    def __post_init__(self) -> None:
        if not 0.0 < self.weight < np.inf:
            raise ProblemError(f"weight is {self.weight}, expected a positive number")
        _require_known(self.distance, self.inside)


Prior = PointToSet | Penalty


def misfit_increase(added: float, least: float) -> float:
    """Return by what share a misfit norm grows when its square grows from `least`."""
    return float(np.expm1(0.5 * np.log1p(added / least)))


def _require_known(distance: str, inside: float) -> None:
    if not 0.0 <= inside < 1.0:
        raise ProblemError(f"inside is {inside}, expected from 0 to less than 1")
    if distance not in get_args(Distance):
        known = ", ".join(get_args(Distance))
        raise ProblemError(f"distance is {distance!r}, expected one of {known}")

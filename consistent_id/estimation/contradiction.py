"""Constraints that exclude each other, and what giving up one of them would cost."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from consistent_id._support.threads import single_threaded
from consistent_id.constraints import Constraint
from consistent_id.constraints.cones.certificate import (
    FEASIBILITY_TOLERANCE,
    solve_certified,
)
from consistent_id.constraints.cones.feasibility import irreducible_conflict
from consistent_id.constraints.cones.least_norm import LeastNorm
from consistent_id.errors import SolverError
from consistent_id.estimation.scaled_fit import REFERENCE, ScaledFit, scaled_fit
from consistent_id.regression.base import BaseParameters, base_parameters
from consistent_id.regression.regression import Regression
from consistent_id.regression.regressor import TorqueModel


@dataclass(frozen=True, slots=True)
class Resolution:
    """The best fit without one of the contradicting constraints.

    Parameters
    ----------
    label : str
        What is given up.
    rms : float, [N m or N], or in units of the joints' `sigma`
        Root-mean-square residual of the best fit without it; infinite where more would
        have to be given up, nan where it could not be computed.
    values : dict of str to float
        What the parameters that it ties would then be.
    """

    label: str
    rms: float
    values: dict[str, float]

    @property
    def sentence(self) -> str:
        """The resolution in words."""
        if np.isnan(self.rms):
            return f"The best fit without ({self.label}) could not be computed"
        if np.isinf(self.rms):
            return f"Without ({self.label}) others still contradict each other"
        then = ", ".join(f"{name} = {value:.4g}" for name, value in self.values.items())
        return f"Without ({self.label}) the best fit leaves {self.rms:.4g} RMS" + (
            f", with {then}" if then else ""
        )


@dataclass(frozen=True, slots=True)
class Contradiction:
    """An irreducible set of constraints without a common point.

    Parameters
    ----------
    resolutions : tuple of Resolution
        One for each member, that with the best fit first.
    unconstrained_rms : float
        Root-mean-square residual of least squares.
    """

    resolutions: tuple[Resolution, ...]
    unconstrained_rms: float

    @property
    def sentence(self) -> str:
        """The contradiction in words."""
        members = "; ".join(r.label for r in self.resolutions)
        ways = ". ".join(r.sentence for r in self.resolutions)
        return (
            f"no parameters satisfy these together: {members}. {ways}. "
            f"Least squares leaves {self.unconstrained_rms:.4g} RMS. Check the "
            "datasheet values and the margin, or loosen one"
        )


@single_threaded
def contradiction(
    model: TorqueModel,
    regression: Regression,
    constraints: Sequence[Constraint],
    *,
    base: BaseParameters | None = None,
) -> Contradiction | None:
    """Find which constraints exclude each other, and what each costs in torque.

    Returns
    -------
    Contradiction or None
        None if no contradiction is proven.

    Raises
    ------
    ProblemError, NotExcitedError
        If the regression does not fit the model, or is empty.
    """
    base = base_parameters(model) if base is None else base
    scaled = scaled_fit(model, regression, base, constraints)
    members = irreducible_conflict(scaled.domain)
    if not members:
        return None
    to_rms = scaled.size / np.sqrt(sum(regression.counts))
    found = [_without(scaled, m, to_rms, model.layout.names) for m in members]
    return Contradiction(
        tuple(sorted(found, key=lambda r: np.nan_to_num(r.rms, nan=np.inf))),
        scaled.residual * float(to_rms),
    )


def _without(
    scaled: ScaledFit,
    member: int,
    to_rms: float,
    names: tuple[str, ...],
) -> Resolution:
    label, fewer = scaled.domain.labels[member], scaled.domain.without(member)
    problem = LeastNorm(scaled.M, scaled.z, fewer)
    try:
        u = solve_certified(problem, scaled.centre, reference=REFERENCE)[0].u
        empty = fewer.violation(u) > FEASIBILITY_TOLERANCE
    except SolverError:
        empty = True
    if empty:
        others = irreducible_conflict(fewer)
        return Resolution(label, np.inf if others else np.nan, {})
    rms = float(np.sqrt(scaled.excess(u) + scaled.residual**2) * to_rms)
    dropped = scaled.domain.only([member])
    tied = np.flatnonzero(np.vstack([dropped.A_eq, dropped.A_in]).any(axis=0))
    return Resolution(label, rms, {names[i]: float((u * scaled.unit)[i]) for i in tied})

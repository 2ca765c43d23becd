"""Links that are alike, mirrored, or symmetric in themselves; and total mass."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from consistent_id.constraints.cones.sets import ConicSet
from consistent_id.constraints.rows import equalities, known_links, unit_row
from consistent_id.errors import ProblemError
from consistent_id.regression.regressor import TorqueModel
from consistent_id.robot.inertia import INERTIAL_NAMES

Axis = Literal["x", "y", "z"]


@dataclass(frozen=True, slots=True)
class EqualLinks:
    """Two links with equal parameters in their own frames, or mirror images.

    Parameters
    ----------
    first, second : str
    mirror : {"x", "y", "z"}, optional
        Axis that the mirror turns round: ``x`` for mirroring in the plane ``x = 0``.
    """

    first: str
    second: str
    mirror: Axis | None = None

    def lower(self, model: TorqueModel) -> ConicSet:
        """Return ten equalities."""
        known_links({self.first: None, self.second: None}, model, "equal links")
        require_axes([] if self.mirror is None else [self.mirror], "mirror")
        if self.first == self.second:
            raise ProblemError(f"equal links: {self.first!r} is named twice")
        rows, labels = [], []
        for name in INERTIAL_NAMES:
            sign = -1.0 if self.mirror and name.count(self.mirror) % 2 else 1.0
            mine, other = (f"{link}.{name}" for link in (self.first, self.second))
            rows.append(
                unit_row(model.layout, mine) - sign * unit_row(model.layout, other)
            )
            labels.append(f"{mine} = {'-' if sign < 0 else ''}{other}")
        return equalities(rows, [0.0] * len(rows), labels, model)


@dataclass(frozen=True, slots=True)
class SymmetricLink:
    """A link symmetric in planes through its frame's origin.

    Parameters
    ----------
    link : str
    planes : sequence of {"x", "y", "z"}
        Normals of the planes; ``"y"`` makes ``hy``, ``Ixy`` and ``Iyz`` zero.
    """

    link: str
    planes: Sequence[Axis]

    def lower(self, model: TorqueModel) -> ConicSet:
        """Return zero for every parameter that is odd in a plane's normal."""
        known_links({self.link: None}, model, "symmetric link")
        require_axes(self.planes, "planes")
        odd = [
            f"{self.link}.{name}"
            for name in INERTIAL_NAMES
            if any(name.count(normal) % 2 for normal in self.planes)
        ]
        rows = [unit_row(model.layout, name) for name in odd]
        labels = [f"{name} = 0 by symmetry" for name in odd]
        return equalities(rows, [0.0] * len(rows), labels, model)


@dataclass(frozen=True, slots=True)
class TotalMass:
    """The moving links' masses add up to a value, or lie between bounds, [kg].

    Parameters
    ----------
    lower_bound, upper_bound : float
        Equal for a known total.
    links : sequence of str, optional
        By default all moving links.
    """

    lower_bound: float
    upper_bound: float
    links: Sequence[str] | None = None

    def lower(self, model: TorqueModel) -> ConicSet:
        """Return one equality or two inequalities."""
        links = model.layout.links if self.links is None else tuple(self.links)
        known_links(dict.fromkeys(links), model, "total mass")
        if not links or len(set(links)) != len(links):
            raise ProblemError(f"total mass of links {links}: expected distinct names")
        low, high = self.lower_bound, self.upper_bound
        if not 0.0 <= low <= high < np.inf:
            raise ProblemError(
                f"total mass between {low:g} and {high:g} kg, expected 0 <= lower <= "
                "upper"
            )
        row = sum(unit_row(model.layout, f"{link}.m") for link in links)
        row = np.asarray(row)[None]
        if low == high:
            return ConicSet.equal(row, np.array([low]), [f"total mass = {low:g} kg"])
        labels = [f"total mass >= {low:g} kg", f"total mass <= {high:g} kg"]
        return ConicSet.at_most(np.vstack([-row, row]), np.array([-low, high]), labels)


def require_axes(axes: Sequence[str], what: str) -> None:
    """Refuse anything but ``x``, ``y`` and ``z``."""
    wrong = [axis for axis in axes if axis not in ("x", "y", "z")]
    if wrong:
        raise ProblemError(f"{what}: {wrong} are not among x, y and z")

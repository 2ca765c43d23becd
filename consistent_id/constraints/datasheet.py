"""Physical consistency, and what a datasheet or the robot's file says of links."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from consistent_id.constraints.cones.sets import ConicSet, SemidefiniteBlock
from consistent_id.constraints.rows import (
    equalities,
    fixed_values,
    inequalities,
    known_links,
    offset_row,
    stated,
    unit_row,
)
from consistent_id.errors import ProblemError
from consistent_id.regression.regressor import TorqueModel
from consistent_id.robot.inertia import (
    INERTIAL_NAMES,
    PSEUDO_INERTIA_BASIS,
    pseudo_inertia,
)
from consistent_id.robot.parameters import require_known
from consistent_id.robot.scaling import link_scales, reference_bodies


@dataclass(frozen=True, slots=True)
class PhysicalConsistency:
    """Pseudo-inertias of all links positive semidefinite [Wensing2018]_.

    Parameters
    ----------
    margin : float
        Least eigenvalue of each pseudo-inertia after division by the link's typical
        mass and length (`link_scales`); a pure number.  The default keeps links
        strictly consistent, as simulators demand.
    share : float
        Least share of its nominal body that each link contains: what is beside it is
        physically consistent too.  See `reference_bodies`.
    """

    margin: float = 1e-6
    share: float = 0.0

    def __post_init__(self) -> None:
        for name, value in (("margin", self.margin), ("share", self.share)):
            if not 0.0 <= value < 1.0:
                raise ProblemError(
                    f"{name} is {value}, expected a number from 0 to less than 1"
                )

    def lower(self, model: TorqueModel) -> ConicSet:
        """Return one block ``J - margin D - share J_nominal`` per link."""
        layout = model.layout
        bodies = reference_bodies(model.robot)
        blocks = []
        for k, root in enumerate(link_scales(model.robot).root):
            coefficients = np.zeros((len(layout), 4, 4))
            coefficients[layout.link_slice(k)] = PSEUDO_INERTIA_BASIS
            contained = self.share * pseudo_inertia(bodies[k])
            least = -self.margin * np.diag(root**2) - contained
            blocks.append(SemidefiniteBlock(layout.links[k], coefficients, least, root))
        return ConicSet.semidefinite(blocks, len(layout))


@dataclass(frozen=True, slots=True)
class FixedBodies:
    """Bodies as the robot's file has them.

    Parameters
    ----------
    links : sequence of str
        By default all; the data then determine the drives alone.
    """

    links: Sequence[str] = ()

    def lower(self, model: TorqueModel) -> ConicSet:
        """Return ten equalities per link.

        Raises
        ------
        ProblemError
            If a link's nominal parameters are unknown.
        """
        robot = model.robot
        require_known(self.links, robot.link_names, "known bodies: no link")
        wanted = [n for n in robot.link_names if not self.links or n in self.links]
        bodies = {link.name: link.nominal for link in robot.links}
        values: dict[str, float] = {}
        for name in wanted:
            body = bodies[name]
            if body is None:
                raise ProblemError(
                    f"the body of {name!r} is to be as in the file of {robot.name!r}, "
                    "which states no inertia of it; identify it (bodies, known_links)"
                )
            keys = (f"{name}.{entry}" for entry in INERTIAL_NAMES)
            values |= dict(zip(keys, body.vector.tolist(), strict=True))
        return fixed_values(values, model.layout)


@dataclass(frozen=True, slots=True)
class FixedMasses:
    """Masses known exactly.

    Parameters
    ----------
    masses : mapping of str to float, optional, [kg]
        By link; by default the datasheet's, for every link that has one.
    """

    masses: Mapping[str, float] | None = None

    def lower(self, model: TorqueModel) -> ConicSet:
        """Return ``m_k = value``."""
        masses = self.masses
        if masses is None:
            masses = stated(model, "mass", "FixedMasses")
        known_links(masses, model, "fixed mass")
        return fixed_values(
            {f"{link}.m": mass for link, mass in masses.items()}, model.layout
        )


@dataclass(frozen=True, slots=True)
class MassBounds:
    """Masses between bounds [kg]; by default those of the datasheet."""

    bounds: Mapping[str, tuple[float, float]] | None = None

    def lower(self, model: TorqueModel) -> ConicSet:
        """Return ``lower <= m_k <= upper``."""
        bounds = self.bounds
        if bounds is None:
            bounds = stated(model, "mass_bounds", "MassBounds")
        known_links(bounds, model, "mass bounds")
        rows, limits, labels = [], [], []
        for link, (low, high) in bounds.items():
            if not low <= high:
                raise ProblemError(
                    f"mass bounds of {link}: {low:g} kg is not below {high:g} kg"
                )
            row = unit_row(model.layout, f"{link}.m")
            rows += [-row, row]
            limits += [-low, high]
            labels += [f"{link}: mass >= {low:g} kg", f"{link}: mass <= {high:g} kg"]
        return inequalities(rows, limits, labels, model)


@dataclass(frozen=True, slots=True)
class FixedCentresOfMass:
    """Centres of mass known exactly: ``h = m c``.

    Parameters
    ----------
    centres : mapping of str to sequence of 3 floats, optional, [m]
        By link, in its frame; by default the datasheet's.
    """

    centres: Mapping[str, Sequence[float]] | None = None

    def lower(self, model: TorqueModel) -> ConicSet:
        """Return ``h_k - c m_k = 0``, three rows per link."""
        centres = self.centres
        if centres is None:
            centres = stated(model, "com", "FixedCentresOfMass")
        known_links(centres, model, "fixed centre of mass")
        rows, labels = [], []
        for link, com in centres.items():
            if len(com) != 3:
                raise ProblemError(
                    f"centre of mass of {link}: {com}, expected 3 values"
                )
            for axis, c in zip("xyz", com, strict=True):
                rows.append(offset_row(model.layout, link, axis, c))
                labels.append(f"{link}: centre of mass {axis} = {c:g} m")
        return equalities(rows, [0.0] * len(rows), labels, model)


@dataclass(frozen=True, slots=True)
class CentreOfMassBoxes:
    """Centres of mass inside boxes: ``lower m <= h <= upper m``.

    Parameters
    ----------
    boxes : mapping of str to (lower, upper), optional, [m]
        By link, corners of three numbers each; by default the datasheet's.
    """

    boxes: Mapping[str, tuple[Sequence[float], Sequence[float]]] | None = None

    def lower(self, model: TorqueModel) -> ConicSet:
        """Return six rows per link, linear because masses are not negative."""
        boxes = self.boxes
        if boxes is None:
            boxes = stated(model, "com_box", "CentreOfMassBoxes")
        known_links(boxes, model, "centre-of-mass box")
        rows, labels = [], []
        for link, (low, high) in boxes.items():
            for axis, a, b in zip("xyz", low, high, strict=True):
                rows.append(-offset_row(model.layout, link, axis, a))
                rows.append(offset_row(model.layout, link, axis, b))
                labels.append(f"{link}: centre of mass {axis} >= {a:g} m")
                labels.append(f"{link}: centre of mass {axis} <= {b:g} m")
        return inequalities(rows, [0.0] * len(rows), labels, model)

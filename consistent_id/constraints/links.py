"""Constraints on links: physical consistency, datasheets, shapes, symmetry, total mass.

A density on a convex shape moves the pseudo-inertia into a smaller cone: for every
quadratic ``q`` that is not negative on the shape, ``integral q rho >= 0`` is linear in
``J`` [Wensing2018]_.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import isfinite
from typing import Literal

import numpy as np

from consistent_id._support.arrays import Array, Vector
from consistent_id._support.tables import brief
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
from consistent_id.robot.solids import Ellipsoid, Polytope

_FACETS = 40  # most facets of a polytope whose pairs of facets become constraints

Axis = Literal["x", "y", "z"]


@brief
@dataclass(frozen=True, slots=True)
class PhysicalConsistency:
    """Pseudo-inertias of all links positive semidefinite [Wensing2018]_.

    Parameters
    ----------
    margin : float
        Least eigenvalue of each pseudo-inertia after division by the link's typical
        mass and length (`link_scales`); a pure number.  The default keeps links
        strictly consistent, as simulators require.
    share : float
        Least share of its nominal body that each link contains: the remainder is
        physically consistent, too.  See `reference_bodies`.

    Examples
    --------
    >>> import consistent_id as ci
    >>> arm = ci.from_modified_dh("arm", [ci.DHRow(-np.pi / 2, 0.0)])
    >>> cone = ci.PhysicalConsistency(margin=1e-3).lower(ci.TorqueModel(arm))
    >>> [block.label for block in cone.blocks]
    ['link1']
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


@brief
@dataclass(frozen=True, slots=True)
class FixedBodies:
    """Bodies as in the robot's file.

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
                    f"the body of {name!r} is stated to be as in the file of "
                    f"{robot.name!r}, but the file has no inertia of it; identify it "
                    f"(bodies, known_links)"
                )
            keys = (f"{name}.{entry}" for entry in INERTIAL_NAMES)
            values |= dict(zip(keys, body.vector.tolist(), strict=True))
        return fixed_values(values, model.layout)


@brief
@dataclass(frozen=True, slots=True)
class FixedMasses:
    """Masses known exactly.

    Parameters
    ----------
    masses : mapping of str to float, optional, [kg]
        By link; by default the datasheet's, for every link that has one.

    Examples
    --------
    >>> import consistent_id as ci
    >>> arm = ci.from_modified_dh("arm", [ci.DHRow(-np.pi / 2, 0.0)])
    >>> ci.FixedMasses({"link1": 2.0}).lower(ci.TorqueModel(arm)).labels
    ('link1.m = 2 kg',)
    """

    masses: Mapping[str, float] | None = None

    def __post_init__(self) -> None:
        for link, mass in (self.masses or {}).items():
            if not (isfinite(mass) and mass >= 0.0):
                raise ProblemError(
                    f"fixed mass of {link}: {mass:g} kg, expected a finite one that is "
                    "not negative"
                )

    def lower(self, model: TorqueModel) -> ConicSet:
        """Return ``m_k = value``."""
        masses = self.masses
        if masses is None:
            masses = stated(model, "mass", "FixedMasses")
        known_links(masses, model, "fixed mass")
        return fixed_values(
            {f"{link}.m": mass for link, mass in masses.items()}, model.layout
        )


@brief
@dataclass(frozen=True, slots=True)
class MassBounds:
    """Masses between bounds [kg]; by default those of the datasheet.

    Examples
    --------
    >>> import consistent_id as ci
    >>> arm = ci.from_modified_dh("arm", [ci.DHRow(-np.pi / 2, 0.0)])
    >>> ci.MassBounds({"link1": (1.0, 3.0)}).lower(ci.TorqueModel(arm)).labels
    ('link1: mass >= 1 kg', 'link1: mass <= 3 kg')
    """

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
            if high < 0.0:
                raise ProblemError(
                    f"mass bounds of {link}: at most {high:g} kg, which no body has"
                )
            row = unit_row(model.layout, f"{link}.m")
            rows += [-row, row]
            limits += [-low, high]
            labels += [f"{link}: mass >= {low:g} kg", f"{link}: mass <= {high:g} kg"]
        return inequalities(rows, limits, labels, model)


@brief
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


@brief
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


@brief
@dataclass(frozen=True, slots=True, eq=False)
class CentreOfMassIn:
    """A link's centre of mass lies in an ellipsoid or a polytope.

    Parameters
    ----------
    link : str
    shape : Ellipsoid or Polytope
        In the link's frame, [m].
    """

    link: str
    shape: Ellipsoid | Polytope

    def lower(self, model: TorqueModel) -> ConicSet:
        """Return a second-order cone as a block, or a row per facet."""
        known_links({self.link: None}, model, "centre of mass in a shape")
        k = model.layout.links.index(self.link)
        size = len(model.layout)
        if isinstance(self.shape, Polytope):
            rows = np.zeros((len(self.shape.normals), size))
            start = model.layout.link_slice(k).start
            rows[:, start + 1 : start + 4] = self.shape.normals
            rows[:, start] = -self.shape.offsets
            labels = [
                f"{self.link}: centre of mass, facet {i}" for i in range(len(rows))
            ]
            return ConicSet.at_most(rows, np.zeros(len(rows)), labels)
        # ||U (h - m c)|| <= m  as  [[m 1, U (h - m c)], [., m]] >= 0.
        U, c = self.shape.unit_map, self.shape.centre
        coefficients = np.zeros((size, 4, 4))
        m, *h = range(model.layout.link_slice(k).start, model.layout.link_slice(k).stop)
        coefficients[m] = np.eye(4)
        coefficients[m, :3, 3] = coefficients[m, 3, :3] = -U @ c
        for axis in range(3):
            coefficients[h[axis], :3, 3] = coefficients[h[axis], 3, :3] = U[:, axis]
        scale = np.full(4, np.sqrt(link_scales(model.robot).mass[k]))
        label = f"{self.link}: centre of mass in the ellipsoid"
        block = SemidefiniteBlock(label, coefficients, np.zeros((4, 4)), scale)
        return ConicSet.semidefinite([block], size)


@brief
@dataclass(frozen=True, slots=True, eq=False)
class DensityOn:
    """A link's material lies in an ellipsoid or a polytope.

    For an ellipsoid ``tr(J Q) >= 0``, which with ``J >= 0`` is exact: a density exists
    iff it holds.  For a polytope ``l_i J l_j >= 0`` for all pairs of facets, which is
    necessary.

    Parameters
    ----------
    link : str
    shape : Ellipsoid or Polytope
        In the link's frame, [m].
    """

    link: str
    shape: Ellipsoid | Polytope

    def lower(self, model: TorqueModel) -> ConicSet:
        """Return one row, or a row per pair of facets."""
        known_links({self.link: None}, model, "density on a shape")
        layout = model.layout
        if isinstance(self.shape, Ellipsoid):
            forms = [self.shape.quadratic]
            labels = [f"{self.link}: material in the ellipsoid"]
        else:
            if len(self.shape.normals) > _FACETS:
                raise ProblemError(
                    f"density of {self.link!r}: the polytope has "
                    f"{len(self.shape.normals)} facets, and each pair makes a "
                    f"constraint; at most {_FACETS} are allowed. Take a box, "
                    "Ellipsoid.around its vertices, or CentreOfMassIn"
                )
            lines, pairs = self.shape.rows, _pairs(len(self.shape.rows))
            forms = [_symmetric(lines[i], lines[j]) for i, j in pairs]
            labels = [f"{self.link}: material within facets {i}, {j}" for i, j in pairs]
        rows = []
        for form in forms:
            row = np.zeros(len(layout))
            inertial = np.tensordot(PSEUDO_INERTIA_BASIS, form, axes=2)
            row[layout.link_slice(layout.links.index(self.link))] = -inertial
            rows.append(row)
        return inequalities(rows, [0.0] * len(rows), labels, model)


def _pairs(count: int) -> Sequence[tuple[int, int]]:
    return [(i, j) for i in range(count) for j in range(i, count)]


def _symmetric(a: Vector, b: Vector) -> Array:
    return (np.outer(a, b) + np.outer(b, a)) / 2


@brief
@dataclass(frozen=True, slots=True)
class EqualLinks:
    """Two links with equal parameters in their own frames, or mirror images.

    Parameters
    ----------
    first, second : str
    mirror : {"x", "y", "z"}, optional
        Axis that the mirror reverses: ``x`` for mirroring in the plane ``x = 0``.
    """

    first: str
    second: str
    mirror: Axis | None = None

    def lower(self, model: TorqueModel) -> ConicSet:
        """Return ten equalities."""
        known_links({self.first: None, self.second: None}, model, "equal links")
        _require_axes([] if self.mirror is None else [self.mirror], "mirror")
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


@brief
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
        _require_axes(self.planes, "planes")
        odd = [
            f"{self.link}.{name}"
            for name in INERTIAL_NAMES
            if any(name.count(normal) % 2 for normal in self.planes)
        ]
        rows = [unit_row(model.layout, name) for name in odd]
        labels = [f"{name} = 0 by symmetry" for name in odd]
        return equalities(rows, [0.0] * len(rows), labels, model)


@brief
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


def _require_axes(axes: Sequence[str], what: str) -> None:
    """Refuse all names except ``x``, ``y`` and ``z``."""
    wrong = [axis for axis in axes if axis not in ("x", "y", "z")]
    if wrong:
        raise ProblemError(f"{what}: {wrong} are not among x, y and z")

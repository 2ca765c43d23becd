"""Where a link's material can be: centre of mass and density within a shape.

A density on a convex shape moves the pseudo-inertia into a smaller cone: for every
quadratic ``q`` that is not negative on the shape, ``integral q rho >= 0`` is linear in
``J`` [Wensing2018]_.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from consistent_id._arrays import Array, Matrix, Vector, frozen
from consistent_id.conic import ConicSet, SemidefiniteBlock
from consistent_id.constraints._rows import inequalities, known_links
from consistent_id.errors import ProblemError
from consistent_id.inertia import PSEUDO_INERTIA_BASIS
from consistent_id.regressor import TorqueModel
from consistent_id.scaling import link_scales


@dataclass(frozen=True, slots=True, eq=False)
class Ellipsoid:
    """``{x : ||axes^-1 rotation^T (x - centre)|| <= 1}`` in a link's frame.

    Parameters
    ----------
    centre : array_like, shape (3,), [m]
    semi_axes : array_like, shape (3,), [m]
    rotation : array_like, shape (3, 3), optional
        Directions of the axes, as columns.
    """

    centre: Vector
    semi_axes: Vector
    rotation: Matrix | None = None

    def __post_init__(self) -> None:
        centre = frozen(self.centre, (3,), "ellipsoid centre")
        axes = frozen(self.semi_axes, (3,), "ellipsoid semi_axes")
        if not (axes > 0.0).all():
            raise ProblemError(f"ellipsoid semi_axes are {axes}, expected positive")
        rotation = np.eye(3) if self.rotation is None else self.rotation
        rotation = frozen(rotation, (3, 3), "ellipsoid rotation")
        if abs(rotation.T @ rotation - np.eye(3)).max() > 1e-9:
            raise ProblemError("ellipsoid rotation is not orthonormal")
        object.__setattr__(self, "centre", centre)
        object.__setattr__(self, "semi_axes", axes)
        object.__setattr__(self, "rotation", rotation)

    @property
    def unit_map(self) -> Matrix:
        """``U`` with ``||U (x - centre)|| <= 1`` inside, shape (3, 3)."""
        return np.asarray(np.asarray(self.rotation).T / self.semi_axes[:, None])

    @property
    def quadratic(self) -> Matrix:
        """``Q`` with ``[x, 1] Q [x, 1]^T = 1 - ||U (x - centre)||^2``, shape (4, 4)."""
        V = np.column_stack([self.unit_map, -self.unit_map @ self.centre])
        return np.asarray(np.diag([0.0, 0.0, 0.0, 1.0]) - V.T @ V)


@dataclass(frozen=True, slots=True, eq=False)
class Polytope:
    """``{x : normals x <= offsets}`` in a link's frame, bounded and not empty.

    Parameters
    ----------
    normals : array_like, shape (facets, 3)
    offsets : array_like, shape (facets,), [m] for unit normals
    """

    normals: Matrix
    offsets: Vector

    def __post_init__(self) -> None:
        normals = frozen(self.normals, (None, 3), "polytope normals")
        offsets = frozen(self.offsets, (len(normals),), "polytope offsets")
        lengths = np.linalg.norm(normals, axis=1)
        if not (lengths > 0.0).all():
            raise ProblemError("polytope: a facet's normal is zero")
        object.__setattr__(
            self, "normals", frozen(normals / lengths[:, None], (None, 3), "normals")
        )
        object.__setattr__(self, "offsets", frozen(offsets / lengths, (None,), "b"))

    @classmethod
    def box(cls, lower: ArrayLike, upper: ArrayLike) -> Self:
        """Return the box between two corners [m]."""
        low, high = frozen(lower, (3,), "box lower"), frozen(upper, (3,), "box upper")
        if not (low < high).all():
            raise ProblemError(f"box: lower {low} is not below upper {high}")
        normals = np.vstack([np.eye(3), -np.eye(3)])
        return cls(normals, np.concatenate([high, -low]))

    @classmethod
    def hull(cls, points: ArrayLike) -> Self:
        """Return the convex hull of points, such as a mesh's vertices, [m].

        Raises
        ------
        ProblemError
            If the points lie in a plane.
        """
        from scipy.spatial import ConvexHull, QhullError

        vertices = frozen(points, (None, 3), "hull points")
        try:
            facets = np.unique(ConvexHull(vertices).equations.round(12), axis=0)
        except (QhullError, ValueError):
            raise ProblemError(
                f"hull of {len(vertices)} points: they lie in a plane, expected four "
                "or more that do not"
            ) from None
        return cls(facets[:, :3], -facets[:, 3])

    @property
    def rows(self) -> Matrix:
        """``l_i`` with ``l_i [x, 1] >= 0`` inside, shape (facets, 4)."""
        return np.column_stack([-self.normals, self.offsets])


@dataclass(frozen=True, slots=True, eq=False)
class CentreOfMassIn:
    """A link's centre of mass lies in an ellipsoid or a polytope."""

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


@dataclass(frozen=True, slots=True, eq=False)
class DensityOn:
    """A link's material lies in an ellipsoid or a polytope.

    For an ellipsoid ``tr(J Q) >= 0``, which with ``J >= 0`` is exact: a density exists
    iff it holds.  For a polytope ``l_i J l_j >= 0`` for all pairs of facets, which is
    necessary.
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

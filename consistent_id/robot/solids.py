"""Solids in a link's frame: ellipsoids, convex polytopes, hulls of meshes.

A robot's file draws shapes of links, and may state nominal drives beside them.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from consistent_id._support.arrays import Array, Matrix, Vector, freeze, frozen
from consistent_id._support.tables import brief
from consistent_id.errors import ProblemError

_DISTINCT = 3  # values of joints that differ; placeholders are alike
_DIGITS = 2  # of a value that was measured; placeholders are 10, 2 or 0.1


@dataclass(frozen=True, slots=True)
class DrawnDrive:
    """A joint's nominal friction and rotor inertia.

    Parameters
    ----------
    viscous : float, [N m s/rad or N s/m]
    coulomb : float, [N m or N]
    rotor_inertia : float, [kg m^2 or kg]
        At the joint.
    """

    viscous: float = 0.0
    coulomb: float = 0.0
    rotor_inertia: float = 0.0


@dataclass(frozen=True, slots=True)
class DrawnParts:
    """Shapes and drives of a robot's file.

    Parameters
    ----------
    reach : mapping of str to float, [m]
        Distance from a link's joint to the farthest point of its shapes, or more; only
        of links all of whose shapes are known, and whose masses all have shapes.
    drives : mapping of str to DrawnDrive
        Drives of joints for which the file has any.
    fault : str
        Why the file cannot be read; empty if it can be, or if there is none.
    """

    reach: Mapping[str, float] = field(default_factory=dict)
    drives: Mapping[str, DrawnDrive] = field(default_factory=dict)
    fault: str = ""

    @property
    def friction_known(self) -> bool:
        """Whether friction is more than a placeholder."""
        return _measured([(d.viscous, d.coulomb) for d in self.drives.values()])

    @property
    def rotors_known(self) -> bool:
        """Whether rotor inertia is more than a placeholder."""
        return _measured([(d.rotor_inertia,) for d in self.drives.values()])


def _measured(values: Sequence[tuple[float, ...]]) -> bool:
    """Return whether values of joints were measured: they differ, and are not round."""
    stated = [each for each in values if max(each) > 0.0]
    precise = [each for each in stated if any(_digits(v) >= _DIGITS for v in each)]
    return len(set(stated)) >= _DISTINCT and 2 * len(precise) >= len(stated)


def _digits(value: float) -> int:
    """Return the number of significant digits with which a value is written."""
    return len(f"{value:.6e}".partition("e")[0].replace(".", "").rstrip("0"))


_STEPS = 20_000  # of the search for the smallest ellipsoid
_ROUND = 1e-7  # excess of a point's squared distance at which it ends


@brief
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
        freeze(self, centre=centre, semi_axes=axes, rotation=rotation)

    @classmethod
    def around(cls, points: ArrayLike) -> Self:
        """Return the smallest ellipsoid around points, such as a mesh's vertices.

        It has the least volume, by Khachiyan's algorithm with steps towards the
        farthest and away from the nearest weighted point of the hull [Todd2007]_; it
        contains every point.

        Raises
        ------
        ProblemError
            If the points lie in a plane.
        """
        vertices = _hull_vertices(points)
        n, k = vertices.shape
        lifted = np.column_stack([vertices, np.ones(n)])
        weight = np.full(n, 1.0 / n)
        for _ in range(_STEPS):
            spread = lifted.T @ (weight[:, None] * lifted)
            far = np.einsum("ia,ab,ib->i", lifted, np.linalg.inv(spread), lifted)
            farthest = int(far.argmax())
            nearest = int(np.where(weight > 0.0, far, np.inf).argmin())
            if max(far[farthest] - k - 1, k + 1 - far[nearest]) <= _ROUND:
                break
            towards = far[farthest] - k - 1 >= k + 1 - far[nearest]
            i = farthest if towards else nearest
            step = (far[i] - k - 1) / ((k + 1) * (far[i] - 1))
            step = max(step, -weight[i] / (1.0 - weight[i]))
            weight *= 1.0 - step
            weight[i] = max(weight[i] + step, 0.0)
        centre = weight @ vertices
        offset = vertices - centre
        shape = np.linalg.inv(k * (offset.T @ (weight[:, None] * offset)))
        # Swollen until the farthest point is inside.
        shape = shape / np.einsum("ia,ab,ib->i", offset, shape, offset).max()
        values, axes = np.linalg.eigh(shape)
        return cls(centre, 1.0 / np.sqrt(values), axes)

    @classmethod
    def from_quadratic(cls, quadratic: ArrayLike) -> Self:
        """Build from ``Q``, shape (4, 4), with ``[x, 1] Q [x, 1]^T >= 0`` inside.

        Raises
        ------
        ProblemError
            If that is no bounded body.

        Examples
        --------
        >>> ball = Ellipsoid.from_quadratic(np.diag([-4.0, -4.0, -4.0, 1.0]))
        >>> ball.semi_axes.tolist()
        [0.5, 0.5, 0.5]
        """
        Q = frozen(quadratic, (4, 4), "ellipsoid quadratic")
        values, axes = np.linalg.eigh(-(Q[:3, :3] + Q[:3, :3].T) / 2)
        if values[0] <= 0.0:
            raise ProblemError(
                f"ellipsoid: curvatures of the quadratic are {-values}, expected "
                "negative ones; with the opposite sign it is what lies outside"
            )
        axes[:, 0] *= np.sign(np.linalg.det(axes))
        half = (Q[:3, 3] + Q[3, :3]) / 2
        centre = axes @ ((axes.T @ half) / values)
        top = float(Q[3, 3] + half @ centre)
        if top <= 0.0:
            raise ProblemError("ellipsoid: the quadratic is positive nowhere")
        return cls(centre, np.sqrt(top / values), axes)

    @property
    def unit_map(self) -> Matrix:
        """``U`` with ``||U (x - centre)|| <= 1`` inside, shape (3, 3)."""
        return np.asarray(np.asarray(self.rotation).T / self.semi_axes[:, None])

    @property
    def quadratic(self) -> Matrix:
        """``Q`` with ``[x, 1] Q [x, 1]^T = 1 - ||U (x - centre)||^2``, shape (4, 4)."""
        V = np.column_stack([self.unit_map, -self.unit_map @ self.centre])
        return np.asarray(np.diag([0.0, 0.0, 0.0, 1.0]) - V.T @ V)


@brief
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
        freeze(
            self,
            normals=frozen(normals / lengths[:, None], (None, 3), "normals"),
            offsets=frozen(offsets / lengths, (None,), "b"),
        )
        self._require_body()

    def _require_body(self) -> None:
        """Refuse what has no inside, or no end."""
        from scipy.optimize import linprog

        # The largest ball inside, and then how far one can go along each axis.
        A = np.column_stack([self.normals, np.ones(len(self.normals))])
        free = [(None, None)] * 3
        ball = linprog([0, 0, 0, -1], A, self.offsets, bounds=[*free, (None, 1e6)])
        if ball.status != 0 or ball.x[3] <= 0.0:
            raise ProblemError(
                "polytope: its facets leave no room between them; check the normals' "
                "directions, which point outwards, and the offsets"
            )
        for axis in (*np.eye(3), *-np.eye(3)):
            if linprog(axis, self.normals, self.offsets, bounds=free).status != 0:
                raise ProblemError(
                    f"polytope: {len(self.normals)} facets do not close it along "
                    f"{axis}; add the facets that are missing"
                )

    @classmethod
    def box(cls, lower: ArrayLike, upper: ArrayLike) -> Self:
        """Return the box between two corners [m].

        Parameters
        ----------
        lower, upper : array_like, shape (3,), [m]
            Opposite corners.
        """
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
        facets = np.unique(_hull(points).equations.round(12), axis=0)
        return cls(facets[:, :3], -facets[:, 3])

    @property
    def rows(self) -> Matrix:
        """``l_i`` with ``l_i [x, 1] >= 0`` inside, shape (facets, 4)."""
        return np.column_stack([-self.normals, self.offsets])


def mesh_vertices(path: str | Path, *, scale: float = 1.0) -> Array:
    """Return the vertices of a mesh file, shape (vertices, 3), [m].

    Parameters
    ----------
    path : str or Path
        STL, OBJ, DAE or whatever else Assimp reads; in the link's frame.
    scale : float
        Metres per unit of the file: 0.001 for millimetres.

    Raises
    ------
    ProblemError
        If the file cannot be read.
    """
    return np.asarray(_mesh(path, scale).vertices(), dtype=np.float64)


def mesh_triangles(path: str | Path, *, scale: float = 1.0) -> Array:
    """Return the corners of a mesh file's faces, shape (faces, 3, 3), [m].

    Parameters and errors are those of `mesh_vertices`.
    """
    mesh = _mesh(path, scale)
    triangles = [mesh.tri_indices(i) for i in range(mesh.num_tris)]
    faces = [(t[0], t[1], t[2]) for t in triangles]
    corners = np.asarray(mesh.vertices(), dtype=np.float64)
    return corners[np.array(faces, dtype=np.intp).reshape(-1, 3)]


def _mesh(path: str | Path, scale: float) -> Any:
    import coal

    if not 0.0 < scale < np.inf:
        raise ProblemError(f"{path}: scale is {scale}, expected a positive number")
    try:
        return coal.MeshLoader().load(str(path), np.full(3, float(scale)))
    except ValueError as cause:
        reason = str(cause).partition("message: ")[2].replace("\n", " ").strip()
        raise ProblemError(f"{path}: no mesh could be read: {reason}") from None


def _hull(points: ArrayLike) -> Any:
    from scipy.spatial import ConvexHull, QhullError

    vertices = frozen(points, (None, 3), "hull points")
    try:
        return ConvexHull(vertices)
    except (QhullError, ValueError):
        raise ProblemError(
            f"hull of {len(vertices)} points: they lie in a plane, expected four "
            "or more that do not"
        ) from None


def _hull_vertices(points: ArrayLike) -> Array:
    hull = _hull(points)
    return np.asarray(hull.points[hull.vertices])

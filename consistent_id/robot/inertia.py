"""Inertial parameters of one rigid body: the convention, its views and its limits.

The convention of the whole package, which is Pinocchio's:

=====  ==========================================  =======
index  parameter                                   unit
=====  ==========================================  =======
0      ``m``, the mass                             kg
1-3    ``hx, hy, hz``, the first moment ``m c``    kg m
4-9    ``Ixx, Ixy, Iyy, Ixz, Iyz, Izz``            kg m^2
=====  ==========================================  =======

The inertia is the matrix ``[[Ixx, Ixy, Ixz], [Ixy, Iyy, Iyz], [Ixz, Iyz, Izz]]`` about
the origin of the link frame, in the frame's axes.  Other conventions are converted when
read.
"""

from dataclasses import dataclass
from itertools import permutations, product
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike

from consistent_id._support.arrays import Array, Matrix, Vector, freeze, frozen
from consistent_id._support.tables import brief
from consistent_id.errors import ModelError

INERTIAL_NAMES = ("m", "hx", "hy", "hz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")
INERTIAL_UNITS = ("kg", *("kg m",) * 3, *("kg m^2",) * 6)

# Rows and columns of the inertia matrix at which entries 4..9 of the vector stand.
_ROWS, _COLUMNS = (0, 0, 1, 0, 1, 2), (0, 1, 1, 2, 2, 2)
_ROUNDED = 1e-9  # of the largest moment of inertia


def _pseudo_inertia_basis() -> Array:
    """Matrices ``B_i`` with ``J(x) = sum_i x_i B_i``, shape (10, 4, 4)."""
    basis = np.zeros((10, 4, 4))
    basis[0, 3, 3] = 1.0
    for axis in range(3):
        basis[1 + axis, axis, 3] = basis[1 + axis, 3, axis] = 1.0
    for index, (row, column) in enumerate(zip(_ROWS, _COLUMNS, strict=True), start=4):
        if row == column:
            basis[index, :3, :3] += np.eye(3) / 2
        basis[index, row, column] -= 1.0
        basis[index, column, row] = basis[index, row, column]
    basis.setflags(write=False)
    return basis


PSEUDO_INERTIA_BASIS = _pseudo_inertia_basis()
"""``J = [[Sigma, h], [h^T, m]]`` as a linear map, ``Sigma = tr(I)/2 1 - I``."""


def pseudo_inertia(vector: ArrayLike) -> Array:
    """Return the pseudo-inertia matrices of parameter vectors.

    Parameters
    ----------
    vector : array_like, shape (..., 10)
        Inertial parameters, in the convention of this module.

    Returns
    -------
    ndarray, shape (..., 4, 4)
        ``J``; a body is physically consistent iff ``J`` is positive semidefinite
        [Wensing2018]_.
    """
    array = np.asarray(vector, dtype=np.float64)
    return np.tensordot(array, PSEUDO_INERTIA_BASIS, axes=1)


def second_moments(inertia: Matrix) -> Matrix:
    """Return ``S = tr(I)/2 1 - I``; consistent iff it is positive semidefinite."""
    return np.asarray(np.trace(inertia) / 2 * np.eye(3) - inertia)


def inertial_vector(matrix: ArrayLike) -> Array:
    """Return the parameter vectors of pseudo-inertias: the inverse of `pseudo_inertia`.

    Parameters
    ----------
    matrix : array_like, shape (..., 4, 4)
        Symmetric matrices ``J``.

    Returns
    -------
    ndarray, shape (..., 10)
    """
    J = np.asarray(matrix, dtype=np.float64)
    sigma = J[..., :3, :3]
    trace = np.trace(sigma, axis1=-2, axis2=-1)[..., None, None]
    inertia = trace * np.eye(3) - sigma
    entries = inertia[..., _ROWS, _COLUMNS]
    return np.concatenate([J[..., 3, 3:], J[..., :3, 3], entries], axis=-1)


@brief
@dataclass(frozen=True, slots=True, eq=False)
class InertialParameters:
    """Mass, first moment and inertia of a body, as one value with many views.

    Parameters
    ----------
    vector : array_like, shape (10,)
        In the convention of this module; finite, but not necessarily consistent.

    Raises
    ------
    ModelError
        If there are not ten finite numbers.

    Examples
    --------
    >>> ball = InertialParameters.from_central(2.0, [0, 0, 0.1], 0.02 * np.eye(3))
    >>> ball.mass, ball.is_consistent()
    (2.0, True)
    >>> print((ball + ball).com)
    [0.  0.  0.1]
    """

    vector: Vector

    def __post_init__(self) -> None:
        vector = frozen(self.vector, (10,), "inertial parameters", ModelError)
        freeze(self, vector=vector)

    @classmethod
    def from_central(
        cls, mass: float, com: ArrayLike, central_inertia: ArrayLike
    ) -> Self:
        """Build from mass [kg], centre of mass [m] and inertia about it [kg m^2].

        Parameters
        ----------
        mass : float, [kg]
        com : array_like, shape (3,), [m]
            Centre of mass.
        central_inertia : array_like, shape (3, 3), [kg m^2]
            About the centre of mass, in the axes of the frame.
        """
        c = frozen(com, (3,), "centre of mass", ModelError)
        inertia = frozen(central_inertia, (3, 3), "central inertia", ModelError)
        about_origin = inertia + mass * (c @ c * np.eye(3) - np.outer(c, c))
        entries = about_origin[_ROWS, _COLUMNS]
        return cls(np.concatenate([[mass], mass * c, entries]))

    @classmethod
    def from_pseudo_inertia(cls, matrix: ArrayLike) -> Self:
        """Build from the symmetric matrix ``J``, shape (4, 4)."""
        return cls(
            inertial_vector(frozen(matrix, (4, 4), "pseudo-inertia", ModelError))
        )

    @property
    def mass(self) -> float:
        """Mass ``m`` [kg]."""
        return float(self.vector[0])

    @property
    def first_moment(self) -> Vector:
        """First moment ``h = m c`` about the frame's origin, shape (3,), [kg m]."""
        return self.vector[1:4]

    @property
    def com(self) -> Vector:
        """Centre of mass ``h / m``, shape (3,), [m].

        Raises
        ------
        ModelError
            If the mass is zero.
        """
        if self.mass == 0.0:
            raise ModelError("a body of zero mass has no centre of mass")
        return self.first_moment / self.mass

    @property
    def inertia(self) -> Matrix:
        """Inertia about the frame's origin, shape (3, 3), [kg m^2]."""
        matrix = np.zeros((3, 3))
        matrix[_ROWS, _COLUMNS] = matrix[_COLUMNS, _ROWS] = self.vector[4:]
        return matrix

    @property
    def central_inertia(self) -> Matrix:
        """Inertia about the centre of mass, in the frame's axes, [kg m^2]."""
        c = self.com
        return self.inertia - self.mass * (c @ c * np.eye(3) - np.outer(c, c))

    @property
    def pseudo_inertia(self) -> Matrix:
        """The matrix ``J``, shape (4, 4)."""
        return pseudo_inertia(self.vector)

    def is_consistent(self, tolerance: float = 0.0) -> bool:
        """Return whether the parameters are physically consistent.

        `tolerance` is relative to the largest eigenvalue of ``J``.
        """
        eigenvalues = np.linalg.eigvalsh(self.pseudo_inertia)
        return bool(eigenvalues[0] >= -tolerance * max(abs(eigenvalues)))

    def transformed(self, rotation: ArrayLike, translation: ArrayLike) -> Self:
        """Express the same body in another frame.

        `rotation`, shape (3, 3), and `translation`, shape (3,) [m], place the present
        frame in the new one: ``x_new = rotation x + translation``.

        Parameters
        ----------
        rotation : array_like, shape (3, 3)
            Rotation of the present frame in the new one.
        translation : array_like, shape (3,), [m]
            Translation of the present frame's origin in the new frame.
        """
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = rotation, translation
        return type(self).from_pseudo_inertia(T @ self.pseudo_inertia @ T.T)

    def __add__(self, other: "InertialParameters") -> "InertialParameters":
        """Compose two bodies given in the same frame."""
        return InertialParameters(self.vector + other.vector)


class PrincipalInertia(NamedTuple):
    """Principal moments of inertia and their axes.

    Parameters
    ----------
    moments : ndarray, shape (3,), [kg m^2]
    axes : ndarray, shape (3, 3)
        A rotation; its columns are the axes.
    """

    moments: Vector
    axes: Matrix


def principal_inertia(inertia: Matrix) -> PrincipalInertia:
    """Return principal moments and axes, the axes as near those of the frame as can be.

    Among the 24 right-handed orders and signs of the axes, the one with the least
    rotation is taken, so that angles are small and never singular.

    Parameters
    ----------
    inertia : ndarray, shape (3, 3), [kg m^2]

    Examples
    --------
    >>> moments, axes = principal_inertia(np.diag([0.3, 0.1, 0.2]))
    >>> print(moments, np.trace(axes))
    [0.3 0.1 0.2] 3.0
    """
    if not np.any(inertia - np.diag(np.diag(inertia))):
        return PrincipalInertia(np.diag(inertia).copy(), np.eye(3))
    moments, axes = np.linalg.eigh(inertia)
    moments[moments < _ROUNDED * moments.max()] = 0.0  # a rod's, by rounding
    best, least = PrincipalInertia(moments, axes), -np.inf
    for order in map(list, permutations(range(3))):
        for signs in product((1.0, -1.0), repeat=3):
            turned = axes[:, order] * signs
            if np.linalg.det(turned) > 0.0 and np.trace(turned) > least:
                best, least = PrincipalInertia(moments[order], turned), np.trace(turned)
    return best

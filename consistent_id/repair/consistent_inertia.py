"""The physically consistent inertia nearest to an inconsistent one."""

from dataclasses import dataclass

import numpy as np

from consistent_id._support.arrays import Matrix, Vector
from consistent_id._support.brief import brief
from consistent_id.robot.inertia import second_moments

ROUNDING = 1e-12  # of the largest moment: printed numbers may be off by so much
THINNEST = 1e-3  # thickness of a repaired link, over its own size
POINT = 1e-6  # [m]; what is smaller has no extent, and its moments are rounding


@brief
@dataclass(frozen=True, slots=True, eq=False)
class NearestInertia:
    """A central inertia, and its distance from the stated one.

    Parameters
    ----------
    inertia : ndarray, shape (3, 3), [kg m^2]
    change : float
        ``||S - S0||_F / ||S0||_F`` of the second moments of mass ``S = tr(I)/2 1 - I``;
        infinite where there were none.
    """

    inertia: Matrix
    change: float


def is_consistent(inertia: Matrix, least: float = 0.0) -> bool:
    """Return whether an inertia about the centre of mass is consistent.

    Every second moment must be `least` [kg m^2] or more, up to rounding.
    """
    moments = np.linalg.eigvalsh(second_moments(inertia))
    return bool(moments[0] >= least - ROUNDING * abs(moments).max())


def point_mass(mass: float, inertia: Matrix) -> bool:
    """Return whether an inertia has no extent except from rounding of its moments."""
    return bool(abs(inertia).max() <= mass * POINT**2)


def nearest_inertia(
    mass: float, inertia: Matrix, *, thickness: float = 0.0
) -> NearestInertia:
    """Return the nearest physically consistent central inertia.

    Mass and centre of mass stay.  Then the distance of pseudo-inertias
    ``||J0^-1/2 (J - J0) J0^-1/2||_F``, for a reference ``J0`` that has no direction, is
    that of the second moments ``S`` in the Frobenius norm; and the nearest ``S`` whose
    eigenvalues are not below a least one has the same axes, with those that are below
    it raised.  It needs no programme.

    Parameters
    ----------
    mass : float, [kg]
    inertia : ndarray, shape (3, 3), [kg m^2]
        About the centre of mass.
    thickness : float, [m]
        Least standard deviation of mass along every axis; never less than `THINNEST` of
        its size, so that rounding in simulators does not matter.

    Returns
    -------
    NearestInertia
    """
    S = second_moments(inertia)
    moments, axes = np.linalg.eigh(S)
    size = float(abs(moments).max())
    least = max(THINNEST**2 * size, mass * thickness**2)
    raised = np.maximum(moments, least)
    change = np.linalg.norm(raised - moments)
    before = float(np.linalg.norm(moments))
    nearest: Vector = axes @ np.diag(raised.sum() - raised) @ axes.T
    share = float(change) / before if before > 0.0 else np.inf
    return NearestInertia((nearest + nearest.T) / 2, share)


def ball_inertia(mass: float, density: float) -> Matrix:
    """Return the inertia of a solid ball of a density [kg/m^3] about its centre."""
    radius = (3.0 * mass / (4.0 * np.pi * density)) ** (1.0 / 3.0)
    return np.asarray(0.4 * mass * radius**2 * np.eye(3))

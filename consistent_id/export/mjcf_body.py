"""A body as MuJoCo takes it: principal moments that satisfy its inequalities."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from consistent_id._support.arrays import Array, Matrix, Vector
from consistent_id._support.extras import needed
from consistent_id.errors import ModelError
from consistent_id.export.pinocchio_model import central
from consistent_id.robot.inertia import InertialParameters

# MuJoCo wants a mass above 1e-15 kg, moments above 1e-14 kg m^2, and A + B >= C of the
# numbers as they stand.
_MASS = 1e-12
_MOMENT = 2e-14
_ROUNDING = 1e-14  # of the sum of second moments


@dataclass(frozen=True, slots=True, eq=False)
class PrincipalBody:
    """Mass, centre of mass, principal moments and their axes as a quaternion.

    `raised` is by how much second moments were raised to be consistent, [kg m^2].
    """

    mass: float
    com: Vector
    moments: Vector
    quaternion: Vector
    raised: float


def principal_body(body: InertialParameters, moves: bool = True) -> PrincipalBody:
    """Return a body in its principal axes, no thinner than MuJoCo needs if it moves."""
    mass, com, inertia = central(body)
    moments, axes = np.linalg.eigh(inertia)
    if np.linalg.det(axes) < 0.0:
        axes = -axes
    second = moments.sum() / 2 - moments
    raised = 0.0
    if moves:
        least = max(_MOMENT, _ROUNDING * float(second.sum()))
        thick = np.maximum(second, least)
        raised = float((thick - second).max())
        moments = thick.sum() - thick if raised > 0.0 else moments
        mass = max(mass, _MASS)
    return PrincipalBody(mass, com, moments, quaternion(axes), raised)


def quaternion(rotation: Matrix) -> Array:
    """Return the unit quaternion (w, x, y, z) of a rotation.

    The eigenvector of the largest eigenvalue of a symmetric matrix, which loses no
    digits at any angle.
    """
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = rotation
    K = np.array(
        [
            [xx + yy + zz, zy - yz, xz - zx, yx - xy],
            [zy - yz, xx - yy - zz, xy + yx, xz + zx],
            [xz - zx, xy + yx, yy - xx - zz, yz + zy],
            [yx - xy, xz + zx, yz + zy, zz - xx - yy],
        ]
    )
    _, vectors = np.linalg.eigh(K)
    q = vectors[:, -1]
    return np.asarray(q if q[np.argmax(abs(q))] > 0.0 else -q)


def require_mujoco() -> Any:
    """Return the package, or say how to install it."""
    return needed("mujoco", "mjcf", "writing MJCF", ModelError)


def set_body(body: Any, what: InertialParameters, *, moves: bool = True) -> list[str]:
    """Give a body an explicit inertial; say so if it had to be thickened."""
    found = principal_body(what, moves)
    body.explicitinertial = True
    body.mass, body.ipos, body.inertia = found.mass, found.com, found.moments
    body.iquat = found.quaternion
    body.fullinertia = [np.nan, *np.zeros(5)]
    # Stated angles would go before the quaternion.
    body.ialt.type = require_mujoco().mjtOrientation.mjORIENTATION_QUAT
    if found.raised == 0.0 and found.mass == what.mass:
        return []
    return [
        f"{body.name} is thinner than MuJoCo takes: second moments raised by up to "
        f"{found.raised:.1g} kg m^2, mass {found.mass - what.mass:.1g} kg"
    ]

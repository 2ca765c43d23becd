"""Serial robots from tables of modified (Craig) Denavit-Hartenberg parameters."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from consistent_id.errors import ModelError
from consistent_id.model import (
    STANDARD_GRAVITY,
    Joint,
    JointKind,
    JointLimits,
    Link,
    RobotModel,
)


@dataclass(frozen=True, slots=True)
class DHRow:
    """Row ``i`` of the table: from frame ``i - 1`` to frame ``i`` [Craig2005]_.

    ``T = RotX(alpha) TransX(a) RotZ(theta) TransZ(d)``, where the joint adds its
    position to `theta` (revolute, continuous) or to `d` (prismatic).

    Parameters
    ----------
    alpha : float, [rad]
        Twist ``alpha_{i-1}``.
    a : float, [m]
        Length ``a_{i-1}``.
    d : float, [m]
    theta : float, [rad]
    kind : {"revolute", "continuous", "prismatic"}
    limits : JointLimits
    """

    alpha: float
    a: float
    d: float = 0.0
    theta: float = 0.0
    kind: JointKind = "revolute"
    limits: JointLimits = field(default_factory=JointLimits)


def from_modified_dh(
    name: str, rows: Sequence[DHRow], *, gravity: ArrayLike = STANDARD_GRAVITY
) -> RobotModel:
    """Return the serial robot of a table, with joints and links numbered from 1.

    Examples
    --------
    >>> table = [DHRow(0.0, 0.0, d=0.3), DHRow(-np.pi / 2, 0.0)]
    >>> from_modified_dh("elbow", table).joint_names
    ('joint1', 'joint2')
    """
    joints, links = [], []
    for number, row in enumerate(rows, start=1):
        values = (row.alpha, row.a, row.d, row.theta)
        if not np.isfinite(values).all():
            raise ModelError(f"DH row {number} is {values}, expected finite numbers")
        twist, turn = _turn_x(row.alpha), _turn_z(row.theta)
        # TransZ(d) commutes with the joint's own rotation about z.
        joints.append(
            Joint(
                name=f"joint{number}",
                kind=row.kind,
                parent=number - 2,
                rotation=twist @ turn,
                translation=np.array([row.a, 0.0, 0.0]) + twist[:, 2] * row.d,
                axis=np.array([0.0, 0.0, 1.0]),
                limits=row.limits,
            )
        )
        links.append(Link(f"link{number}"))
    return RobotModel(name, tuple(joints), tuple(links), np.asarray(gravity))


def _cos_sin(angle: float) -> tuple[float, float]:
    """Cosine and sine, exact at multiples of a right angle.

    Structural zeros of the geometry speed up the regressor and keep ranks sharp.
    """
    quarter = angle / (np.pi / 2)
    if abs(quarter - round(quarter)) < 1e-12:
        return ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))[round(quarter) % 4]
    return float(np.cos(angle)), float(np.sin(angle))


def _turn_x(angle: float) -> np.ndarray:
    c, s = _cos_sin(angle)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


def _turn_z(angle: float) -> np.ndarray:
    c, s = _cos_sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])

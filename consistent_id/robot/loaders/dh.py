"""Serial robots from tables of Denavit-Hartenberg parameters, of both conventions."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from consistent_id._support.arrays import Matrix, Vector
from consistent_id._support.tables import brief
from consistent_id.errors import ModelError
from consistent_id.robot.model import (
    STANDARD_GRAVITY,
    FixedFrame,
    Joint,
    JointKind,
    JointLimits,
    Link,
    RobotModel,
)

_Z = np.array([0.0, 0.0, 1.0])


@brief
@dataclass(frozen=True, slots=True)
class DHRow:
    """Row ``i`` of the table: from frame ``i - 1`` to frame ``i``.

    ``RotX(alpha) TransX(a) RotZ(theta) TransZ(d)`` in the modified convention
    [Craig2005]_, ``RotZ(theta) TransZ(d) TransX(a) RotX(alpha)`` in the classical one
    [Denavit1955]_.  The joint adds its position to `theta` (revolute, continuous) or to
    `d` (prismatic).

    Parameters
    ----------
    alpha : float, [rad]
        Twist: ``alpha_{i-1}`` of the modified convention, ``alpha_i`` of the classical.
    a : float, [m]
        Length: ``a_{i-1}`` or ``a_i``.
    d : float, [m]
    theta : float, [rad]
    kind : {"revolute", "continuous", "prismatic"}
    limits : JointLimits

    Examples
    --------
    >>> import consistent_id as ci
    >>> elbow = ci.DHRow(-np.pi / 2, 0.0, d=0.3)
    >>> ci.from_modified_dh("arm", [elbow]).joint_names
    ('joint1',)
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
    """Return the serial robot of a modified table, with joints and links from 1.

    Parameters
    ----------
    name : str
    rows : sequence of DHRow
        One for each joint, from the base on.
    gravity : array_like, shape (3,), [m/s^2]
        In the base frame.

    Examples
    --------
    >>> table = [DHRow(0.0, 0.0, d=0.3), DHRow(-np.pi / 2, 0.0)]
    >>> from_modified_dh("elbow", table).joint_names
    ('joint1', 'joint2')
    """
    joints, links = [], []
    for number, row in enumerate(_checked(rows), start=1):
        twist = _turn_x(row.alpha)
        # TransZ(d) commutes with the joint's own rotation about z.
        rotation = twist @ _turn_z(row.theta)
        translation = np.array([row.a, 0.0, 0.0]) + twist[:, 2] * row.d
        joints.append(_joint(number, row, rotation, translation, _Z))
        links.append(Link(f"link{number}"))
    return RobotModel(name, tuple(joints), tuple(links), np.asarray(gravity))


def from_classical_dh(
    name: str, rows: Sequence[DHRow], *, gravity: ArrayLike = STANDARD_GRAVITY
) -> RobotModel:
    """Return the serial robot of a classical (distal) table, with joints from 1.

    The origin of classical frame ``i`` is not on the axis of joint ``i``, where that of
    a link must be.  So link ``i`` has the axes of frame ``i``, with the origin moved by
    ``-a`` along x onto the joint's axis: a centre of mass ``c`` given in frame ``i`` is
    ``c + (a, 0, 0)`` in the link.  The frame itself is `Link.merged` as ``frame<i>``.

    Parameters
    ----------
    name : str
    rows : sequence of DHRow
        One for each joint, from the base on.
    gravity : array_like, shape (3,), [m/s^2]
        In the base frame.

    Examples
    --------
    >>> table = [DHRow(np.pi / 2, 0.0, d=0.3), DHRow(0.0, 0.4)]
    >>> arm = from_classical_dh("elbow", table)
    >>> print(arm.links[1].merged[0].name, arm.links[1].merged[0].translation)
    frame2 [0.4 0.  0. ]
    """
    joints, links = [], []
    before = np.zeros(3)  # from the previous link's origin to its classical frame
    for number, row in enumerate(_checked(rows), start=1):
        twist = _turn_x(row.alpha)
        rotation = _turn_z(row.theta) @ twist
        joints.append(_joint(number, row, rotation, before + _Z * row.d, twist.T @ _Z))
        before = np.array([row.a, 0.0, 0.0])
        frame = FixedFrame(f"frame{number}", np.eye(3), before)
        links.append(Link(f"link{number}", merged=(frame,)))
    return RobotModel(name, tuple(joints), tuple(links), np.asarray(gravity))


def _checked(rows: Sequence[DHRow]) -> Sequence[DHRow]:
    for number, row in enumerate(rows, start=1):
        values = (row.alpha, row.a, row.d, row.theta)
        if not np.isfinite(values).all():
            raise ModelError(f"DH row {number} is {values}, expected finite numbers")
        for angle in ("alpha", "theta"):
            value = getattr(row, angle)
            if abs(value) > 2.0 * np.pi:
                raise ModelError(
                    f"DH row {number}: {angle} is {value:g} rad, more than a full "
                    "turn. If these are degrees, convert them: np.radians"
                )
    return rows


def _joint(
    number: int, row: DHRow, rotation: Matrix, translation: Vector, axis: Vector
) -> Joint:
    return Joint(
        name=f"joint{number}",
        kind=row.kind,
        parent=number - 2,
        rotation=rotation,
        translation=translation,
        axis=axis,
        limits=row.limits,
    )


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

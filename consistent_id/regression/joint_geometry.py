"""A robot's joints, and their motion, as the recursion takes them."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from consistent_id._support.arrays import Array, Vector
from consistent_id.errors import ProblemError
from consistent_id.regression.newton_euler import (
    FreeMotion,
    JointGeometry,
    JointMotion,
    Scalar,
)
from consistent_id.robot.mimic import Transmission
from consistent_id.robot.model import Joint, RobotModel


def joint_geometry(robot: RobotModel) -> tuple[JointGeometry, ...]:
    """Return what the recursion needs of each joint, in plain Python numbers."""
    return tuple(
        JointGeometry(
            parent=joint.parent,
            slides=joint.kind == "prismatic",
            rotation=matrix_rows(joint.rotation),
            translation=floats(joint.translation),
            align=matrix_rows(_basis_with_axis(joint)),
        )
        for joint in robot.joints
    )


def joint_motions(
    robot: RobotModel,
    state: Sequence[Sequence[Scalar] | Array],
    sine_and_cosine: Callable[[Scalar], tuple[Scalar, Scalar]],
) -> list[JointMotion]:
    """Return the motion of all joints, from that of the generalised coordinates.

    `state` holds their positions and the two derivatives; `sine_and_cosine` is that of
    the scalars, whatever they are.

    Raises
    ------
    ProblemError
        If the robot's base floats: see `link_motions`.
    """
    if robot.floating:
        raise ProblemError(
            f"robot {robot.name!r}: its base floats, but how it moves was not given; "
            "give base motion (BaseMotion), or load the robot with a fixed base"
        )
    return _moved(robot.transmissions, state, sine_and_cosine)


def link_motions(
    robot: RobotModel,
    state: Sequence[Sequence[Scalar] | Array],
    sine_and_cosine: Callable[[Scalar], tuple[Scalar, Scalar]],
    base: Sequence[Scalar] | Array | None,
) -> Sequence[JointMotion | FreeMotion]:
    """Return the motion of all joints, and before them that of a base that floats.

    `base` holds the nine numbers of `BaseMotion`, or none for a fixed base.  The
    coordinates of the base are numbered after those of the joints.

    Raises
    ------
    ProblemError
        If a base floats whose motion is not given, or bodies are not connected.
    """
    if not robot.connected:
        raise ProblemError(
            f"robot {robot.name!r}: how its bodies are connected is not known, so a "
            "motion does not tell their regressor; give the regressor (given_rows)"
        )
    if not robot.floating or base is None:
        return joint_motions(robot, state, sine_and_cosine)
    w, dw, a = ((base[i], base[i + 1], base[i + 2]) for i in (0, 3, 6))
    n = len(robot)
    motions: list[JointMotion | FreeMotion] = [
        FreeMotion(w, dw, a, (n, n + 1, n + 2, n + 3, n + 4, n + 5))
    ]
    motions += _moved(robot.transmissions[1:], state, sine_and_cosine)
    return motions


def _moved(
    transmissions: Sequence[Transmission],
    state: Sequence[Sequence[Scalar] | Array],
    sine_and_cosine: Callable[[Scalar], tuple[Scalar, Scalar]],
) -> list[JointMotion]:
    motions, (q, dq, ddq) = [], state
    for j, ratio, offset in transmissions:
        position, rate, push = q[j], dq[j], ddq[j]
        if (ratio, offset) != (1.0, 0.0):
            position = ratio * position + offset
            rate, push = ratio * rate, ratio * push
        turned = sine_and_cosine(position)
        motions.append(JointMotion(position, *turned, rate, push, j, ratio))
    return motions


def _basis_with_axis(joint: Joint) -> Array:
    """Return a rotation whose third column is the joint's axis.

    A cyclic permutation where the axis is a coordinate axis, so that it costs nothing.
    """
    axis = joint.axis
    if np.count_nonzero(axis) == 1:
        place = int(np.argmax(abs(axis)))
        basis = np.roll(np.eye(3), place - 2, axis=0)
        return basis if axis[place] > 0 else basis * np.array([1.0, -1.0, -1.0])
    helper = np.eye(3)[np.argmin(abs(axis))]
    first = np.cross(axis, helper)
    first /= np.linalg.norm(first)
    return np.column_stack([first, np.cross(axis, first), axis])


def floats(vector: Vector) -> tuple[float, float, float]:
    """Return the three entries of a vector as Python numbers."""
    x, y, z = vector.tolist()
    return x, y, z


def matrix_rows(matrix: Array) -> tuple[Any, Any, Any]:
    """Return the three rows of a matrix as Python numbers."""
    return floats(matrix[0]), floats(matrix[1]), floats(matrix[2])

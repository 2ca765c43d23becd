"""Limits of motor currents, as limits of torque."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from consistent_id._support.arrays import Vector
from consistent_id.errors import ProblemError
from consistent_id.motion.limits import MotionLimits
from consistent_id.problems.excitation_tables import LimitsTable, PerJoint
from consistent_id.robot.parameters import require_known

_WHERE = "[excitation.limits]"


def with_current_limits(limits: MotionLimits, given: LimitsTable) -> MotionLimits:
    """Return limits whose efforts no current exceeds: ``torque_constant * current``.

    Raises
    ------
    ProblemError
        If one of `current` and `torque_constant` is missing, or a name is no joint's.
    """
    if given.current is None and given.torque_constant is None:
        return limits
    if given.current is None or given.torque_constant is None:
        missing = "current" if given.current is None else "torque_constant"
        raise ProblemError(
            f"{_WHERE} {missing} is missing: a current [A] limits torque with the "
            "torque constant of the joint, gears included [N m/A]; give both"
        )
    current = _by_joint(given.current, limits.joints, "current")
    constant = _by_joint(given.torque_constant, limits.joints, "torque_constant")
    known = np.isfinite(current) & np.isfinite(constant)
    torque = np.where(known, current * constant, np.inf)
    return replace(limits, effort=np.minimum(limits.effort, torque))


def _by_joint(given: PerJoint, joints: tuple[str, ...], key: str) -> Vector:
    """Return a number for each joint, infinite where none is given."""
    if isinstance(given, Mapping):
        require_known(given, joints, f"{_WHERE} {key}: no joint")
        return np.array([given.get(name, np.inf) for name in joints])
    values = np.asarray(given, dtype=np.float64)
    if values.shape not in ((), (len(joints),)):
        raise ProblemError(
            f"{_WHERE} {key} has {len(values)} numbers, expected one or {len(joints)}"
        )
    return np.broadcast_to(values, (len(joints),))

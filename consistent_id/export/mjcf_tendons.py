"""What MuJoCo expresses by tendons: friction that varies with position, coupled gears.

A tendon between a point of the link and one of its parent, both at the radius ``r``
from the joint's axis and opposite to each other at ``q = e``, has the moment arm
``r sin((q - e) / 2)``.  Friction of the tendon is a torque that grows with it, nearly
linearly up to a few radians.

Of coupled gears, the tendon's length is the sum of both positions.  What two joints
share of viscous friction, ``[[d1, b], [b, d2]]``, is a damper ``b`` on the sum of both
rates and dampers ``d1 - b`` and ``d2 - b`` on each; rotor inertias likewise, and
Coulomb friction of the sum is the tendon's own.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from consistent_id._support.arrays import Vector
from consistent_id.estimation.estimate import Estimate
from consistent_id.export.drive_values import JointDrive, coupling_values, joint_drives
from consistent_id.robot.loaders.mjcf import quaternion_matrix
from consistent_id.robot.model import Joint

RADIUS = 0.05
"""Of the tendon's ends around the joint [m]; the torque does not depend on it."""

SIZE = 1e-3
"""Of the sites that are its ends [m]; for looking at."""

_WIDEST = np.pi  # rad between limits, up to which the moment arm grows
_GRID = 65  # positions between the limits at which the levels are made alike

_ROUNDING = 1e-8  # of what is shared; so far may a joint's own fall short of it
_SHARED = {
    "coupling_viscous": "damping",
    "coupling_coulomb": "frictionloss",
    "coupling_rotor_inertia": "armature",
}


class _Level(NamedTuple):
    """Friction ``joint + tendon r |sin((q - rest) / 2)|``, and how far off it is."""

    joint: float  # N m
    tendon: float  # N
    rest: float  # rad
    error: float  # N m


def add_slopes(
    spec: Any, joints: Mapping[str, Any], estimate: Estimate
) -> tuple[set[tuple[str, str]], list[str]]:
    """Add a tendon for each joint whose friction varies with position.

    Returns
    -------
    set of (str, str)
        Joints and terms that are expressed.
    list of str
        Notes on how well.
    """
    sloped = [
        (drive, joint)
        for drive, joint in zip(
            joint_drives(estimate), estimate.model.robot.driven, strict=True
        )
        if drive.values.get("friction_slope") and _can_wrap(joint)
    ]
    if not sloped:
        return set(), []
    expressed, worst = set(), 0.0
    compiled = spec.compile()
    for drive, joint in sloped:
        level = _level(drive, joint)
        set_number(joints[joint.name], "frictionloss", level.joint)
        _add_tendon(spec, joints[joint.name], compiled, level)
        expressed.add((joint.name, "friction_slope"))
        worst = max(worst, level.error)
    names = ", ".join(drive.joint for drive, _ in sloped)
    note = (
        f"friction of {names} varies with position: tendons with friction say so, off "
        f"by at most {worst:.2g} N m between the limits"
    )
    return expressed, [note]


def add_gears(
    spec: Any, joints: Mapping[str, Any], estimate: Estimate
) -> set[tuple[str, str]]:
    """Add a tendon for each coupling, to joints that have their drives already.

    Returns
    -------
    set of (str, str)
        Couplings and terms that are expressed: those whose dampers and inertias all
        come out positive.
    """
    expressed = set()
    for coupling, values in coupling_values(estimate):
        ends = (joints[coupling.first], joints[coupling.second])
        tendon = spec.add_tendon(name=coupling.label)
        shared = {
            term: value
            for term, value in values.items()
            # Older versions have no inertia of tendons.
            if hasattr(tendon, _SHARED[term]) and _fits(term, value, ends)
        }
        for name, end in zip((coupling.first, coupling.second), ends, strict=True):
            tendon.wrap_joint(name, 1.0)
            for term, value in shared.items():
                if term != "coupling_coulomb":
                    rest = max(_number(end, _SHARED[term]) - value, 0.0)
                    set_number(end, _SHARED[term], rest)
        for term, value in shared.items():
            set_number(tendon, _SHARED[term], value)
            expressed.add((coupling.label, term))
    return expressed


def set_number(item: Any, name: str, value: float) -> None:
    """Set a number that newer versions of MuJoCo have as a polynomial's first."""
    stated = getattr(item, name)
    if np.ndim(stated):
        setattr(item, name, [value, *np.zeros(len(stated) - 1)])
    else:
        setattr(item, name, value)


def _can_wrap(joint: Joint) -> bool:
    width = joint.limits.upper - joint.limits.lower
    return joint.kind == "revolute" and width <= _WIDEST


def _level(drive: JointDrive, joint: Joint) -> _Level:
    """Return the friction of joint and tendon nearest to ``coulomb + slope q``."""
    from scipy.optimize import nnls

    slope = drive.values["friction_slope"]
    low, high = joint.limits.lower, joint.limits.upper
    rest = low if slope > 0.0 else high
    q = np.linspace(low, high, _GRID)
    coulomb = (drive.simulated("friction") or 0.0) - slope * drive.middle
    wanted = coulomb + slope * q
    arm = RADIUS * abs(np.sin((q - rest) / 2.0))
    shapes = np.column_stack([np.ones_like(q), arm / RADIUS])
    (constant, growing), _ = nnls(shapes, wanted)
    error = abs(shapes @ [constant, growing] - wanted).max()
    return _Level(float(constant), float(growing) / RADIUS, rest, float(error))


def _add_tendon(spec: Any, joint: Any, compiled: Any, level: _Level) -> None:
    own, parents = _ends(compiled, compiled.joint(joint.name).id, level.rest)
    body = joint.parent
    names = [f"{joint.name} friction {end}" for end in ("link", "parent")]
    body.add_site(name=names[0], pos=own, size=[SIZE, 0.0, 0.0])
    body.parent.add_site(name=names[1], pos=parents, size=[SIZE, 0.0, 0.0])
    tendon = spec.add_tendon(name=f"{joint.name} friction")
    for name in names:
        tendon.wrap_site(name)
    set_number(tendon, "frictionloss", level.tendon)


def _ends(model: Any, j: int, rest: float) -> tuple[Vector, Vector]:
    """Return the ends of a tendon, in the frames of link and parent."""
    body = int(model.jnt_bodyid[j])
    axis, anchor = model.jnt_axis[j], model.jnt_pos[j]
    across = np.eye(3)[int(np.argmin(abs(axis)))]
    u = np.cross(axis, across)
    u /= np.linalg.norm(u)
    angle = rest - float(model.qpos0[model.jnt_qposadr[j]]) + np.pi
    turned = np.cos(angle) * u + np.sin(angle) * np.cross(axis, u)
    R = quaternion_matrix(model.body_quat[body])
    own = anchor + RADIUS * u
    return own, model.body_pos[body] + R @ (anchor + RADIUS * turned)


def _fits(term: str, value: float, ends: tuple[Any, Any]) -> bool:
    if value < 0.0:
        return False
    if term == "coupling_coulomb":
        return True
    least = (1.0 - _ROUNDING) * value
    return all(_number(end, _SHARED[term]) >= least for end in ends)


def _number(item: Any, name: str) -> float:
    return float(np.ravel(getattr(item, name))[0])

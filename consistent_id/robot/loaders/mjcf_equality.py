"""Joints of an MJCF model that follow others: ``<equality><joint polycoef>``."""

from typing import Any, NamedTuple

from consistent_id.errors import ModelError
from consistent_id.robot.loaders.mjcf_checks import joint_name
from consistent_id.robot.mimic import Mimic


class Bindings(NamedTuple):
    """What equality constraints make of joints, by their names.

    `mimics` of joints that follow one that moves by itself, chains of them resolved;
    `still`, the positions of joints that are bound to stand still.
    """

    mimics: dict[str, Mimic]
    still: dict[str, float]


def bindings(model: Any) -> Bindings:
    """Return the joints that active equality constraints bind in a straight line.

    MuJoCo counts from the joints' ``ref``: ``q1 - ref1 = b + k (q2 - ref2)``.

    Raises
    ------
    ModelError
        If joints follow one another, or two constraints bind the same one.
    """
    lines = _lines(model)
    mimics: dict[str, Mimic] = {}
    still: dict[str, float] = {}
    for joint in lines:
        ratio, offset, leader, seen = 1.0, 0.0, joint, {joint}
        while leader in lines:
            multiplier, shift, leader = lines[leader]
            ratio, offset = ratio * multiplier, offset + ratio * shift
            if leader in seen:
                name = joint_name(model, joint)
                raise ModelError(f"joint {name!r} follows one that follows it")
            seen.add(leader)
        if leader < 0 or ratio == 0.0:
            still[joint_name(model, joint)] = offset
        else:
            mimics[joint_name(model, joint)] = Mimic(
                joint_name(model, leader), ratio, offset
            )
    return Bindings(mimics, still)


def _lines(model: Any) -> dict[int, tuple[float, float, int]]:
    """Return ``(k, b, leader)`` of joints with ``q = k q_leader + b``; -1 for none."""
    import mujoco

    lines: dict[int, tuple[float, float, int]] = {}
    for e in range(model.neq):
        joints = mujoco.mjtEq(int(model.eq_type[e])) == mujoco.mjtEq.mjEQ_JOINT
        if not (joints and model.eq_active0[e]) or model.eq_data[e, 2:5].any():
            continue
        follower, leader = int(model.eq_obj1id[e]), int(model.eq_obj2id[e])
        if follower in lines:
            name = joint_name(model, follower)
            raise ModelError(
                f"two equality constraints bind joint {name!r}; remove one of them"
            )
        shift, ratio = model.eq_data[e, :2].tolist()
        shift += _reference(model, follower)
        if leader >= 0:
            shift -= ratio * _reference(model, leader)
        lines[follower] = (ratio if leader >= 0 else 0.0, shift, leader)
    return lines


def _reference(model: Any, j: int) -> float:
    return float(model.qpos0[model.jnt_qposadr[j]])

"""Limits that a URDF states, and that a motion does not keep."""

from consistent_id._support.tables import some_of
from consistent_id.motion.collisions.urdf_bodies import urdf_root
from consistent_id.problems.problem import Problem
from consistent_id.robot.loaders.xml import Element
from consistent_id.robot.model import Joint

_NAMED = 4  # of joints in a note


def unused_limits(problem: Problem) -> tuple[str, ...]:
    """Return notes on limits of zero, which are read as none, and on soft limits.

    Controllers that keep soft limits stop a robot, or change its motion.
    """
    file = problem.table.model.urdf
    if file is None:
        return ()
    moving = {joint.name: joint for joint in problem.moving.joints}
    stated = [
        (joint, moving[joint.name])
        for joint in urdf_root(problem.file(file)).all("joint")
        if joint.name in moving
    ]
    notes = []
    for kind in ("effort", "velocity"):
        none = [one.name for one, _ in stated if _number(one, "limit", kind) == 0.0]
        if none:
            listed = some_of(none, _NAMED)
            notes.append(f"{kind} = 0 of {listed} in the file is read as no limit")
    soft = [one.name for one, joint in stated if _is_narrower(one, joint)]
    if soft:
        listed = some_of(soft, _NAMED)
        notes.append(
            f"soft limits (<safety_controller>) of {listed} are narrower than the "
            "range, and the motion does not keep them: state them as "
            "[excitation.limits] position"
        )
    return tuple(notes)


def _is_narrower(element: Element, joint: Joint) -> bool:
    """Return whether a joint's soft limits leave out a part of its range."""
    low = _number(element, "safety_controller", "soft_lower_limit")
    high = _number(element, "safety_controller", "soft_upper_limit")
    if low is None or high is None or low >= high:
        return False
    return low > joint.limits.lower or high < joint.limits.upper


def _number(joint: Element, child: str, name: str) -> float | None:
    """Return a number of a joint's element; None if it is not stated."""
    element = joint.child(child)
    text = None if element is None else element.attributes.get(name)
    try:
        return None if text is None else float(text)
    except ValueError:
        return None

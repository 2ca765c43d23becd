"""Joints of limbs that mirror each other: their motors are probably of one type.

Limbs are alike if their joints have the same names but for the side, the same kinds,
and the same geometry but for signs: a mirror changes signs of positions and axes only.
"""

import re
from collections.abc import Sequence

import numpy as np

from consistent_id.robot.model import RobotModel

_SIDES = frozenset(
    "l r left right f b front back rear hind fl fr rl rr lf rf lh rh lb rb bl br hl hr "
    "lm rm ml mr mid middle".split()
)
"""Parts of names that say which limb of several a joint belongs to."""

_ALIKE = 1e-3  # m, and of unit vectors: lengths and axes of equal limbs differ less


def mirrored_motors(robot: RobotModel) -> tuple[tuple[str, ...], ...]:
    """Return groups of joints at the same place of limbs that mirror each other.

    Only driven joints are in them; a joint without a counterpart is in none.
    """
    limbs = _limbs(robot)
    groups: dict[tuple[str, ...], list[list[int]]] = {}
    for limb in limbs:
        names = tuple(without_side(robot.joints[k].name) for k in limb)
        groups.setdefault(names, []).append(limb)
    found: list[tuple[str, ...]] = []
    for alike in groups.values():
        first = alike[0]
        same = [first, *(other for other in alike[1:] if _mirror(robot, first, other))]
        if len(same) < 2:
            continue
        for place in range(len(first)):
            joints = [robot.joints[limb[place]] for limb in same]
            if all(joint.driven for joint in joints):
                found.append(tuple(joint.name for joint in joints))
    return tuple(found)


def without_side(name: str) -> str:
    """Return a joint's name without the parts that say which limb it is of."""
    spaced = re.sub(r"([a-z])([A-Z])", r"\1_\2", name)
    parts = [part for part in re.split(r"[^A-Za-z0-9]+", spaced) if part]
    return "_".join(p for part in parts if (p := part.lower()) not in _SIDES)


def _limbs(robot: RobotModel) -> list[list[int]]:
    """Return the joints of each limb, parents first, in the order of the robot.

    A limb begins at the base, or where the links that carry others branch.
    """
    children: dict[int, list[int]] = {}
    for k, joint in enumerate(robot.joints):
        children.setdefault(joint.parent, []).append(k)
    starts = [
        k
        for k, joint in enumerate(robot.joints)
        if joint.kind != "free" and len(children[joint.parent]) > 1
    ]
    limbs = []
    for start in starts:
        limb = [start]
        while len(after := children.get(limb[-1], [])) == 1:
            limb.append(after[0])
        limbs.append(limb)
    return limbs


def _mirror(robot: RobotModel, one: Sequence[int], other: Sequence[int]) -> bool:
    """Tell whether two limbs have equal geometry but for signs."""
    first, second = ([robot.joints[k] for k in limb] for limb in (one, other))
    if [joint.kind for joint in first] != [joint.kind for joint in second]:
        return False
    for place, (a, b) in enumerate(zip(first, second, strict=True)):
        if not np.allclose(
            abs(a.rotation @ a.axis), abs(b.rotation @ b.axis), atol=_ALIKE
        ):
            return False
        # Where limbs are attached is free: arms may hang at different heights.
        if place and not np.allclose(
            abs(a.translation), abs(b.translation), atol=_ALIKE
        ):
            return False
    return True

"""Sentences that say which limits a motion keeps, and what could not be checked."""

from collections import Counter
from itertools import compress

import numpy as np

from consistent_id._support.arrays import Vector
from consistent_id.excitation.verification import Demands
from consistent_id.motion.collisions.bodies import HalfSpace
from consistent_id.motion.collisions.scene import Scene
from consistent_id.motion.limits import MotionLimits
from consistent_id.recordings.joint_paths import JointPath

PROVEN = "proven for all times"
_STATED = ("velocity", "acceleration", "jerk", "effort")
_NAMED = 4  # of unchecked bodies or of obstacles, in one sentence
_HARDLY = 0.1  # share of a joint's range, or rad or m without one
_SAMPLES = 1000


def clearance_words(scene: Scene) -> str:
    """Return how far a scene's pairs stay apart: "proven", or only "checked"."""
    if scene.unchecked:
        return f"{len(scene.pairs)} pairs of bodies checked; others are not"
    return (
        f"{len(scene.pairs)} pairs of bodies checked; {PROVEN}{adjacent_words(scene)}"
    )


def adjacent_words(scene: Scene) -> str:
    """Return words on pairs that one joint connects, which are not checked."""
    if not scene.adjacent:
        return ""
    return f"; pairs that one joint connects are not checked ({scene.adjacent})"


def kept_limits(demands: Demands) -> str:
    """Return which limits of motion and torque are kept, and which are not stated.

    A limit that only some joints have is named with the joints that lack it.
    """
    limits = demands.limits
    has = {name: np.isfinite(getattr(limits, name)) for name in _STATED}
    has["effort"] = has["effort"] & (demands.parameters is not None)
    words = {name: name for name in _STATED} | {"effort": "torque"}
    kept = ", ".join(["position", *(words[n] for n in _STATED if has[n].any())])
    missing = [
        words[name]
        if not its.any()
        else f"{words[name]} ({_some(tuple(compress(limits.joints, ~its)), ', ')})"
        for name, its in has.items()
        if not its.all()
    ]
    more = f"; no limit is kept of {', '.join(missing)}" if missing else ""
    return f"limits of {kept}: {PROVEN}{more}"


def kept_apart(scene: Scene | None) -> tuple[str, ...]:
    """Return how far bodies stay apart, what is around them, and what is unchecked."""
    if scene is None:
        return ("collisions: NOT CHECKED",)
    found = [_distances(scene)]
    if scene.unchecked:
        found.insert(0, f"NOT CHECKED for collisions: {_some(scene.unchecked, '; ')}")
    return tuple(found)


def _distances(scene: Scene) -> str:
    if not scene.pairs:
        return "bodies: no two can come together"
    counts = Counter(pair.wanted for pair in scene.pairs)
    apart = []
    for wanted, count in sorted(counts.items(), reverse=True):
        pairs = f"{count} pair{'s' if count > 1 else ''}"
        if wanted == 0.0:
            apart.append(f"{pairs} only must not touch")
        else:
            verb = "stay" if count > 1 else "stays"
            apart.append(f"{pairs} {verb} {wanted * 1e3:.3g} mm apart")
    how = "checked" if scene.unchecked else PROVEN
    return f"bodies: {', '.join(apart)}, {how}{adjacent_words(scene)}; {_around(scene)}"


def _around(scene: Scene) -> str:
    """Return the obstacles in words; a level floor with its height."""
    words = []
    for body in scene.bodies:
        if body.frame is not None:
            continue
        level = np.asarray(body.rotation)[2, 2] == 1.0
        if isinstance(body.shape, HalfSpace) and level and body.name == "ground":
            words.append(f"floor at {np.asarray(body.translation)[2]:g} m")
        else:
            words.append(body.name)
    if not words:
        return "no floor and no obstacle is known (--ground, [excitation.scene])"
    return f"around it: {_some(tuple(words), ', ')}"


def _some(names: tuple[str, ...], between: str) -> str:
    more = len(names) - _NAMED
    shown = between.join(names[:_NAMED])
    return f"{shown}{between}and {more} more" if more > 0 else shown


def least_moved(path: JointPath, limits: MotionLimits) -> str:
    """Return which joints hardly move, in words.

    A joint hardly moves if it uses less than a tenth of its range; without a range, if
    it moves by less than 0.1 rad or m.
    """
    shares = range_shares(path, limits)
    few = [k for k in np.argsort(shares) if shares[k] < _HARDLY]
    if few:
        named = tuple(
            f"{limits.joints[k]} ({100.0 * shares[k]:.2g} % of its range)" for k in few
        )
        verb = "moves" if len(few) == 1 else "move"
        return f"hardly {verb}: {_some(named, ', ')}"
    k = int(np.argmin(shares))
    return f"least moved: {limits.joints[k]}, {100.0 * shares[k]:.0f} % of its range"


def range_shares(path: JointPath, limits: MotionLimits) -> Vector:
    """Return the share of its range that each joint uses; without one, in rad or m."""
    order = [tuple(path.joints).index(joint) for joint in limits.joints]
    time = path.start + path.duration * np.linspace(0.0, 1.0, _SAMPLES)
    moved = np.ptp(path.evaluate(time, 0)[0][:, order], axis=0)
    width = limits.upper - limits.lower
    return np.asarray(moved / np.where(np.isfinite(width), width, 1.0))

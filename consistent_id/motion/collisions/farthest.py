"""Poses that keep two bodies as far apart as possible, and scenes that need more.

From the best of some random poses, steps follow the gradient of the distance within the
joints' ranges.  A scene is refused only if no such pose keeps a pair apart, and with
the largest distance that was found.
"""

import shlex
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from consistent_id._support.arrays import Array, Vector
from consistent_id._support.tables import some_of
from consistent_id.errors import ProblemError
from consistent_id.motion.collisions.bodies import HalfSpace
from consistent_id.motion.collisions.scene import Pair, Scene, moving_pairs
from consistent_id.motion.collisions.separation import nearest
from consistent_id.robot.model import (
    Joint,
    JointLimits,
    RobotModel,
    limits_with_followers,
)

ROOM = 0.004
"""Distance beyond the required one that a pose needs so that it can be left [m]."""
_FOUND = 1e-5  # [m]; accuracy of the largest distance
_ANYWHERE = 1.0  # [m]; motion of a sliding joint without limits, either way
_STARTS = 4  # random poses from which steps are made
_STEPS = 60  # at most
_STEP = 0.5  # rad or m; length of the first one
_LONGER, _SHORTER = 1.5, 0.4  # after a better pose, and after a worse one
_SHORTEST = 1e-4  # rad or m; a shorter step ends the search
_NAMED = 3  # of other pairs, in a message


class FarthestPose(NamedTuple):
    """The pose, (joints,), in which a pair is farthest apart, and the distance."""

    pair: Pair
    pose: Vector
    distance: float

    @property
    def lacking(self) -> float:
        """How much farther apart the bodies would have to be [m]."""
        return self.pair.wanted + ROOM - self.distance

    @property
    def impossible(self) -> bool:
        """Whether the required distance cannot be kept, by more than rounding."""
        return self.lacking > _FOUND


def pose_ranges(robot: RobotModel) -> tuple[Vector, Vector]:
    """Return the least and greatest positions of a robot's joints, [rad or m].

    Joints without limits turn by half a turn, or slide by a metre, either way.
    """
    limits = limits_with_followers(robot.joints)
    spans = zip(robot.driven, limits, strict=True)
    low, high = np.array([_range(joint, its) for joint, its in spans]).T
    return low, high


def random_poses(robot: RobotModel, poses: int, seed: int) -> Array:
    """Return poses within the joints' limits, shape (poses, joints), [rad or m]."""
    low, high = pose_ranges(robot)
    return np.random.default_rng(seed).uniform(low, high, (poses, len(robot)))


def _range(joint: Joint, limits: JointLimits) -> tuple[float, float]:
    low, high = limits.lower, limits.upper
    if np.isfinite([low, high]).all():
        return low, high
    reach = _ANYWHERE if joint.kind == "prismatic" else np.pi
    return max(low, -reach), min(high, reach)


def farthest_pose(
    scene: Scene, pair: Pair, poses: Array, distance: Vector
) -> FarthestPose:
    """Return the pose found in which a pair's distance is largest.

    Parameters
    ----------
    poses : ndarray, shape (poses, joints), [rad or m]
        Poses to begin with.
    distance : ndarray, shape (poses,), [m]
        The pair's distance there.
    """
    low, high = pose_ranges(scene.robot)
    best = np.argsort(-distance, kind="stable")[:_STARTS]
    found = [_climbed(scene, pair, poses[k], low, high) for k in best]
    return max(found, key=lambda one: one.distance)


def _climbed(
    scene: Scene, pair: Pair, pose: Vector, low: Vector, high: Vector
) -> FarthestPose:
    """Return the pose after steps that each enlarge the pair's distance."""
    near, step = nearest(scene, pose[None], (pair,)), _STEP
    for _ in range(_STEPS):
        way = near.gradient[0, 0].copy()
        outwards = ((pose <= low) & (way < 0.0)) | ((pose >= high) & (way > 0.0))
        way[outwards] = 0.0
        size = float(np.linalg.norm(way))
        if size == 0.0 or step < _SHORTEST:
            break
        other = np.clip(pose + step / size * way, low, high)
        there = nearest(scene, other[None], (pair,))
        if there.distance[0, 0] > near.distance[0, 0]:
            pose, near, step = other, there, _LONGER * step
        else:
            step *= _SHORTER
    return FarthestPose(pair, pose, float(near.distance[0, 0]))


def pose_words(robot: RobotModel, pose: Vector, joints: Sequence[int] = ()) -> str:
    """Return a pose as text: the position of each joint, or of some by index."""
    chosen = joints or range(len(pose))
    shown = np.round(pose, 3) + 0.0  # no -0.000
    return ", ".join(f"{robot.joint_names[j]} = {shown[j]:.3f}" for j in chosen)


def _where(scene: Scene, found: FarthestPose) -> str:
    """Return the positions of the joints that move the pair's bodies apart."""
    of_pair = moving_pairs(replace(scene, pairs=(found.pair,)))[0]
    joints = np.flatnonzero(of_pair).tolist()
    return pose_words(scene.robot, found.pose, joints)


def distance_words(distance: float) -> str:
    """Return how far two bodies are apart, as the end of a sentence about them."""
    if distance < 0.0:
        return f"penetrate each other by {-distance * 1e3:.1f} mm"
    return f"are {distance * 1e3:.1f} mm apart"


def always_touching(scene: Scene, found: Sequence[FarthestPose]) -> ProblemError:
    """Return the error of obstacles that touch the robot in every pose."""
    worst, names, others = _worst(scene, found)
    return ProblemError(
        f"scene: no pose keeps bodies {names[0]!r} and {names[1]!r} apart{others}. "
        f"In the best one found, {_where(scene, worst)}, they "
        f"{distance_words(worst.distance)}. {_moved_away(scene, worst)}, or, if they "
        f"may touch, {_allow(names)}"
    )


def _moved_away(scene: Scene, worst: FarthestPose) -> str:
    """Return how an obstacle has to be moved; a level floor, to which height."""
    more = f"at least {np.ceil(worst.lacking * 1e3 - 1e-6):.0f} mm"
    for k in (worst.pair.first, worst.pair.second):
        body = scene.bodies[k]
        level = np.asarray(body.rotation)[2, 2] == 1.0
        if body.frame is None and isinstance(body.shape, HalfSpace) and level:
            height = float(np.asarray(body.translation)[2]) - worst.lacking
            return (
                f"Lower the floor by {more}: --ground {_rounded_down(height):g} or less"
            )
    return f"Move the obstacle away by {more}"


def not_so_far_apart(scene: Scene, found: Sequence[FarthestPose]) -> ProblemError:
    """Return the error of a stated distance that no pose keeps."""
    worst, names, others = _worst(scene, found)
    wanted = worst.pair.wanted
    possible = _rounded_down(worst.distance - ROOM)
    state = f"State {possible:g} m or less, l" if possible > 0.0 else "L"
    return ProblemError(
        f"scene: a clearance of {wanted * 1e3:.4g} mm is stated, and no pose keeps "
        f"bodies {names[0]!r} and {names[1]!r} so far apart{others}: the largest "
        f"distance found is {worst.distance * 1e3:.1f} mm, at {_where(scene, worst)}, "
        f"and {ROOM * 1e3:.0f} mm more than the clearance are needed to move. "
        f"{state}eave the clearance out (the default of 20 mm is relaxed for such "
        f"pairs, which are named), or, if they may touch, {_allow(names)}. `extra` of "
        "[excitation.scene] keeps one body, such as the floor, farther away"
    )


def _rounded_down(metres: float) -> float:
    """Return a number of whole millimetres, but for rounding errors, in metres."""
    return float(np.floor(metres * 1e3 + 1e-6) / 1e3)


def _allow(names: tuple[str, str]) -> str:
    return f"name the pair: --allowed {shlex.quote(','.join(names))}"


def _worst(
    scene: Scene, found: Sequence[FarthestPose]
) -> tuple[FarthestPose, tuple[str, str], str]:
    """Return the pair that lacks most, its names, and words on the other ones."""
    worst, *others = sorted(found, key=lambda one: -one.lacking)
    names = tuple(" and ".join(scene.names(one.pair)) for one in others)
    more = f" (nor {some_of(names, _NAMED, '; ')})" if names else ""
    return worst, scene.names(worst.pair), more

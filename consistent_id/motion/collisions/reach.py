"""How much the distance of two bodies can change while joints move a little.

Turn one joint by ``s``: the bodies on its far side turn rigidly about its axis, or,
seen from them, those on its near side do.  So the distance of one on each side changes
by at most ``s min(R_a, R_b)``, ``R`` being how far a body reaches from the axis; if the
joint slides, by at most ``s``.  Of directions, all axes go through one point, and a
joint that slides changes nothing.

Let the joints between bodies a and b move one after another, those next to a first.
Each finds b in reach as it was, and a farther off by no more than what the joints
before it have done:

    change <= sum_j s_j min(R_bj, R_aj + sum over k before j of s_k R_ak).

Where the joints end does not depend on the order, so it holds as well for joints that
move together, and for the opposite order; the smaller of the two bounds counts.
"""

import numpy as np

from consistent_id._support.arrays import Array, IntArray
from consistent_id.motion.collisions.scene import BodyPlaces, Pair
from consistent_id.robot.kinematics import LinkPlaces, ancestors
from consistent_id.robot.model import RobotModel


def joints_between(robot: RobotModel, first: int, second: int) -> tuple[int, ...]:
    """Return the joints by which two links move against each other, in order.

    From the first link, or the base, which is -1, to the second.
    """
    up, down = ancestors(robot, first), ancestors(robot, second)
    return (
        *(joint for joint in up if joint not in down),
        *reversed([joint for joint in down if joint not in up]),
    )


def largest_change(
    places: BodyPlaces, pair: Pair, sample: IntArray, steps: Array
) -> Array:
    """Bound how much a pair's distance changes while joints move by at most `steps`.

    Parameters
    ----------
    places : BodyPlaces
        Of the poses from which the joints move.
    sample : ndarray, shape (queries,)
        Which of the poses.
    steps : ndarray, shape (queries, joints), [rad or m], 0 or more
        A joint may be anywhere so near to where it is in the pose.

    Returns
    -------
    ndarray, shape (queries,), [m]
    """
    links = places.links
    between = joints_between(
        links.robot, places.carriers[pair.first], places.carriers[pair.second]
    )
    step = steps[:, between].T
    near = _reaches(places, pair.first, between, sample)
    far = _reaches(places, pair.second, between, sample)
    return np.minimum(
        _moved(step, near, far), _moved(step[::-1], far[::-1], near[::-1])
    )


def _moved(step: Array, near: Array, far: Array) -> Array:
    """Change of distance if the joints move in order, shape (queries,)."""
    if np.isinf(near).any():  # a half-space: all of it is out of reach
        return np.asarray((step * far).sum(axis=0))
    done = step * near
    before = np.cumsum(done, axis=0) - done
    return np.asarray((step * np.minimum(far, near + before)).sum(axis=0))


def _reaches(
    places: BodyPlaces, body: int, joints: tuple[int, ...], sample: IntArray
) -> Array:
    """How far a body reaches from joints' axes, shape (joints, queries)."""
    turning = bool(places.turning[body])
    reaches = np.full((len(joints), len(sample)), 0.0 if turning else 1.0)
    for i, joint in enumerate(joints):
        if places.links.robot.joints[joint].kind != "prismatic":
            arm = places.centre[sample, body]
            if not turning:
                arm = arm - places.links.translation[sample, joint]
            off = _off_axis(places.links, joint, sample, arm)
            reaches[i] = off + places.radius[body]
    return reaches


def _off_axis(links: LinkPlaces, joint: int, sample: IntArray, arm: Array) -> Array:
    off = np.linalg.norm(np.cross(arm, links.axis[sample, joint]), axis=1)
    return np.asarray(off)

"""Signed distances between bodies, each proven by a separating plane.

coal (GJK, EPA) finds the direction ``n`` from one body to the other; the distance is
then computed again as the separation along that direction,

    distance = min over b of n.b - max over a of n.a,

which is at most the true signed distance for any unit vector (negative: depth of
penetration).  So a search that ended early is on the safe side.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from consistent_id._support.arrays import Array, IntArray, Matrix
from consistent_id.motion.collisions.bodies import HalfSpace, coal_geometry
from consistent_id.motion.collisions.scene import (
    BodyPlaces,
    Pair,
    PairChange,
    Scene,
    body_places,
)
from consistent_id.robot.kinematics import ancestors, link_places

_STRIDE = 16  # of poses of a path whose distances are computed first
_UNIT = 1e-6  # largest error of a direction's length; otherwise coal found none


@dataclass(frozen=True, slots=True, eq=False)
class Separation:
    """The separation of two bodies, for each of many poses (and pairs).

    Attributes
    ----------
    distance : ndarray, shape (queries,), [m]
        Negative where the bodies penetrate each other.
    normal : ndarray, shape (queries, 3)
        Unit vector from the first body to the second.
    points : ndarray, shape (2, queries, 3), [m]
        Nearest (or deepest) points on the first and the second body.
    """

    distance: Array
    normal: Array
    points: Array


@dataclass(frozen=True, slots=True, eq=False)
class NearestPoints:
    """Distances of all pairs of a scene, and their gradients by the joints.

    Attributes
    ----------
    pairs : tuple of Pair
    distance : ndarray, shape (samples, pairs), [m]
        Negative where bodies are in one another.
    gradient : ndarray, shape (samples, pairs, joints), [m/rad, or 1]
    normal : ndarray, shape (samples, pairs, 3)
        From the first body to the second.
    points : ndarray, shape (samples, pairs, 2, 3), [m]
        Nearest points of both, in the base frame.
    """

    pairs: tuple[Pair, ...]
    distance: Array
    gradient: Array
    normal: Array
    points: Array

    @property
    def slack(self) -> Array:
        """Distance less the required one, shape (samples, pairs) [m]."""
        wanted = np.array([pair.wanted for pair in self.pairs])
        return np.asarray(self.distance - wanted)


def nearest(
    scene: Scene,
    q: ArrayLike,
    pairs: tuple[Pair, ...] | None = None,
    *,
    within: float = np.inf,
) -> NearestPoints:
    """Return the distance of the bodies of each pair, and its gradient.

    ``d distance / dq = n^T (J_b - J_a)`` with the Jacobians of the nearest points.

    Parameters
    ----------
    q : array_like, shape (samples, joints), [rad or m]
    pairs : tuple of Pair, optional
        Some of the scene's; all without.
    within : float, [m]
        If balls around two bodies are farther apart than this, their distance is only
        bounded from below, which is faster.

    Examples
    --------
    >>> from consistent_id import DHRow, from_modified_dh
    >>> from consistent_id.motion import Body, Sphere, build_scene
    >>> arm = from_modified_dh("arm", [DHRow(0, 0)])
    >>> tip = Body("tip", Sphere(0.1), "link1", translation=[1.0, 0.0, 0.0])
    >>> post = Body("post", Sphere(0.2), translation=[0.0, 2.0, 0.0])
    >>> near = nearest(build_scene(arm, [tip, post]), [[np.pi / 2]])
    >>> near.distance.round(9).tolist()
    [[0.7]]
    """
    chosen = scene.pairs if pairs is None else tuple(pairs)
    places = body_places(scene, link_places(scene.robot, q))
    n, m = len(places.links), len(chosen)
    sample, which = (index.ravel() for index in np.indices((n, m)))
    found = separation(places, chosen, sample, which, within)
    gradient = separation_slopes(places, chosen, found, sample, which)
    return NearestPoints(
        chosen,
        found.distance.reshape(n, m),
        gradient.reshape(n, m, len(scene.robot)),
        found.normal.reshape(n, m, 3),
        found.points.transpose(1, 0, 2).reshape(n, m, 2, 3),
    )


def distances_along(
    scene: Scene, q: ArrayLike, near: Array, *, least: Array | None = None
) -> Array | None:
    """Return distances of all pairs along a path; far from each other, lower bounds.

    Poses that follow each other are alike: what joints move between them bounds the
    change of a distance (`largest_change`), and few distances are computed.

    Parameters
    ----------
    q : array_like, shape (samples, joints), [rad or m]
        In the order of the path.
    near : ndarray, shape (pairs,), [m]
        Distances below this are exact.
    least : ndarray, shape (pairs,), optional, [m]
        Return None as soon as one distance is below this.

    Returns
    -------
    ndarray, shape (samples, pairs), [m]
    """
    q = np.asarray(q, dtype=float)
    places = body_places(scene, link_places(scene.robot, q))
    every = _ball_gaps(places, scene.pairs)
    close = np.flatnonzero((every < near).any(axis=0))
    pairs, known = tuple(scene.pairs[k] for k in close), every[:, close]
    near, change = near[close], None
    least = None if least is None else least[close]
    step, done = _STRIDE, np.arange(0, len(q), _STRIDE)
    while step:
        at, pair = np.nonzero(known[done] < near)
        exact = separation(places, pairs, done[at], pair)
        known[done[at], pair] = exact.distance
        if least is not None and (exact.distance < least[pair]).any():
            return None
        step //= 2
        done = np.arange(step, len(q), 2 * step) if step else done[:0]
        change = PairChange(places, pairs) if change is None else change
        for anchor in (done - step, done + step):
            inside = anchor < len(q)
            here, there = anchor[inside], done[inside]
            bound = known[here] - change.between(q, here, there)
            known[there] = np.maximum(known[there], bound)
    every[:, close] = known
    return every


def separation_slopes(
    places: BodyPlaces,
    pairs: tuple[Pair, ...],
    found: Separation,
    sample: IntArray,
    which: IntArray,
) -> Array:
    """Return ``d distance / dq`` of separations, (queries, joints)."""
    ends = np.array([(pair.first, pair.second) for pair in pairs], dtype=np.intp)
    ends = ends.reshape(-1, 2)[which]
    first, second = (
        _along(places, sample, ends[:, side], found.points[side], found.normal)
        for side in (0, 1)
    )
    return second - first


def _along(
    places: BodyPlaces, sample: IntArray, body: IntArray, points: Array, n: Array
) -> Array:
    """``n^T J`` of points of bodies, or of directions, shape (queries, coordinates)."""
    links, robot = places.links, places.links.robot
    carrier = np.array(places.carriers, dtype=np.intp)[body]
    turning = places.turning[body]
    joints = len(robot.joints)
    rates = np.zeros((len(sample), joints))
    moves = np.zeros((joints + 1, joints), dtype=bool)
    for link in np.unique(carrier[carrier >= 0]).tolist():
        moves[link, list(ancestors(robot, link))] = True
    for j, joint in enumerate(robot.joints):
        on = np.flatnonzero(moves[carrier, j])  # the last row is for no link at all
        push, at, placed = n[on], sample[on], ~turning[on, None]
        if joint.kind != "prismatic":
            # n.(e x r) = e.(r x n)
            push = np.cross(points[on] - placed * links.translation[at, j], push)
        else:
            push = placed * push
        rates[on, j] = np.einsum("ni,ni->n", links.axis[at, j], push)
    return rates if len(robot) == joints else rates @ robot.joint_rates


def separation(
    places: BodyPlaces,
    pairs: tuple[Pair, ...],
    sample: IntArray,
    which: IntArray,
    within: float = np.inf,
) -> Separation:
    """Return the separation of pair ``which[i]`` at pose ``sample[i]``, for each ``i``.

    Beyond `within`, it is the one along the direction between the balls' centres.
    """
    first = np.array([pair.first for pair in pairs], dtype=np.intp)[which]
    second = np.array([pair.second for pair in pairs], dtype=np.intp)[which]
    normal, points = np.empty((len(which), 3)), np.empty((2, len(which), 3))
    flat = np.array([isinstance(body.shape, HalfSpace) for body in places.bodies])
    upright = flat[first] | flat[second]
    for side, sign in ((first, 1.0), (second, -1.0)):
        on = flat[side]
        normal[on] = sign * places.rotation[sample[on], side[on], :, 2]
    beyond = np.zeros(len(which), dtype=bool)
    if np.isfinite(within):
        gap, direction = balls_apart(places, sample, first, second)
        beyond = (gap > within) & ~upright
        normal[beyond] = direction[beyond]
    unknown = np.flatnonzero(~upright & ~beyond)
    normal[unknown], points[:, unknown] = _directions(
        places, sample[unknown], first[unknown], second[unknown]
    )
    far = np.stack(
        [
            _farthest(places, sample, first, normal),
            _farthest(places, sample, second, -normal),
        ]
    )
    distance = np.einsum("ni,ni->n", normal, far[1] - far[0])
    points[:, upright] = _facing(far, normal, distance, flat[first])[:, upright]
    points[:, beyond] = far[:, beyond]
    return Separation(distance, normal, points)


def balls_apart(
    places: BodyPlaces, sample: IntArray, first: IntArray, second: IntArray
) -> tuple[Array, Array]:
    """Return the distance of balls around bodies, and the direction between them.

    The bodies are never nearer.  A half-space has no ball: minus infinity.
    """
    way = places.centre[sample, second] - places.centre[sample, first]
    length = np.linalg.norm(way, axis=1)
    apart = length - places.radius[first] - places.radius[second]
    return apart, way / np.where(length > 0.0, length, 1.0)[:, None]


def _ball_gaps(places: BodyPlaces, pairs: Sequence[Pair]) -> Matrix:
    """Return the distances of balls around the bodies of pairs, (samples, pairs)."""
    ends = np.array([(p.first, p.second) for p in pairs], dtype=np.intp).reshape(-1, 2)
    first, second = ends.T
    across = np.moveaxis(places.centre, 2, 0)
    square = sum((x[:, second] - x[:, first]) ** 2 for x in across)
    radius = places.radius
    return np.asarray(np.sqrt(square) - radius[first] - radius[second])


def _facing(far: Array, normal: Array, distance: Array, first_is_flat: Array) -> Array:
    """Return the point of a body nearest to a half-space, and its foot on it."""
    step = distance[:, None] * normal
    onto_first = np.stack([far[1] - step, far[1]])
    onto_second = np.stack([far[0], far[0] + step])
    return np.where(np.asarray(first_is_flat)[:, None], onto_first, onto_second)


def _directions(
    places: BodyPlaces,
    sample: IntArray,
    first: IntArray,
    second: IntArray,
) -> tuple[Array, Array]:
    """Compute unit vectors from first to second, and the nearest points, by coal."""
    import coal

    bodies = np.concatenate([first, second])
    shapes: dict[int, Any] = {
        int(b): coal_geometry(places.bodies[b].shape) for b in np.unique(bodies)
    }
    keys = np.tile(sample, 2) * len(places.bodies) + bodies
    once, place = np.unique(keys, return_inverse=True)
    at = [
        coal.Transform3s(places.rotation[key], places.translation[key])
        for key in zip(*divmod(once, len(places.bodies)), strict=True)
    ]
    request, result = coal.DistanceRequest(), coal.DistanceResult()
    normal, points = np.empty((len(sample), 3)), np.empty((2, len(sample), 3))
    one, other = place[: len(sample)].tolist(), place[len(sample) :].tolist()
    queries = zip(first.tolist(), one, second.tolist(), other, strict=True)
    for k, (a, here, b, there) in enumerate(queries):
        result.clear()
        coal.distance(shapes[a], at[here], shapes[b], at[there], request, result)
        normal[k] = result.normal
        points[0, k] = result.getNearestPoint1()
        points[1, k] = result.getNearestPoint2()
    lost = ~(abs(np.linalg.norm(normal, axis=1) - 1.0) < _UNIT)
    if lost.any():  # for example concentric spheres: any direction is equally good
        normal[lost] = (0.0, 0.0, 1.0)
        points[0, lost] = places.centre[sample[lost], first[lost]]
        points[1, lost] = places.centre[sample[lost], second[lost]]
    return normal / np.linalg.norm(normal, axis=1, keepdims=True), points


def _farthest(places: BodyPlaces, sample: IntArray, body: IntArray, n: Array) -> Array:
    """Points of bodies farthest along directions, all in the base frame."""
    found = np.empty((len(sample), 3))
    for b in np.unique(body):
        on = np.flatnonzero(body == b)
        rotation = places.rotation[sample[on], b]
        inside = np.einsum("nij,ni->nj", rotation, n[on])
        point = places.bodies[b].shape.farthest(inside)
        turned = np.einsum("nij,nj->ni", rotation, point)
        found[on] = turned + places.translation[sample[on], b]
    return found

"""Proof that bodies stay apart along a path, at all times and not only at samples.

Around a time ``t``, a joint with velocity ``v`` there moves by at most
``min(V s, |v| s + A s^2 / 2)`` within ``s``, with bounds ``V``, ``A`` of the path's
velocity and acceleration.  `largest_change` turns this into a bound on changes of
distances, so the distance of two bodies at ``t`` gives a lower bound of their distance
around ``t``. Intervals with too low a bound are halved.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from consistent_id._support.arrays import Array, IntArray, Vector
from consistent_id._support.given_values import require_type
from consistent_id._support.tables import brief
from consistent_id.errors import InfeasibleError, ProblemError
from consistent_id.motion.collisions.scene import Scene, body_places, largest_change
from consistent_id.motion.collisions.separation import balls_apart, separation
from consistent_id.recordings.joint_paths import JointPath
from consistent_id.robot.kinematics import link_places

_FIRST = 0.1  # [s]; longest interval at the beginning
_FINEST = 1e-5  # [m]; least tolerance of a proof
_ROUNDING = 1e-9  # [m]; a large bound for sums and products of numbers of a few metres
_MOST = 1_000_000  # intervals of pairs at a time, of some hundred bytes each


@brief
@dataclass(frozen=True, slots=True)
class ClearanceReport:
    """The proven distances of the bodies of a scene along one or more paths.

    Attributes
    ----------
    first, second : str
        The two bodies with the least computed slack; empty if no pair is checked.
    path : int
        Index of the path.
    time : float, [s]
        Time on that path's clock.
    distance : float, [m]
        Their computed distance at this time; negative: depth of penetration.
    wanted : float, [m]
        Their required distance.
    margin : float, [m]
        Proven: at no time is any pair nearer than its required distance plus this.
    poses, queries : int
        Numbers of poses, and of distances of pairs, that were computed.
    """

    first: str
    second: str
    path: int
    time: float
    distance: float
    wanted: float
    margin: float
    poses: int
    queries: int

    @property
    def proven(self) -> float:
        """Proven least distance of these two bodies [m]."""
        return self.wanted + self.margin

    @property
    def violated(self) -> bool:
        """Whether bodies are nearer than required at some computed pose."""
        return self.distance < self.wanted

    @property
    def holds(self) -> bool:
        """Whether all required distances are proven to be kept at all times."""
        return self.margin >= 0.0 and not self.violated

    def require(self) -> None:
        """Raise unless all distances are proven.

        Raises
        ------
        InfeasibleError
            With the bodies, the time, their distance and the required one.
        """
        if self.holds:
            return
        where = (
            f"bodies {self.first!r} and {self.second!r} at {self.time:.4f} s of path "
            f"{self.path}"
        )
        wanted = f"at least {self.wanted * 1e3:.2f} mm are required"
        if not self.violated:
            raise InfeasibleError(
                f"{where} are {self.distance * 1e3:.2f} mm apart, and {wanted}, but no "
                f"more than {self.proven * 1e3:.2f} mm could be proven for all time; "
                "leave more clearance, or move more slowly there"
            )
        seen = (
            f"are {self.distance * 1e3:.2f} mm apart"
            if self.distance >= 0.0
            else f"penetrate each other by {-self.distance * 1e3:.2f} mm"
        )
        raise InfeasibleError(
            f"{where} {seen}, but {wanted}; change the path, or, if they may touch, "
            "name the pair in `allowed`"
        )


def prove_clearance(
    scene: Scene, paths: JointPath | Sequence[JointPath], *, tolerance: float = 1e-3
) -> ClearanceReport:
    """Prove the distances of bodies along paths, at all times.

    Parameters
    ----------
    scene : Scene
    paths : JointPath or sequence of them
        All paths that will be played: from the start pose, the trajectory, and back.
        Joints are matched by name.
    tolerance : float, [m]
        Largest difference of proven and computed distance; it is less where bodies are
        near, down to 0.01 mm.

    Raises
    ------
    ProblemError
        If a path has other joints than the scene's robot.

    Examples
    --------
    >>> from consistent_id import DHRow, from_modified_dh
    >>> from consistent_id.motion import Body, Sphere, build_scene
    >>> from consistent_id.recordings.joint_paths import FourierTrajectory
    >>> arm = from_modified_dh("arm", [DHRow(0, 0)])
    >>> tip = Body("tip", Sphere(0.1), "link1", translation=[1.0, 0.0, 0.0])
    >>> post = Body("post", Sphere(0.2), translation=[0.0, 2.0, 0.0])
    >>> swing = FourierTrajectory(("joint1",), [0.5], [0.0], [[1.0]], [[0.0]], 2.0)
    >>> report = prove_clearance(build_scene(arm, [tip, post]), swing)
    >>> report.holds, round(report.time, 1), round(report.distance, 2)
    (True, 0.5, 0.98)
    """
    require_type(scene, Scene, "scene")
    if not 0.0 < tolerance < np.inf:
        raise ProblemError(f"tolerance is {tolerance} m, expected more than 0")
    every = list(paths) if isinstance(paths, Sequence) else [paths]
    for path in every:
        require_type(path, JointPath, "paths")
    if not every:
        raise ProblemError("no path to check, expected one or more")
    return worst_clearance([_proof(scene, path, tolerance) for path in every])


def worst_clearance(reports: Sequence[ClearanceReport]) -> ClearanceReport:
    """Return one report for several paths, from their own reports."""
    k = int(np.argmin([report.distance - report.wanted for report in reports]))
    return replace(
        reports[k],
        path=k,
        margin=min(report.margin for report in reports),
        poses=sum(report.poses for report in reports),
        queries=sum(report.queries for report in reports),
    )


@dataclass(frozen=True, slots=True, eq=False)
class _BoundedPath:
    """A path in the robot's order of joints, with bounds of its derivatives."""

    path: JointPath
    order: list[int]
    velocity: Vector
    acceleration: Vector

    def steps(self, velocity: Array, half: float) -> Array:
        """Largest motion of joints within `half` s of a time with `velocity`."""
        curved = abs(velocity) * half + self.acceleration * (half**2 / 2.0)
        return np.minimum(self.velocity * half, curved)


def _motion(scene: Scene, path: JointPath) -> _BoundedPath:
    names, own = scene.robot.joint_names, tuple(path.joints)
    if set(names) != set(own) or len(own) != len(names):
        raise ProblemError(
            f"the path moves joints {own}, but the scene's robot has {names}"
        )
    order = [own.index(name) for name in names]
    velocity, acceleration = (path.derivative_bound(k)[order] for k in (1, 2))
    return _BoundedPath(path, order, velocity, acceleration)


@dataclass(slots=True)
class _LeastSlack:
    """The state of a search for the least slack: computed and proven values.

    The search ends when the least slack is known to `tolerance`.
    """

    scene: Scene
    motion: _BoundedPath
    tolerance: float
    best: float = np.inf
    distance: float = np.inf
    pair: int = -1
    time: float = 0.0
    margin: float = np.inf
    poses: int = 0
    queries: int = 0

    def saw(self, slack: Array, distance: Array, which: IntArray, time: Array) -> None:
        self.queries += len(slack)
        if len(slack) and slack.min() < self.best:
            k = int(slack.argmin())
            self.best, self.distance = float(slack[k]), float(distance[k])
            self.pair, self.time = int(which[k]), float(time[k])

    @property
    def floor(self) -> float:
        """Slack that is currently to be proven."""
        allowed = self.tolerance
        # Half the clearance, so that a clearance that is kept can be proven
        if self.best > 0.0:
            allowed = min(self.tolerance, max(self.best / 2.0, _FINEST))
        return self.best - allowed

    def level(self, interval: IntArray, which: IntArray, half: float) -> Array:
        """Return the proven slack of pairs in intervals of one length."""
        scene, motion = self.scene, self.motion
        places_in, sample = np.unique(interval, return_inverse=True)
        time = motion.path.start + (2 * places_in + 1) * half
        q, dq = motion.path.evaluate(time, 1)[:, :, motion.order]
        self.poses += len(time)
        places = body_places(scene, link_places(scene.robot, q))
        steps = motion.steps(dq, half)
        first, second = np.array([(p.first, p.second) for p in scene.pairs])[which].T
        apart, _ = balls_apart(places, sample, first, second)
        change = np.empty(len(which))
        for k in np.unique(which):
            on = np.flatnonzero(which == k)
            at = sample[on]
            change[on] = largest_change(places, scene.pairs[k], at, steps[at])
        wanted = np.array([pair.wanted for pair in scene.pairs])[which]
        near = ~(apart - change - wanted >= self.floor)
        found = separation(places, scene.pairs, sample[near], which[near])
        slack = found.distance - wanted[near]
        self.saw(slack, found.distance, which[near], time[sample[near]])
        apart[near] = np.maximum(apart[near], found.distance)
        return np.asarray(apart - change - wanted - _ROUNDING)


def _proof(scene: Scene, path: JointPath, tolerance: float) -> ClearanceReport:
    search = _LeastSlack(scene, _motion(scene, path), tolerance, time=path.start)
    count = max(1, int(np.ceil(path.duration / _FIRST)))
    interval, which = (index.ravel() for index in np.indices((count, len(scene.pairs))))
    half = path.duration / count / 2.0
    while len(which):
        lower = search.level(interval, which, half)
        unproven = lower < search.floor
        if 2 * np.count_nonzero(unproven) > _MOST:
            unproven[:] = False  # gives up: the proven bound remains
        proven = lower[~unproven].min(initial=np.inf)
        search.margin = min(search.margin, float(proven))
        left = 2 * interval[unproven]
        interval = np.concatenate([left, left + 1])
        which = np.tile(which[unproven], 2)
        half /= 2.0
    first, second, wanted = "", "", 0.0
    if search.pair >= 0:
        pair = scene.pairs[search.pair]
        (first, second), wanted = scene.names(pair), pair.wanted
    return ClearanceReport(
        first=first,
        second=second,
        path=0,
        time=search.time,
        distance=search.distance,
        wanted=wanted,
        margin=search.margin,
        poses=search.poses,
        queries=search.queries,
    )

"""Proof that bodies stay apart along a path, at every time and not just at samples.

Around a time ``t``, a joint with velocity ``v`` there moves by at most
``min(V s, |v| s + A s^2 / 2)`` within ``s``, with bounds ``V``, ``A`` of the path's
velocity and acceleration.  `largest_change` turns that into a bound on distances, so
from what separates two bodies at ``t`` follows what separates them at least around it.
Intervals of which too little is known are halved.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from consistent_id._support.arrays import Array, IntArray, Vector
from consistent_id.errors import InfeasibleError, ProblemError
from consistent_id.motion.collisions.scene import Scene, body_places, largest_change
from consistent_id.motion.collisions.separation import balls_apart, separation
from consistent_id.recordings.joint_paths import JointPath
from consistent_id.robot.kinematics import link_places

_FIRST = 0.1  # [s]; intervals to begin with are no longer
_FINEST = 1e-5  # [m]; how near a proof may have to come to the truth
_ROUNDING = 1e-9  # [m]; generous for sums and products of numbers of a few metres
_MOST = 1_000_000  # intervals of pairs at a time, of some hundred bytes each


@dataclass(frozen=True, slots=True)
class ClearanceReport:
    """How far apart the bodies of a scene stay along one or more paths.

    Attributes
    ----------
    first, second : str
        The two bodies with the least slack seen; empty if no pair is watched.
    path : int
        On which of the paths.
    time : float, [s]
        When, on that path's clock.
    distance : float, [m]
        How far apart they were seen then; negative: how deep in one another.
    wanted : float, [m]
        How far apart they must be.
    margin : float, [m]
        Proven: at no time is any pair nearer than its wanted distance plus this.
    poses, queries : int
        How many poses, and distances of pairs, it took.
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
        """Distance below which these two bodies never are [m]."""
        return self.wanted + self.margin

    @property
    def violated(self) -> bool:
        """Whether a pose was seen at which bodies are nearer than wanted."""
        return self.distance < self.wanted

    @property
    def holds(self) -> bool:
        """Whether all wanted distances are proven to be kept at all times."""
        return self.margin >= 0.0 and not self.violated

    def require(self) -> None:
        """Raise unless it holds.

        Raises
        ------
        InfeasibleError
            With the bodies, the time, their distance and what was wanted.
        """
        if self.holds:
            return
        where = (
            f"bodies {self.first!r} and {self.second!r} at {self.time:.4f} s of path "
            f"{self.path}"
        )
        wanted = f"at least {self.wanted * 1e3:.2f} mm are wanted"
        if not self.violated:
            raise InfeasibleError(
                f"{where} are {self.distance * 1e3:.2f} mm apart, and {wanted}, but no "
                f"more than {self.proven * 1e3:.2f} mm could be proven for all time; "
                "leave more clearance, or move more slowly there"
            )
        seen = (
            f"are {self.distance * 1e3:.2f} mm apart"
            if self.distance >= 0.0
            else f"are {-self.distance * 1e3:.2f} mm deep in one another"
        )
        raise InfeasibleError(
            f"{where} {seen}, but {wanted}; change the path, or, if they may touch, "
            "name the pair in `allowed`"
        )


def prove_clearance(
    scene: Scene, paths: JointPath | Sequence[JointPath], *, tolerance: float = 1e-3
) -> ClearanceReport:
    """Prove how far apart bodies stay along paths, at every time.

    Parameters
    ----------
    scene : Scene
    paths : JointPath or sequence of them
        All that will be played: the way from the start pose, the trajectory, and the
        way back.  Joints are matched by name.
    tolerance : float, [m]
        How far what is proven may be below what was seen; where bodies are near,
        it is less, down to 0.01 mm.

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
    if not 0.0 < tolerance < np.inf:
        raise ProblemError(f"tolerance is {tolerance} m, expected more than 0")
    every = list(paths) if isinstance(paths, Sequence) else [paths]
    if not every:
        raise ProblemError("no path to check, expected one or more")
    return worst_clearance([_proof(scene, path, tolerance) for path in every])


def worst_clearance(reports: Sequence[ClearanceReport]) -> ClearanceReport:
    """Return one report of several paths, each of which has one of its own."""
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
        """How far joints move at most within `half` s of where they have `velocity`."""
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
    """The state of a search for the least slack: what was seen, what is proven."""

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

    def floor(self, tolerance: float) -> float:
        """Slack that has to be proven for now."""
        allowed = tolerance
        if self.best > 0.0:  # half the clearance, so that what is kept can be proven
            allowed = min(tolerance, max(self.best / 2.0, _FINEST))
        return self.best - allowed


def _proof(scene: Scene, path: JointPath, tolerance: float) -> ClearanceReport:
    motion = _motion(scene, path)
    search = _LeastSlack(time=path.start)
    count = max(1, int(np.ceil(path.duration / _FIRST)))
    interval, which = (index.ravel() for index in np.indices((count, len(scene.pairs))))
    half = path.duration / count / 2.0
    while len(which):
        lower = _level(scene, motion, search, interval, which, half, tolerance)
        unproven = lower < search.floor(tolerance)
        if 2 * np.count_nonzero(unproven) > _MOST:
            unproven[:] = False  # gives up: what is proven is what there is
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


def _level(
    scene: Scene,
    motion: _BoundedPath,
    search: _LeastSlack,
    interval: IntArray,
    which: IntArray,
    half: float,
    tolerance: float,
) -> Array:
    """Return the slack that pairs are proven to have in intervals of one length."""
    places_in, sample = np.unique(interval, return_inverse=True)
    time = motion.path.start + (2 * places_in + 1) * half
    q, dq = motion.path.evaluate(time, 1)[:, :, motion.order]
    search.poses += len(time)
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
    near = ~(apart - change - wanted >= search.floor(tolerance))
    found = separation(scene, places, scene.pairs, sample[near], which[near])
    search.saw(
        found.distance - wanted[near], found.distance, which[near], time[sample[near]]
    )
    apart[near] = np.maximum(apart[near], found.distance)
    return np.asarray(apart - change - wanted - _ROUNDING)

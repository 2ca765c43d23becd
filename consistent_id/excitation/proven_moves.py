"""Moves along a proven path whose run-in and run-out are proven, too.

The straight path is tried first.  If bodies are in the way, a periodic path may begin
in another phase, or run-in and run-out may go through other poses: two trees of
straight pieces grow from both ends towards random poses and towards each other, until
they meet [Kuffner2000]_; then corners are cut off.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np

from consistent_id._support.arrays import BoolArray, Matrix, Vector
from consistent_id.errors import ConsistentIdError, InfeasibleError, ProblemError
from consistent_id.excitation.verification import Demands, PathProof, combined
from consistent_id.motion.collisions.separation import nearest
from consistent_id.motion.limits import MotionLimits
from consistent_id.motion.moves import Move, move_along
from consistent_id.recordings.joint_paths import FourierTrajectory

# Speeds of moves between poses at rest: slower ones need less torque
_PACES = (1.0, 0.5, 0.25)
_PHASES = 16  # number of phases of a period in which a path may begin
_SWINGS = 4  # phases for which moves through other poses are searched
_TRIES = 2  # tries of such a move: a pose free at samples may be too near for a proof
_LOOKS = 40  # samples of a piece of a move, before a proof
_ROOM = 0.005  # [m]; additional distance of such a move, if its ends have it
_SAME = 1e-9  # share of a duration, or of a velocity, that is rounding

_STEP = 0.01  # share of a joint's range, at most, between checked poses
_REACH = 0.25  # share of a joint's range by which a tree grows at a time
_GROWTHS = 300  # most poses of the trees
_CUTS = 60  # shortcuts that are tried

Free = Callable[[Matrix], BoolArray]

Reached = Callable[[Vector, Vector], Vector]


@dataclass(frozen=True, slots=True, eq=False)
class ProvenMove:
    """A move from rest to rest, and its proof.

    Parameters
    ----------
    note : str
        How run-in and run-out avoid bodies in their way; empty if there are none.
    """

    move: Move
    proof: PathProof
    note: str


@dataclass(frozen=True, slots=True)
class _Way:
    """One way to play a path.

    Parameters
    ----------
    later : float, [s]
        Time after the start of the path at which it begins.
    made : callable
        Returns the move, or None if there is none.
    """

    note: str
    later: float
    made: Callable[[], Move | None]


class Playing(NamedTuple):
    """The way in which a path is played.

    Parameters
    ----------
    pose : dict of str to float, optional, [rad or m]
        Pose from which the robot starts and to which it returns.
    periods : int, optional
        Number of times that the path is played.
    smooth : bool
        See `move_along`.
    """

    pose: dict[str, float] | None
    periods: int | None = None
    smooth: bool = False


def proven_move(
    path: FourierTrajectory,
    proof: PathProof,
    demands: Demands,
    played: Playing,
    *,
    seed: int = 0,
) -> ProvenMove:
    """Return a move along a proven path, from a pose and back to it.

    The path is proven once: a proof over one period is valid for all of them, and in
    every phase.

    Parameters
    ----------
    proof : PathProof
        Proof of this path.
    played : Playing
        From where, how often, and how smoothly.
    seed : int
        Seed of moves through other poses.

    Raises
    ------
    ProblemError, InfeasibleError
        If no move is found; the message names the bodies in the straight one.
    """
    cause: ConsistentIdError | None = None
    for number, way in enumerate(_ways(path, demands, played, seed)):
        try:
            move = way.made()
            if move is None or (number and not _seems_clear(move, demands)):
                continue
            return ProvenMove(move, _whole(move, path, proof, demands, way), way.note)
        except (InfeasibleError, ProblemError) as failed:
            cause = cause or failed
    tried = "the straight way" if played.pose is None else "straight ways and others"
    raise InfeasibleError(f"{cause}; of {tried}, none was proven") from cause


def _ways(
    path: FourierTrajectory,
    demands: Demands,
    played: Playing,
    seed: int,
) -> Iterator[_Way]:
    """Yield ways to play a path, the simplest first."""
    pose, periods, smooth = played
    limits, rng = demands.limits, np.random.default_rng(seed)

    def along(
        some: FourierTrajectory,
        within: MotionLimits,
        via: tuple[Matrix | None, Matrix | None] = (None, None),
    ) -> Move:
        return move_along(
            some, within, from_pose=pose, to_pose=pose, periods=periods,
            from_via=via[0], to_via=via[1], smooth=smooth,
        )  # fmt: skip

    phases = _phases(path)
    paces = (1.0,) if len(phases) > 1 else _PACES
    for pace in paces:
        yield _Way(_slower(pace), 0.0, partial(along, path, _paced(limits, pace)))
    for later in phases[1:]:
        some = path.begun_later(later)
        yield _Way(_phased(later), later, partial(along, some, limits))
    if pose is None or demands.scene is None:
        return

    def around(some: FourierTrajectory, within: MotionLimits) -> Move | None:
        via = _detours(move_along(some, limits, periods=periods), demands, pose, rng)
        return None if via is None else along(some, within, via)

    for later in phases[:_SWINGS]:
        for pace in paces * _TRIES:
            words = ("run-in and run-out go through other poses", _phased(later))
            note = ", ".join(word for word in (*words, _slower(pace)) if word)
            made = partial(around, path.begun_later(later), _paced(limits, pace))
            yield _Way(note, later, made)


def _phases(path: FourierTrajectory) -> list[float]:
    """Return the times of the path at which it may begin, 0 first [s]."""
    period = path.period
    velocity = path.evaluate([path.start], 1)[1, 0]
    rests = (abs(velocity) <= _SAME * path.derivative_bound(1)).all()
    if rests or period is None or abs(period - path.duration) > _SAME * period:
        return [0.0]
    # By bisection, so that the first few are far apart.
    order = sorted(
        range(_PHASES), key=lambda k: f"{k:0{_PHASES.bit_length() - 1}b}"[::-1]
    )
    return [period * k / _PHASES for k in order]


def _phased(later: float) -> str:
    return f"begun {later:.2f} s into the period" if later else ""


def _slower(pace: float) -> str:
    return "" if pace == 1.0 else f"run-in and run-out at {100.0 * pace:.0f} % of speed"


def _paced(limits: MotionLimits, pace: float) -> MotionLimits:
    return replace(
        limits,
        velocity=pace * limits.velocity,
        acceleration=pace**2 * limits.acceleration,
        jerk=pace**3 * limits.jerk,
    )


def _detours(
    swings: Move, demands: Demands, pose: dict[str, float], rng: np.random.Generator
) -> tuple[Matrix, Matrix] | None:
    """Return poses on the way to a move's first pose, and back."""
    home = np.array([pose[joint] for joint in swings.joints])
    ends = swings.evaluate([swings.start, swings.start + swings.duration], 0)[0]
    free = _free(demands, np.vstack([home, ends]))
    span = demands.limits.lower, demands.limits.upper
    before = via_poses(home, ends[0], span, free, rng)
    after = None if before is None else via_poses(ends[1], home, span, free, rng)
    if before is None or after is None:
        return None
    # A path at rest begins where the way ends; a swing begins from a pose of its own.
    first = ends[:1] if swings.run_in else ends[:0]
    last = ends[1:] if swings.run_out else ends[:0]
    return np.vstack([before, first]), np.vstack([last, after])


def _free(demands: Demands, ends: Matrix) -> Free:
    """Return a test for poses with as much clearance as the ends."""
    scene = demands.scene
    if scene is None or not scene.pairs:
        return lambda poses: np.ones(len(poses), dtype=bool)
    within = max(pair.wanted for pair in scene.pairs) + _ROOM

    def slack(poses: Matrix) -> Vector:
        return np.asarray(nearest(scene, poses, within=within).slack.min(axis=1))

    room = float(np.clip(slack(ends).min() / 2.0, 0.0, _ROOM))

    def free(poses: Matrix) -> BoolArray:
        return np.asarray(slack(poses) >= room)

    return free


def _seems_clear(move: Move, demands: Demands) -> bool:
    """Return whether run-in and run-out are clear at samples."""
    scene, pieces = demands.scene, (*move.run_in, *move.run_out)
    if scene is None or not scene.pairs or not pieces:
        return True
    poses = [
        p.evaluate(p.start + p.duration * np.linspace(0.0, 1.0, _LOOKS), 0)[0]
        for p in pieces
    ]
    return bool((nearest(scene, np.vstack(poses)).slack >= 0.0).all())


def _whole(
    move: Move, path: FourierTrajectory, proof: PathProof, demands: Demands, way: _Way
) -> PathProof:
    """Return the proof of a move along a path that is proven already."""
    proofs: dict[str, list[PathProof]] = {}
    brief = demands.of_short_motion
    for name, pieces in (("run-in", move.run_in), ("run-out", move.run_out)):
        proofs[name] = [brief.proof(piece) for piece in pieces]
        try:
            if pieces:
                combined(proofs[name]).require()
        except InfeasibleError as cause:
            raise InfeasibleError(f"{name}: {cause}") from None

    def clock(time: float) -> float:
        since = time - path.start
        if way.later:
            since = (since - way.later) % path.duration
        return move.trajectory.start + since

    return combined([*proofs["run-in"], proof.retimed(clock), *proofs["run-out"]])


def via_poses(
    begin: Vector,
    end: Vector,
    span: tuple[Vector, Vector],
    free: Free,
    rng: np.random.Generator,
) -> Matrix | None:
    """Return poses between two others, connected by free straight paths.

    Parameters
    ----------
    begin, end : ndarray, shape (joints,), [rad or m]
    span : tuple of two ndarray, shape (joints,), [rad or m]
        Least and greatest position of each joint.
    free : function
        From poses, shape (poses, joints), to whether each is free.

    Returns
    -------
    ndarray, shape (poses, joints), or None if no way was found
        Without the two ends; empty if the straight path is free.

    Examples
    --------
    >>> def beside_the_wall(q):  # which is open above 1
    ...     return (abs(q[:, 0]) > 0.2) | (q[:, 1] > 1.0)
    >>> ends = np.array([-1.0, 0.0]), np.array([1.0, 0.0])
    >>> span = np.array([-2.0, -2.0]), np.array([2.0, 2.0])
    >>> way = via_poses(*ends, span, beside_the_wall, np.random.default_rng(0))
    >>> bool(way[:, 1].max() > 1.0)
    True
    """
    low, high = span
    width = high - low

    def unit(pose: Vector) -> Vector:
        return np.asarray((pose - low) / width)

    def reached(here: Vector, there: Vector) -> Vector:
        """Return the last free pose on the way, in shares of the ranges."""
        count = max(int(np.ceil(abs(there - here).max() / _STEP)), 1)
        way = here + np.linspace(0.0, 1.0, count + 1)[1:, None] * (there - here)
        walls = np.flatnonzero(~free(low + way * width))
        if not len(walls):
            return there
        return here if walls[0] == 0 else np.asarray(way[walls[0] - 1])

    found = _connected(unit(begin), unit(end), reached, rng)
    if found is None:
        return None
    return np.asarray(low + _shortened(found, reached, rng)[1:-1] * width)


def _connected(
    begin: Vector, end: Vector, reached: Reached, rng: np.random.Generator
) -> Matrix | None:
    """Return a free way of straight pieces, both ends included."""
    grown, other = _Tree(begin), _Tree(end)
    forwards = True
    for growth in range(_GROWTHS):
        goal = end if growth == 0 else rng.uniform(size=len(begin))
        near = grown.nearest(goal)
        away = goal - grown.poses[near]
        if growth:
            away = away * min(1.0, _REACH / abs(away).max())
        new = reached(grown.poses[near], grown.poses[near] + away)
        if not np.array_equal(new, grown.poses[near]):
            grown.add(new, near)
            meeting = other.nearest(new)
            last = reached(other.poses[meeting], new)
            if not np.array_equal(last, other.poses[meeting]):
                meeting = other.add(last, meeting)
            if np.array_equal(last, new):
                there = grown.back_from(len(grown.poses) - 1)[::-1]
                back = other.back_from(meeting)[1:]
                way = np.array([*there, *back])
                return way if forwards else way[::-1]
        grown, other, forwards = other, grown, not forwards
    return None


class _Tree:
    """Poses, each but the first reached from one before it."""

    def __init__(self, root: Vector) -> None:
        self.poses, self.parents = [root], [-1]

    def nearest(self, pose: Vector) -> int:
        return int(np.argmin(abs(np.array(self.poses) - pose).max(axis=1)))

    def add(self, pose: Vector, parent: int) -> int:
        self.poses.append(pose)
        self.parents.append(parent)
        return len(self.poses) - 1

    def back_from(self, place: int) -> list[Vector]:
        """Return the poses from one of them back to the root."""
        way = []
        while place >= 0:
            way.append(self.poses[place])
            place = self.parents[place]
        return way


def _shortened(way: Matrix, reached: Reached, rng: np.random.Generator) -> Matrix:
    """Return a way with fewer corners: two poses of it, at random, are joined."""
    for _ in range(_CUTS):
        if len(way) < 3:
            break
        first, last = np.sort(rng.choice(len(way), 2, replace=False))
        if last - first < 2:
            continue
        if np.array_equal(reached(way[first], way[last]), way[last]):
            way = np.vstack([way[: first + 1], way[last:]])
    return way

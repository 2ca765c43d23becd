"""The search for a trunk's path that identifies its ten parameters best."""

from collections.abc import Callable
from dataclasses import dataclass
from time import process_time

import numpy as np

from consistent_id._support.arrays import Array, Vector
from consistent_id._support.executors import single_threaded
from consistent_id._support.run import noted_interrupts
from consistent_id._support.tables import brief
from consistent_id.errors import InfeasibleError, NotExcitedError, ProblemError
from consistent_id.recordings.recording import Recording
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.rows.contact_free import (
    contact_free_model,
    contact_free_regression,
)
from consistent_id.robot.inertia import InertialParameters
from consistent_id.robot.parameters import did_you_mean
from consistent_id.standing.forces_and_limits import (
    StandingLimits,
    StandingMotion,
    nominal_of,
    standing_motion,
)
from consistent_id.standing.stance import Stance, joint_motion
from consistent_id.standing.trunk_path import (
    HIGHEST,
    NOTHING_FOUND,
    Tried,
    TrunkPath,
    searched_tones,
)

REST = 0.03
"""rad/s or m/s, below which a joint's torque is not used: at rest, dry friction has any
value that balances it (`without_rests`; benchmarks/quadruped.py: with such joints the
moments of G1's torso are 6 % off, without them 1 %).
"""

_THIN = 0.01  # m; no trunk is thinner, whatever a file says

CHECK_RATE = 500.0
"""Hz, at which limits of the final motion are looked at."""

_PER_PERIOD = 4  # samples per period of the fastest sinusoid in the search
_TRIES = 10  # times that a candidate's amplitude is put right
_USED = 0.88, 0.99  # share of the tightest limit that a candidate uses


@brief
@dataclass(frozen=True, slots=True, eq=False)
class StandingDesign:
    """A motion on feet that was searched for.

    Attributes
    ----------
    stance : Stance
    model : TorqueModel
    limits : StandingLimits
    path : TrunkPath
    link : str
        The trunk: the body that is not known.
    errors : ndarray, shape (10,)
        Standard errors of its parameters for torque noise of 1 N m, all other bodies
        being known: of `INERTIAL_NAMES`.
    first : float
        How many times larger the `relative_size` of the errors was on the best random
        path.
    checked : StandingMotion
        At `CHECK_RATE`.
    candidates : int
        Paths that were tried.
    seconds : float
        Processor time.
    cut_short : str
        The reason why the search ended before all candidates were tried; empty without.
    """

    stance: Stance
    model: TorqueModel
    limits: StandingLimits
    path: TrunkPath
    link: str
    errors: Vector
    first: float
    checked: StandingMotion
    candidates: int
    seconds: float
    cut_short: str = ""

    def recording(self, rate: float) -> Recording:
        """Return the joints' motion at a rate [Hz]."""
        time = np.linspace(0, self.path.duration, round(self.path.duration * rate) + 1)
        moved = joint_motion(self.stance, self.path.motion(time, self._gravity))
        names = self.stance.robot.joint_names
        return Recording(names, time, moved.q, moved.dq, moved.ddq, name="standing")

    @property
    def _gravity(self) -> Vector:
        return np.asarray(self.stance.robot.gravity)


@single_threaded
def design_standing(
    stance: Stance,
    model: TorqueModel,
    limits: StandingLimits | None = None,
    *,
    link: str | None = None,
    duration: float = 20.0,
    candidates: int = 320,
    seed: int = 0,
    time_limit: float = np.inf,
    tell: Callable[[int, float], None] | None = None,
) -> StandingDesign:
    """Search for the motion of a trunk over standing feet that identifies it best.

    The search minimises the root mean square of the standard errors of the trunk's ten
    parameters, relative to its own size (`relative_size`; A-optimality), of paths that
    are as large as their limits allow; see `searched_tones`.

    Parameters
    ----------
    stance : Stance
    model : TorqueModel
        Model whose drive terms are unknown beside the trunk.
    limits : StandingLimits, optional
    link : str, optional
        The body that is not known, such as a torso above the base; by default the base.
    duration : float, [s]
    candidates : int
        How many paths are tried.
    seed : int
    time_limit : float, [s]
        Processor time after which the search ends with the best path so far; without
        any, it goes on for as long again.  An interrupt and a SIGTERM end it in the
        same way, at once.
    tell : callable, optional
        Given how many candidates were tried, and the least size of errors so far.

    Raises
    ------
    InfeasibleError
        If the robot cannot stand in the pose, or not move in it.
    KeyboardInterrupt
        If the user ended the search before any path was found.
    """
    started = process_time()
    chosen = StandingLimits() if limits is None else limits
    samples = int(_PER_PERIOD * HIGHEST * duration)
    time = duration * (np.arange(samples) + 0.5) / samples
    number = link_number(stance, link)
    _require_stance(stance, chosen, duration)

    trial = _Trial(stance, model, chosen, time, number)

    def used() -> float:
        return process_time() - started

    found = NOTHING_FOUND
    with noted_interrupts(keeps_results=True) as interrupted:
        for found in searched_tones(trial.tried, duration, candidates, seed):
            if tell is not None:
                tell(found.count, found.best.error)
            allowed = time_limit * (1 if found.best.path is not None else 2)
            if interrupted() or used() > allowed:
                break
        stopped = interrupted()
    ended = "an interrupt" if stopped else f"the time limit of {time_limit:g} s"
    if found.best.path is None and stopped:
        raise KeyboardInterrupt
    if found.best.path is None:
        raise _nothing_found(found.count, candidates, time_limit)
    motion, path = _checked(stance, chosen, found.best.path)
    return StandingDesign(
        stance=stance,
        model=model,
        limits=chosen,
        path=path,
        link=stance.robot.link_names[number],
        errors=trunk_errors(stance, model, motion, CHECK_RATE, link),
        first=found.first / found.best.error,
        checked=motion,
        candidates=found.count,
        seconds=used(),
        cut_short=ended if found.count < candidates else "",
    )


def _nothing_found(count: int, candidates: int, time_limit: float) -> InfeasibleError:
    """Return the error of a search that ended without a path."""
    ended = ""
    if count < candidates:
        ended = (
            f"{2 * time_limit:g} s, twice the time limit, ended the search after "
            f"{count} of {candidates} paths: "
        )
    return InfeasibleError(
        f"{ended}none of {count} paths of the trunk keeps its limits; allow more "
        "velocity or friction, choose a pose further from stretched legs, or a longer "
        "duration"
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Trial:
    """The trial of paths of the trunk, at some times.

    Parameters
    ----------
    time : ndarray, shape (samples,), [s]
    number : int
        The link that is not known.
    """

    stance: Stance
    model: TorqueModel
    limits: StandingLimits
    time: Vector
    number: int

    def tried(self, path: TrunkPath) -> Tried:
        """Return a candidate that uses its limits, and its error."""
        for _ in range(_TRIES):
            motion = standing_motion(self.stance, self.limits, path, self.time)
            share = motion.largest
            if _USED[0] <= share <= _USED[1]:
                break
            path = path.scaled(0.5 if not share < 50.0 else 0.95 / share**0.9)
        if not motion.largest <= _USED[1]:
            return Tried(None, np.inf)
        try:
            factor = trunk_factor(self.stance, self.model, motion, self.number)
        except NotExcitedError:
            return Tried(None, np.inf)
        errors = np.linalg.norm(np.linalg.inv(factor), axis=1)
        nominal = nominal_of(self.stance.robot).reshape(-1, 10)[self.number]
        return Tried(path, relative_size(errors, InertialParameters(nominal)))


def _require_stance(stance: Stance, limits: StandingLimits, duration: float) -> None:
    """Refuse a pose in which the robot cannot even stand still."""
    path = TrunkPath(np.ones(1), np.zeros((2, 1, 6)), duration)
    motion = standing_motion(stance, limits, path, np.array([0.5 * duration]))
    if motion.largest > 1.0:
        if motion.joints.singular:
            raise InfeasibleError(
                "a leg is stretched in this pose, and cannot follow the trunk; bend "
                "the knees: --stance JOINT=POSITION ..."
            )
        worst = max(motion.uses, key=lambda use: use.share)
        raise InfeasibleError(
            f"the robot cannot stand still in this pose: {worst.what} of {worst.of} is "
            f"{worst.share:.0%} of its limit; choose another pose or friction: "
            "--stance, --friction"
        )


def _checked(
    stance: Stance, limits: StandingLimits, path: TrunkPath
) -> tuple[StandingMotion, TrunkPath]:
    """Look at a path densely, and make it smaller as long as that is too much."""
    time = np.linspace(0.0, path.duration, round(path.duration * CHECK_RATE) + 1)
    while True:
        motion = standing_motion(stance, limits, path, time)
        if motion.largest <= 1.0:
            return motion, path
        path = path.scaled(0.98)


def trunk_errors(
    stance: Stance,
    model: TorqueModel,
    motion: StandingMotion,
    rate: float,
    link: str | None = None,
) -> Vector:
    """Return standard errors of the trunk's ten parameters, shape (10,).

    Of `INERTIAL_NAMES`, for torque noise of 1 N m that is white at a rate [Hz]; drive
    terms are unknown, bodies of the other links known.  Rows are those that no force of
    the ground enters, without joints slower than `REST`.  The trunk is a link of the
    robot, by default the base.

    Parameters
    ----------
    stance : Stance
    model : TorqueModel
    motion : StandingMotion
    rate : float, [Hz]
    link : str, optional
        The trunk; by default the base.

    Raises
    ------
    NotExcitedError
        If the motion does not determine all ten.
    """
    factor = trunk_factor(stance, model, motion, link_number(stance, link))
    share = len(motion.time) / (rate * (motion.time[-1] - motion.time[0]))
    inverse = np.linalg.inv(factor)
    return np.asarray(np.sqrt(share) * np.linalg.norm(inverse, axis=1))


def link_number(stance: Stance, link: str | None) -> int:
    """Return which link is to be identified, by default the base."""
    names = stance.robot.link_names
    if link is not None and link not in names:
        near = did_you_mean(link, names)
        raise ProblemError(f"no link {link!r} to identify; {near}")
    return 0 if link is None else names.index(link)


def relative_size(errors: Vector, trunk: InertialParameters) -> float:
    """Return the root mean square of a body's ten errors, relative to its own size.

    With ``m s_i^2 = J_ii``, of its mass and pseudo-inertia, units are ``m``, ``m s_i``
    of first moments, and ``sqrt(I_ii I_jj)`` of moments, ``I_ii = m (s_j^2 + s_k^2)``.
    """
    m = trunk.mass
    squares = np.diagonal(trunk.pseudo_inertia)[:3] / m
    squares = np.maximum(squares, _THIN**2)
    d = np.sqrt(m * (squares.sum() - squares))
    moments = [d[i] * d[j] for i, j in ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2))]
    units = np.array([m, *(m * np.sqrt(squares)), *moments])
    return float(np.sqrt(np.mean((errors / units) ** 2)))


def trunk_factor(
    stance: Stance, model: TorqueModel, motion: StandingMotion, number: int
) -> Array:
    """Return the triangle of the trunk's columns, those of drives taken out of them."""
    n, moved = len(motion.time), motion.joints
    log = Recording(
        stance.robot.joint_names,
        motion.time,
        moved.q,
        moved.dq,
        moved.ddq,
        np.zeros_like(moved.q),
        base=motion.trunk.base,
        contacts=stance.contacts(n),
        torque_known=abs(moved.dq) > REST,
    )
    free = contact_free_model(model)
    (R,) = contact_free_regression(free, log).factors
    drives = np.arange(10 * len(stance.robot.links), len(model.layout))
    columns = R[:, np.append(drives, 10 * number + np.arange(10))]
    triangle = np.asarray(np.linalg.qr(columns, mode="r"))[-10:, -10:]
    sizes = abs(np.diagonal(triangle))
    if len(triangle) < 10 or not sizes.min() > 1e-9 * sizes.max():
        raise NotExcitedError("the trunk's path does not show its ten parameters")
    return np.asarray(triangle)

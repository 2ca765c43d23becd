"""Search for the way of a trunk that tells most of its ten parameters."""

from collections.abc import Callable
from dataclasses import dataclass
from time import process_time

import numpy as np

from consistent_id._support.arrays import Array, Vector
from consistent_id._support.threads import single_threaded
from consistent_id.errors import InfeasibleError, NotExcitedError, ProblemError
from consistent_id.excitation.standing.ground_forces import GroundForces, ground_forces
from consistent_id.excitation.standing.stance import JointMotion, Stance, joint_motion
from consistent_id.excitation.standing.standing_limits import StandingLimits, Use, uses
from consistent_id.excitation.standing.tones import HIGHEST, Tried, searched_tones
from consistent_id.excitation.standing.trunk_path import TrunkMotion, TrunkPath
from consistent_id.recordings.recording import Recording
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.rows.contact_free import (
    contact_free_model,
    contact_free_regression,
)
from consistent_id.robot.model import RobotModel

CHECK_RATE = 500.0
"""Hz, at which limits of the final motion are looked at."""

_PER_PERIOD = 4  # samples per period of the fastest sinusoid in the search
_REACHED = 1e-6  # m, rad; feet that are further off are out of reach
_TRIES = 10  # times that a candidate's amplitude is put right
_USED = 0.88, 0.99  # share of the tightest limit that a candidate uses


@dataclass(frozen=True, slots=True, eq=False)
class StandingMotion:
    """A motion on feet, all of it, at some times."""

    time: Vector
    trunk: TrunkMotion
    joints: JointMotion
    ground: GroundForces
    uses: tuple[Use, ...]

    @property
    def largest(self) -> float:
        """The largest share of a limit; infinite where feet are out of reach."""
        if self.joints.off > _REACHED or self.joints.singular:
            return np.inf
        return max(use.share for use in self.uses)


@dataclass(frozen=True, slots=True, eq=False)
class StandingDesign:
    """A motion on feet that was searched for.

    Attributes
    ----------
    stance : Stance
    model : TorqueModel
    limits : StandingLimits
    path : TrunkPath
    errors : ndarray, shape (10,)
        Standard errors of the trunk's parameters for torque noise of 1 N m, all other
        bodies being known: of `INERTIAL_NAMES`.
    first : float
        How many times larger the geometric mean of the errors was on the best random
        path.
    checked : StandingMotion
        At `CHECK_RATE`.
    candidates : int
    seconds : float
        Of the processor.
    """

    stance: Stance
    model: TorqueModel
    limits: StandingLimits
    path: TrunkPath
    errors: Vector
    first: float
    checked: StandingMotion
    candidates: int
    seconds: float

    def recording(self, rate: float) -> Recording:
        """Return the joints' motion at a rate [Hz]."""
        time = np.linspace(0, self.path.duration, round(self.path.duration * rate) + 1)
        moved = joint_motion(self.stance, self.path.motion(time, self._gravity))
        names = self.stance.robot.joint_names
        return Recording(names, time, moved.q, moved.dq, moved.ddq, name="standing")

    @property
    def _gravity(self) -> Vector:
        return np.asarray(self.stance.robot.gravity)


def standing_motion(
    stance: Stance,
    model: TorqueModel,
    limits: StandingLimits,
    path: TrunkPath,
    time: Vector,
) -> StandingMotion:
    """Return what a trunk's path asks of joints and ground."""
    robot = stance.robot
    trunk = path.motion(time, np.asarray(robot.gravity))
    moved = joint_motion(stance, trunk)
    bodies = TorqueModel(robot)
    ground = ground_forces(
        stance, bodies, _nominal(robot), moved, trunk.base, limits.friction
    )
    asked = uses(stance, limits, time, moved, ground)
    return StandingMotion(time, trunk, moved, ground, asked)


def _nominal(robot: RobotModel) -> Vector:
    if robot.nominal is None:
        raise ProblemError(
            f"robot {robot.name!r} has links without inertial parameters, so that what "
            "a motion asks of its joints is not known; complete its file"
        )
    return robot.nominal


def trunk_errors(
    stance: Stance, model: TorqueModel, motion: StandingMotion, rate: float
) -> Vector:
    """Return standard errors of the trunk's ten parameters, shape (10,).

    Of `INERTIAL_NAMES`, for torque noise of 1 N m that is white at a rate [Hz]; drive
    terms are unknown, bodies of the other links known.  Rows are those that no force of
    the ground enters.

    Raises
    ------
    NotExcitedError
        If the motion does not tell all ten.
    """
    factor = _trunk_factor(stance, model, motion)
    share = len(motion.time) / (rate * (motion.time[-1] - motion.time[0]))
    inverse = np.linalg.inv(factor)
    return np.asarray(np.sqrt(share) * np.linalg.norm(inverse, axis=1))


def _trunk_factor(stance: Stance, model: TorqueModel, motion: StandingMotion) -> Array:
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
    )
    free = contact_free_model(model)
    (R,) = contact_free_regression(free, log).factors
    drives = np.arange(10 * len(stance.robot.links), len(model.layout))
    columns = R[:, np.append(drives, np.arange(10))]
    triangle = np.asarray(np.linalg.qr(columns, mode="r"))[-10:, -10:]
    sizes = abs(np.diagonal(triangle))
    if len(triangle) < 10 or not sizes.min() > 1e-9 * sizes.max():
        raise NotExcitedError("the trunk's path does not tell its ten parameters")
    return np.asarray(triangle)


@single_threaded
def design_standing(
    stance: Stance,
    model: TorqueModel,
    limits: StandingLimits | None = None,
    *,
    duration: float = 20.0,
    candidates: int = 320,
    seed: int = 0,
    tell: Callable[[int, float], None] | None = None,
) -> StandingDesign:
    """Search for the way of a trunk over standing feet that tells most of it.

    Least is the geometric mean of the standard errors of the trunk's parameters
    (D-optimality), of paths that are as large as their limits allow; see
    `searched_tones`.

    Parameters
    ----------
    stance : Stance
    model : TorqueModel
        Whose drive terms are unknown beside the trunk.
    limits : StandingLimits, optional
    duration : float, [s]
    candidates : int
        How many paths are tried.
    seed : int
    tell : callable, optional
        Given how many candidates were tried, and the best mean of errors so far.

    Raises
    ------
    InfeasibleError
        If the robot cannot stand in the pose, or not move in it.
    """
    started = process_time()
    chosen = StandingLimits() if limits is None else limits
    samples = int(_PER_PERIOD * HIGHEST * duration)
    time = duration * (np.arange(samples) + 0.5) / samples
    _require_stance(stance, model, chosen, duration)

    def tried(path: TrunkPath) -> Tried:
        return _tried(stance, model, chosen, path, time)

    found = searched_tones(tried, duration, candidates, seed, tell)
    if found.best.path is None:
        raise InfeasibleError(
            "no path of the trunk keeps its limits; allow more velocity or friction, "
            "choose a pose further from stretched legs, or a longer duration"
        )
    motion, path = _checked(stance, model, chosen, found.best.path)
    return StandingDesign(
        stance=stance,
        model=model,
        limits=chosen,
        path=path,
        errors=trunk_errors(stance, model, motion, CHECK_RATE),
        first=found.first / found.best.error,
        checked=motion,
        candidates=candidates,
        seconds=process_time() - started,
    )


def _tried(
    stance: Stance,
    model: TorqueModel,
    limits: StandingLimits,
    path: TrunkPath,
    time: Vector,
) -> Tried:
    """Return a candidate that uses its limits, and its error."""
    for _ in range(_TRIES):
        motion = standing_motion(stance, model, limits, path, time)
        share = motion.largest
        if _USED[0] <= share <= _USED[1]:
            break
        path = path.scaled(0.5 if not share < 50.0 else 0.95 / share**0.9)
    if not motion.largest <= _USED[1]:
        return Tried(None, np.inf)
    try:
        factor = _trunk_factor(stance, model, motion)
    except NotExcitedError:
        return Tried(None, np.inf)
    return Tried(path, float(np.exp(-np.mean(np.log(abs(np.diagonal(factor)))))))


def _require_stance(
    stance: Stance, model: TorqueModel, limits: StandingLimits, duration: float
) -> None:
    """Refuse a pose in which the robot cannot even stand still."""
    path = TrunkPath(np.ones(1), np.zeros((2, 1, 6)), duration)
    motion = standing_motion(stance, model, limits, path, np.array([0.5 * duration]))
    if motion.largest > 1.0:
        if motion.joints.singular:
            raise InfeasibleError(
                "a leg is stretched in this pose, and cannot follow the trunk; bend "
                "the knees: --stance JOINT=POSITION ..."
            )
        worst = max(motion.uses, key=lambda use: use.share)
        raise InfeasibleError(
            f"the robot cannot stand still in this pose: {worst.what} of {worst.of} is "
            f"{worst.share:.0%} of what there is; choose another: --stance, --friction"
        )


def _checked(
    stance: Stance, model: TorqueModel, limits: StandingLimits, path: TrunkPath
) -> tuple[StandingMotion, TrunkPath]:
    """Look at a path densely, and make it smaller as long as that is too much."""
    time = np.linspace(0.0, path.duration, round(path.duration * CHECK_RATE) + 1)
    while True:
        motion = standing_motion(stance, model, limits, path, time)
        if motion.largest <= 1.0:
            return motion, path
        path = path.scaled(0.98)

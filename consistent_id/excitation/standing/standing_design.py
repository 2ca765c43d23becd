"""Search for the way of a trunk that tells most of its ten parameters."""

from collections.abc import Callable
from dataclasses import dataclass
from time import process_time

import numpy as np

from consistent_id._support.arrays import Vector
from consistent_id._support.threads import single_threaded
from consistent_id.errors import InfeasibleError, NotExcitedError
from consistent_id.excitation.standing.stance import Stance, joint_motion
from consistent_id.excitation.standing.standing_limits import StandingLimits
from consistent_id.excitation.standing.standing_motion import (
    StandingMotion,
    nominal_of,
    standing_motion,
)
from consistent_id.excitation.standing.tones import HIGHEST, Tried, searched_tones
from consistent_id.excitation.standing.trunk_errors import (
    link_number,
    relative_size,
    trunk_errors,
    trunk_factor,
)
from consistent_id.excitation.standing.trunk_path import TrunkPath
from consistent_id.recordings.recording import Recording
from consistent_id.regression.regressor import TorqueModel
from consistent_id.robot.inertia import InertialParameters

CHECK_RATE = 500.0
"""Hz, at which limits of the final motion are looked at."""

_PER_PERIOD = 4  # samples per period of the fastest sinusoid in the search
_TRIES = 10  # times that a candidate's amplitude is put right
_USED = 0.88, 0.99  # share of the tightest limit that a candidate uses


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
    seconds : float
        Of the processor.
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
    tell: Callable[[int, float], None] | None = None,
) -> StandingDesign:
    """Search for the way of a trunk over standing feet that tells most of it.

    Least is the root mean square of the standard errors of the trunk's ten parameters,
    relative to its own size (`relative_size`; A-optimality), of paths that are as large
    as their limits allow; see `searched_tones`.

    Parameters
    ----------
    stance : Stance
    model : TorqueModel
        Whose drive terms are unknown beside the trunk.
    limits : StandingLimits, optional
    link : str, optional
        The body that is not known, such as a torso above the base; by default the base.
    duration : float, [s]
    candidates : int
        How many paths are tried.
    seed : int
    tell : callable, optional
        Given how many candidates were tried, and the least size of errors so far.

    Raises
    ------
    InfeasibleError
        If the robot cannot stand in the pose, or not move in it.
    """
    started = process_time()
    chosen = StandingLimits() if limits is None else limits
    samples = int(_PER_PERIOD * HIGHEST * duration)
    time = duration * (np.arange(samples) + 0.5) / samples
    number = link_number(stance, link)
    _require_stance(stance, chosen, duration)

    def tried(path: TrunkPath) -> Tried:
        return _tried(stance, model, chosen, path, time, number)

    found = searched_tones(tried, duration, candidates, seed, tell)
    if found.best.path is None:
        raise InfeasibleError(
            "no path of the trunk keeps its limits; allow more velocity or friction, "
            "choose a pose further from stretched legs, or a longer duration"
        )
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
        candidates=candidates,
        seconds=process_time() - started,
    )


def _tried(
    stance: Stance,
    model: TorqueModel,
    limits: StandingLimits,
    path: TrunkPath,
    time: Vector,
    number: int,
) -> Tried:
    """Return a candidate that uses its limits, and its error."""
    for _ in range(_TRIES):
        motion = standing_motion(stance, limits, path, time)
        share = motion.largest
        if _USED[0] <= share <= _USED[1]:
            break
        path = path.scaled(0.5 if not share < 50.0 else 0.95 / share**0.9)
    if not motion.largest <= _USED[1]:
        return Tried(None, np.inf)
    try:
        factor = trunk_factor(stance, model, motion, number)
    except NotExcitedError:
        return Tried(None, np.inf)
    errors = np.linalg.norm(np.linalg.inv(factor), axis=1)
    body = InertialParameters(nominal_of(stance.robot)[10 * number : 10 * number + 10])
    return Tried(path, relative_size(errors, body))


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
            f"{worst.share:.0%} of what there is; choose another: --stance, --friction"
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

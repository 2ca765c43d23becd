"""Servos identified by simulation: no torque is measured, bodies are known.

The mean absolute error of simulated positions is minimised over short windows, each
begun at the measured state: by the evolution strategy of [Hansen2016]_, because
friction stops the joint or does not, so the error has steps and many minima, and then
by a descent to the bottom of a minimum.  Several forms of friction are fitted; the form
is chosen by leaving each log out in turn, which is also part of the intervals.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from consistent_id._support.arrays import IntArray, Matrix, Vector
from consistent_id._support.executors import single_threaded
from consistent_id._support.given_values import require_type, require_types
from consistent_id._support.progress import stages
from consistent_id.errors import ModelError, RecordingError
from consistent_id.robot.model import RobotModel
from consistent_id.rollout.servo_bounds import (
    DutyLaw,
    box_of,
    duty_law,
    names_shown,
    not_moved,
)
from consistent_id.rollout.servo_intervals import (
    FINE_STEP,
    JointLogs,
    errors_of_copies,
    half_intervals,
    sample_weights,
)
from consistent_id.rollout.servo_log import ServoLog, supply_of, with_position
from consistent_id.rollout.servo_motion import (
    STEP,
    LoggedDrive,
    Pieces,
    cut_pieces,
    finite_errors,
    position_errors,
    position_residuals,
    rigid_model,
)
from consistent_id.rollout.servo_result import JointServo, ServoFit, ServoForm
from consistent_id.rollout.servo_search import (
    SearchDistribution,
    descended,
    evolved,
)

FORMS: Mapping[str, tuple[str, ...]] = {
    "plain": (),
    "load": (
        "stribeck",
        "stribeck_velocity",
        "motor_load",
        "outer_load",
        "motor_load_stribeck",
        "outer_load_stribeck",
    ),
    "square": (
        "stribeck",
        "stribeck_velocity",
        "stribeck_power",
        "motor_load",
        "outer_load",
        "motor_load_stribeck",
        "outer_load_stribeck",
        "motor_square",
        "outer_square",
    ),
}
"""Forms of friction, and their parameters beside viscous and Coulomb friction."""

WINDOW = 1.0
"""Length of a window [s]: a joint that wrongly rests is wrong for so long."""

_STARTS = 3  # searches, each of all parameters
_GENERATIONS = 30  # of the evolution
_DESCENT, _AGAIN = 40, 12  # steps at most: after the evolution, from nearby
_WIDE = 0.25  # of the box: first width of the search
_BLOCKS = 3  # parts in time of a single log


@single_threaded
def identify_servos(
    robot: RobotModel,
    training: Sequence[ServoLog],
    validation: Sequence[ServoLog] = (),
    *,
    forms: Sequence[str] = tuple(FORMS),
    gain: float | None = None,
    seed: int = 0,
    progress: bool = False,
) -> ServoFit:
    """Identify the servos of a robot whose bodies are known.

    Parameters
    ----------
    robot : RobotModel
        With inertias; its joints turn.
    training, validation : sequence of ServoLog
        To learn from, and to be simulated only; of the latter only the duty's gain
        and deadband are used, where they are measured, and for themselves alone.
    forms : sequence of str
        Some of `FORMS`.
    gain : float, optional, [1/rad]
        Share of full duty over position error, of logs without a duty.
    seed : int
        Seed of the search.
    progress : bool
        Show which servo is under way, on the standard error.

    Raises
    ------
    ModelError
        If bodies are not known, a joint slides, or a joint follows another one.
    RecordingError
        If there is no training log, two logs have the same name, a duty does not follow
        the position error, a log has no duty and no gain is stated, or the motion of
        the best parameters is not finite.
    NotExcitedError
        If no joint moves.

    Examples
    --------
    See ``docs/servos.md``.
    """
    require_type(robot, RobotModel, "robot")
    require_types(training, ServoLog, "training")
    require_types(validation, ServoLog, "validation")
    if not training:
        raise RecordingError("there is no log of servos to learn from")
    rigid_model(robot)
    for joint in robot.driven:
        if joint.kind == "prismatic":
            raise ModelError(f"joint {joint.name} slides; servos turn")
    followers = [joint.name for joint in robot.joints if joint.mimic is not None]
    if followers:
        raise ModelError(
            f"{', '.join(followers)} of {robot.name} follow another joint (mimic); a "
            "servo that moves two joints is not supported. Lock the joints, or remove "
            "them from the file"
        )
    data = _ServoData(robot, tuple(training), tuple(validation), gain)
    _require_names([log.name for log in data.logs])
    still = not_moved(robot, training)
    moved = [name for name in robot.joint_names if name not in still]
    joints = []
    with stages(len(moved), progress) as begin:
        for name in moved:
            begin(f"servo of {name}")
            place = robot.joint_names.index(name)
            joints.append(_identified(data, place, forms, seed))
    return ServoFit(robot.name, tuple(joints), data.volts, still)


@dataclass(frozen=True, slots=True, eq=False)
class _ServoData:
    """A robot and its logs; `gain` is that of logs without a duty."""

    robot: RobotModel
    training: tuple[ServoLog, ...]
    validation: tuple[ServoLog, ...]
    gain: float | None

    @property
    def logs(self) -> tuple[ServoLog, ...]:
        """All logs, those for training first."""
        return (*self.training, *self.validation)

    @property
    def volts(self) -> float | None:
        """Median voltage of the training logs that state theirs."""
        known = [log.volts for log in self.training if log.volts is not None]
        return float(np.median(known)) if known else None

    def laws(self, joint: int) -> list[DutyLaw]:
        """Return the law of each log's duty."""
        return [_law(log, joint, self.gain) for log in self.logs]

    def pieces(
        self,
        joint: int,
        laws: Sequence[DutyLaw],
        window: float | None,
        *,
        validation: bool = False,
        step: float = STEP,
    ) -> Pieces:
        """Return the training logs, or those for validation, in windows or whole."""
        count = len(self.training)
        mine = self.validation if validation else self.training
        of = laws[count:] if validation else laws[:count]
        drives = [
            LoggedDrive(law.gain, law.deadband, supply_of(log, self.volts))
            for log, law in zip(mine, of, strict=True)
        ]
        return cut_pieces(self.robot, mine, joint, drives, window, step)


def _require_names(names: Sequence[str]) -> None:
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise RecordingError(
            f"two logs are named {', '.join(twice)}; give each log a name of its own"
        )


def _identified(
    data: _ServoData, joint: int, forms: Sequence[str], seed: int
) -> JointServo:
    """Fit each form of friction to one joint's servo."""
    training, laws = data.training, data.laws(joint)
    deadband = float(np.median([law.deadband for law in laws[: len(training)]]))
    short = data.pieces(joint, laws, _window(training))
    whole = data.pieces(joint, laws, None)
    fine = data.pieces(joint, laws, None, step=FINE_STEP)

    def again(positions: Sequence[Vector]) -> Pieces:
        logs = tuple(
            with_position(log, joint, q)
            for log, q in zip(training, positions, strict=True)
        )
        alike = replace(data, training=logs)
        return alike.pieces(joint, laws, _window(training))

    logs = JointLogs(short, whole, fine, box_of(training, joint, short), again)
    found, named = [], dict[str, dict[str, float]]()
    unseen = None
    if data.validation:
        unseen = data.pieces(joint, laws, None, validation=True)
    for name in forms:
        names = (*names_shown(training, joint), *FORMS[name])
        found.append(_fitted(name, names, logs, seed))
        if unseen is not None:
            errors = finite_errors(_sets(found[-1].values), unseen).tolist()
            others = [log.name for log in data.validation]
            named[name] = dict(zip(others, errors, strict=True))
    pairs = list(zip(data.logs, laws, strict=True))
    gains = {log.name: law.gain for log, law in pairs}
    followed = {
        log.name: float(np.mean(abs(log.goal[:, joint] - log.position[:, joint])))
        for log in data.logs
    }
    return JointServo(
        data.robot.joint_names[joint], tuple(found), gains, deadband, named, followed
    )


def _law(log: ServoLog, joint: int, gain: float | None) -> DutyLaw:
    found = duty_law(log, joint)
    if found is not None:
        return found
    if gain is None:
        raise RecordingError(
            f"{log.name} has no duty; state the firmware's gain, the share of full "
            "duty over position error in 1/rad (--gain); stall is in proportion to it"
        )
    return DutyLaw(gain, 0.0, 0.0)


def _window(logs: Sequence[ServoLog]) -> float:
    """Return the length of windows [s]: there are several of each long piece.

    Shorter pieces are one window each.
    """
    lengths = [float(log.time[-1]) for log in logs]
    long = [length for length in lengths if length >= WINDOW] or [max(lengths)]
    return min(WINDOW, min(long) / _BLOCKS)


def _parts(pieces: Pieces) -> IntArray:
    """Return, for each window, the log that it is from, or of few logs the part."""
    source = pieces.source
    if source[-1] >= _BLOCKS - 1:
        return source
    parts = np.zeros_like(source)
    for log in np.unique(source):
        mine = np.flatnonzero(source == log)
        parts[mine] = log * _BLOCKS + np.arange(len(mine)) * _BLOCKS // len(mine)
    return parts


def _fitted(form: str, names: Sequence[str], joint: JointLogs, seed: int) -> ServoForm:
    short, box = joint.short, joint.box
    rng = np.random.default_rng(seed)

    def residuals(sets: Matrix) -> Matrix:
        return position_residuals(box.values(names, sets), short)

    def error(sets: Matrix) -> Vector:
        errors = position_errors(box.values(names, sets), short)
        return np.asarray(errors.mean(axis=1))

    start = SearchDistribution(box.start(names), _WIDE)
    ends = np.array(
        [evolved(error, start, _GENERATIONS, rng).best for _ in range(_STARTS)]
    )
    weights = sample_weights(short)
    ends, errors = descended(residuals, ends, np.tile(weights, (_STARTS, 1)), _DESCENT)
    best = ends[errors.argmin()]
    parts = _without_parts(residuals, ends, short)
    known = box.values(names, best[None])
    copies = errors_of_copies(names, joint, best, rng)
    half = half_intervals(
        np.array(list(known.values()))[:, 0],
        np.array(list(box.values(names, parts).values())).T,
        float(errors.min()),
        copies,
    )
    # With a true value beyond the border, the other parameters are wrong, too: their
    # intervals are conditional on the value at the border.
    half[box.unknown(names, best)] = np.inf
    return ServoForm(
        form,
        {name: float(value[0]) for name, value in known.items()},
        dict(zip(names, half.tolist(), strict=True)),
        float(finite_errors(known, joint.whole).mean()),
        _left_out_error(box.values(names, parts), joint),
        box.borders(names, best),
    )


def _without_parts(
    residuals: Callable[[Matrix], Matrix], ends: Matrix, short: Pieces
) -> Matrix:
    """Return fits without each part of the logs; `ends` are of fits to all of them."""
    part = _parts(short)
    of_samples = np.repeat(part, [len(times) for times in short.times])
    every = sample_weights(short)
    weights = np.array([every * (of_samples != group) for group in np.unique(part)])
    weights /= weights.sum(axis=1)[:, None]
    # Without a part of the logs, another of the minima may be the lowest.
    first = (weights @ abs(residuals(ends)).T).argmin(axis=1)
    return descended(residuals, ends[first], weights, _AGAIN).points


def _left_out_error(fits: Mapping[str, Vector], joint: JointLogs) -> float:
    """Return the mean error of each part of the logs by the fit without it [rad].

    A part that is a whole log is simulated from its start to its end, else in windows.
    """
    short, part = joint.short, _parts(joint.short)
    of_windows = position_errors(fits, short)
    of_logs = position_errors(fits, joint.whole)
    errors = np.zeros(len(part))
    for fit, group in enumerate(np.unique(part)):
        mine = part == group
        logs = np.unique(short.source[mine])
        if (part[np.isin(short.source, logs)] == group).all():
            errors[mine] = of_logs[fit, logs]
        else:
            errors[mine] = of_windows[fit, mine]
    return float(errors.mean())


def _sets(values: Mapping[str, float]) -> dict[str, Vector]:
    return {name: np.array([value]) for name, value in values.items()}

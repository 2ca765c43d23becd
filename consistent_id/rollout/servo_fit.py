"""Servos identified by simulation: no torque is measured, bodies are known.

The mean absolute error of simulated positions is minimised by the evolution strategy of
[Hansen2016]_: friction stops the joint or does not, so the error has steps and many
minima, and gradients do not help.  It is minimised first over short windows, each begun
at the measured state, then over windows and whole logs together.  Several forms of
friction are fitted; the form is chosen by leaving each log out in turn, which also
gives the intervals.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from consistent_id._support.arrays import IntArray, Matrix, Vector
from consistent_id._support.executors import single_threaded
from consistent_id.errors import ModelError, RecordingError
from consistent_id.robot.model import RobotModel
from consistent_id.rollout.servo_bounds import (
    BORDER,
    DutyLaw,
    SearchBox,
    alike_halves,
    box_of,
    duty_law,
    half_intervals,
    late_damping,
    names_shown,
    not_moved,
)
from consistent_id.rollout.servo_log import ServoLog, encoded, with_position
from consistent_id.rollout.servo_motion import (
    LoggedDrive,
    Pieces,
    cut_pieces,
    finite_errors,
    position_errors,
    rigid_model,
    sampled_motion,
    supply_of,
)
from consistent_id.rollout.servo_result import JointServo, ServoFit, ServoForm

POPULATION = 28
"""Points of a generation."""

_WIDEST = 0.3  # of the box: width of a search


class SearchDistribution(NamedTuple):
    """The normal distribution that points of a generation are drawn from.

    Parameters
    ----------
    mean : ndarray, shape (parameters,)
    width : float
        Standard deviation along directions in which the shape has size one.
    spread : ndarray, shape (parameters, parameters), optional
        Shape of the covariance; by default that of a ball.
    """

    mean: Vector
    width: float
    spread: Matrix | None = None


class Evolved(NamedTuple):
    """The end of an evolution.

    Parameters
    ----------
    best : ndarray, shape (parameters,)
        Point of least error.
    last : SearchDistribution
        The last generation's.
    """

    best: Vector
    last: SearchDistribution


def evolved(
    error: Callable[[Matrix], Vector],
    start: SearchDistribution,
    generations: int,
    rng: np.random.Generator,
) -> Evolved:
    """Search the unit cube for the least error by an evolution strategy.

    Covariance matrix adaptation [Hansen2016]_.

    Parameters
    ----------
    error : callable
        From points, shape (sets, parameters), to their errors.
    start : SearchDistribution
        The first ones.
    """
    n, count = len(start.mean), POPULATION
    chosen = count // 2
    weights = np.log(chosen + 0.5) - np.log(np.arange(1, chosen + 1))
    weights /= weights.sum()
    mass = 1.0 / (weights**2).sum()
    c_s = (mass + 2.0) / (n + mass + 5.0)
    damping = 1.0 + c_s + 2.0 * max(0.0, np.sqrt((mass - 1.0) / (n + 1.0)) - 1.0)
    c_c = (4.0 + mass / n) / (n + 4.0 + 2.0 * mass / n)
    c_1 = 2.0 / ((n + 1.3) ** 2 + mass)
    c_m = min(1.0 - c_1, 2.0 * (mass - 2.0 + 1.0 / mass) / ((n + 2.0) ** 2 + mass))
    usual = np.sqrt(n) * (1.0 - 0.25 / n + 1.0 / (21.0 * n * n))
    mean, width = start.mean.copy(), start.width
    C = np.eye(n) if start.spread is None else start.spread
    path, sizes = np.zeros(n), np.zeros(n)
    best, least = start.mean, float(error(start.mean[None])[0])
    for generation in range(generations):
        squares, axes = np.linalg.eigh(C)
        lengths = np.sqrt(np.maximum(squares, 1e-20))
        steps = rng.normal(size=(count, n)) * lengths @ axes.T
        tried = mean + width * steps
        inside = np.clip(tried, 0.0, 1.0)
        errors = error(inside)
        if errors.min() < least:
            best, least = inside[errors.argmin()], float(errors.min())
        # Beyond the box the error is that of the border, and a little more.
        outside = ((tried - inside) ** 2).sum(axis=1)
        order = np.argsort(errors + least * outside)[:chosen]
        step = weights @ steps[order]
        mean = mean + width * step
        plain = axes / lengths @ (axes.T @ step)
        sizes = (1.0 - c_s) * sizes + np.sqrt(c_s * (2.0 - c_s) * mass) * plain
        size = np.linalg.norm(sizes)
        width *= float(np.exp(c_s / damping * (size / usual - 1.0)))
        width = min(width, _WIDEST)  # at the border it would grow for ever
        steady = np.sqrt(1.0 - (1.0 - c_s) ** (2 * generation + 2))
        grows = float(size / steady < (1.4 + 2.0 / (n + 1.0)) * usual)
        path = (1.0 - c_c) * path + grows * np.sqrt(c_c * (2.0 - c_c) * mass) * step
        among = (steps[order].T * weights) @ steps[order]
        C = (1.0 - c_1 - c_m) * C + c_1 * np.outer(path, path) + c_m * among
    return Evolved(best, SearchDistribution(np.clip(mean, 0.0, 1.0), width, C))


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

_GENERATIONS = 110  # over windows
_POLISHING = 16  # over windows and whole logs
_AGAIN = 10  # without one log
_FROM_NEARBY = 25  # for simulated logs
_TWINS = 3  # simulated copies of the logs
_WIDE, _NARROW = 0.25, 0.04  # first widths of the search, of the box
_WIDER = 3.0  # times its last width, the search without a log begins
_LEAST = 0.01  # of the box: least first width of it
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
    joints = tuple(
        _identified(data, place, forms, seed)
        for place, name in enumerate(robot.joint_names)
        if name not in still
    )
    return ServoFit(robot.name, joints, data.volts, still)


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
    ) -> Pieces:
        """Return the training logs, or those for validation, in windows or whole."""
        count = len(self.training)
        mine = self.validation if validation else self.training
        of = laws[count:] if validation else laws[:count]
        drives = [
            LoggedDrive(law.gain, law.deadband, supply_of(log, self.volts))
            for log, law in zip(mine, of, strict=True)
        ]
        return cut_pieces(self.robot, mine, joint, drives, window)


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

    def again(positions: Sequence[Vector]) -> Pieces:
        logs = tuple(
            with_position(log, joint, q)
            for log, q in zip(training, positions, strict=True)
        )
        alike = replace(data, training=logs)
        return alike.pieces(joint, laws, _window(training))

    logs = _JointLogs(short, whole, box_of(training, joint, short), again)
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


class _JointLogs(NamedTuple):
    """One joint's training logs in windows and whole, and the box of its parameters.

    `again` returns the windows of other positions at the same samples.
    """

    short: Pieces
    whole: Pieces
    box: SearchBox
    again: Callable[[Sequence[Vector]], Pieces]


def _fitted(form: str, names: Sequence[str], joint: _JointLogs, seed: int) -> ServoForm:
    short, whole, box, _ = joint

    def values(sets: Matrix) -> dict[str, Vector]:
        return box.values(names, sets)

    def of_windows(kept: IntArray) -> Callable[[Matrix], Vector]:
        return lambda sets: position_errors(values(sets), short)[:, kept].mean(axis=1)

    def of_both(sets: Matrix) -> Vector:
        known = values(sets)
        errors = position_errors(known, whole).mean(axis=1)
        return np.asarray(errors + position_errors(known, short).mean(axis=1))

    rng = np.random.default_rng(seed)
    part = _parts(short)
    every = np.arange(len(part))
    start = SearchDistribution(box.start(names), _WIDE)
    first = evolved(of_windows(every), start, _GENERATIONS, rng)
    best = evolved(
        of_both, SearchDistribution(first.best, _NARROW), _POLISHING, rng
    ).best
    wider = first.last._replace(width=max(_WIDER * first.last.width, _LEAST))
    parts, errors = [], np.zeros(len(part))
    for group in np.unique(part):
        kept = np.flatnonzero(part != group)
        found = evolved(of_windows(kept), wider, _AGAIN, rng)
        parts.append(found.last.mean)
        mine = part == group
        logs = np.unique(short.source[mine])
        if (part[np.isin(short.source, logs)] == group).all():
            errors[mine] = position_errors(values(found.best[None]), whole)[0, logs]
        else:
            errors[mine] = position_errors(values(found.best[None]), short)[0, mine]
    known = values(best[None])
    training = finite_errors(known, whole)
    half = _half_intervals(
        names, joint, SearchDistribution(best, wider.width), np.array(parts), rng
    )
    # With a true value beyond the border, the other parameters are wrong, too: their
    # intervals are conditional on the value at the border.
    borders = box.borders(names, best)
    half[[name in borders for name in names] | (best < BORDER)] = np.inf
    return ServoForm(
        form,
        {name: float(value[0]) for name, value in known.items()},
        dict(zip(names, half.tolist(), strict=True)),
        float(training.mean()),
        float(errors.mean()),
        borders,
    )


def _half_intervals(
    names: Sequence[str],
    joint: _JointLogs,
    found: SearchDistribution,
    parts: Matrix,
    rng: np.random.Generator,
) -> Vector:
    """Return half of 95 % intervals; `parts` are the points found without one log."""
    known = joint.box.values(names, found.mean[None])
    point = np.array(list(known.values()))[:, 0]
    spread = np.array(list(joint.box.values(names, parts).values())).T
    half = half_intervals(
        names, point, spread, _shared_errors(names, joint, found, rng)
    )
    if "viscous" in names:
        place = list(names).index("viscous")
        gain = float(np.median(joint.whole.gain))
        half[place] = np.hypot(half[place], late_damping(known["stall"][0], gain))
    for pieces in (joint.short, joint.whole):
        half = np.maximum(half, alike_halves(names, known, pieces))
    return np.asarray(half)


def _shared_errors(
    names: Sequence[str],
    joint: _JointLogs,
    found: SearchDistribution,
    rng: np.random.Generator,
) -> Matrix:
    """Return errors of the search for known parameters, shape (copies, parameters).

    Logs are simulated with the parameters that were found, and read by the encoder;
    then these are searched again.  All logs share such errors, so leaving logs out does
    not show them.
    """

    def values(sets: Matrix) -> dict[str, Vector]:
        return joint.box.values(names, sets)

    truth = {name: value[0] for name, value in values(found.mean[None]).items()}
    motion = sampled_motion(truth, joint.whole)
    errors = []
    for _ in range(_TWINS):
        read = [
            encoded(q, measured, rng)
            for q, measured in zip(motion, joint.whole.measured, strict=True)
        ]
        windows = joint.again(read)

        def error(sets: Matrix, windows: Pieces = windows) -> Vector:
            return np.asarray(position_errors(values(sets), windows).mean(axis=1))

        again = evolved(error, found, _FROM_NEARBY, rng).last.mean
        known = values(again[None])
        errors.append([float(known[name][0]) - truth[name] for name in names])
    return np.array(errors)


def _sets(values: Mapping[str, float]) -> dict[str, Vector]:
    return {name: np.array([value]) for name, value in values.items()}

"""Servos identified by simulation: no torque is measured, bodies are known.

The mean absolute error of simulated positions is minimised by the evolution strategy of
[Hansen2016]_: friction stops the joint or does not, so the error has steps and many
minima, and gradients do not help.  It is minimised first over short windows, each begun
at the measured state, then over windows and whole logs together.  Several forms of
friction are fitted; the form is chosen by leaving each log out in turn, which also
gives the intervals.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from consistent_id._support.arrays import IntArray, Matrix, Vector
from consistent_id._support.brief import brief
from consistent_id._support.executors import single_threaded
from consistent_id._support.tables import Table
from consistent_id.errors import ModelError, RecordingError
from consistent_id.robot.model import RobotModel
from consistent_id.rollout.servo_log import DutyLaw, ServoLog, duty_law
from consistent_id.rollout.servo_motion import (
    STEP,
    Pieces,
    cut_pieces,
    position_errors,
    rigid_model,
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
}
"""Forms of friction, and their parameters beside viscous and Coulomb friction."""

UNITS: Mapping[str, str] = {
    "stall": "N m",
    "back_emf": "N m s/rad",
    "viscous": "N m s/rad",
    "armature": "kg m^2",
    "coulomb": "N m",
    "stribeck": "N m",
    "stribeck_velocity": "rad/s",
    "motor_load": "N m/N m",
    "outer_load": "N m/N m",
    "motor_load_stribeck": "N m/N m",
    "outer_load_stribeck": "N m/N m",
    "heat": "1/K",
    "delay": "s",
    "zero": "rad",
}

WINDOW = 1.0
"""Length of a window [s]: a joint that wrongly rests is wrong for so long."""

_POPULATION = 28
_GENERATIONS = 110  # over windows
_POLISHING = 16  # over windows and whole logs
_AGAIN = 10  # without one log
_WIDE, _NARROW = 0.25, 0.04  # first widths of the search, of the box
_WARM = 5.0  # K: least difference of temperature from which its effect is fitted
_WIDEST = 0.3  # of the box: width of a search
_WIDER = 3.0  # times its last width, the search without a log begins
_MIDDLE = {"zero": 0.5, "heat": 0.5}  # where the search begins, in the box
_BORDER = 0.02  # of the box: nearer, the search ended at its border
_BLOCKS = 3  # parts in time of a single log


@brief
@dataclass(frozen=True, slots=True)
class ServoForm:
    """A form of friction fitted to one joint.

    Parameters
    ----------
    values : dict of str to float
        Parameters by name, in the units of `UNITS`.
    half_intervals : dict of str to float
        Half widths of 95 % intervals, from leaving out each log in turn; infinite where
        the search ended at its border.
    training, left_out : float, [rad]
        Mean absolute error of simulated positions, over whole logs: of the logs that
        were learnt from, and of each log simulated by a fit to the others.
    """

    name: str
    values: Mapping[str, float]
    half_intervals: Mapping[str, float]
    training: float
    left_out: float


@brief
@dataclass(frozen=True, slots=True)
class JointServo:
    """One joint's servo.

    Parameters
    ----------
    forms : tuple of ServoForm
        All that were fitted; `chosen` has the least error of logs left out.
    gains : dict of str to float, [1/rad]
        The firmware's gain, duty over position error, of each log.
    deadband : float, [rad]
        Zero if the log's duty shows none, or there is no duty.
    validation : dict of str to dict of str to float, [rad]
        Errors by form, of each log that was not learnt from.
    """

    joint: str
    forms: tuple[ServoForm, ...]
    gains: Mapping[str, float]
    deadband: float
    validation: Mapping[str, Mapping[str, float]] = field(default_factory=dict)

    @property
    def chosen(self) -> ServoForm:
        """The form with the least error of logs left out."""
        return min(self.forms, key=lambda form: form.left_out)

    def form(self, name: str) -> ServoForm:
        """Return the form of a name."""
        return next(form for form in self.forms if form.name == name)

    def table(self) -> Table:
        """Return the chosen form's parameters, for people."""
        form = self.chosen
        rows = tuple(
            (name, f"{value:.4g}", _half(form.half_intervals[name]), UNITS[name])
            for name, value in form.values.items()
        )
        notes = [
            f"friction {other.name}: error of logs left out {_mrad(other.left_out)}, "
            f"of training {_mrad(other.training)}"
            for other in self.forms
        ]
        if self.deadband:
            notes.append(f"deadband of the firmware: {_mrad(self.deadband)}")
        title = f"Servo of {self.joint}, friction {form.name}"
        return Table(title, ("parameter", "value", "+-", "unit"), rows, tuple(notes))


@brief
@dataclass(frozen=True, slots=True)
class ServoFit:
    """Servos of a robot.

    Parameters
    ----------
    volts : float, optional, [V]
        The nominal supply, at which `stall` is the torque at full duty.
    """

    robot: str
    joints: tuple[JointServo, ...]
    volts: float | None

    def validation_error(self, form: str | None = None) -> float:
        """Return the mean error of logs not learnt from, over joints [rad].

        NaN if there are none.
        """
        errors = [
            servo.validation[form or servo.chosen.name].values()
            for servo in self.joints
            if servo.validation
        ]
        found = [value for values in errors for value in values]
        return float(np.mean(found)) if found else float("nan")

    def tables(self) -> list[Table]:
        """Return what was found, for people."""
        shown = self.validation_error()
        if np.isfinite(shown):
            first = f"Error of simulated position, logs not used: {_mrad(shown)}"
        else:
            first = "No log was left unused; the error is that of logs left out in turn"
        rows = tuple(
            (servo.joint, log, *(f"{1e3 * by[log]:.1f}" for by in _by_form(servo)))
            for servo in self.joints
            for log in next(iter(servo.validation.values()), {})
        )
        names = tuple(form.name for form in self.joints[0].forms)
        notes = ["mean absolute error in mrad, from the start to the end of each log"]
        if self.volts is not None:
            notes.append(f"stall: torque at full duty and {self.volts:.2f} V")
        if len(self.joints) > 1:
            notes.append("each joint is simulated while the others move as measured")
        head = ("joint", "log", *names) if rows else ()
        return [
            Table(first, head, rows, tuple(notes)),
            *(servo.table() for servo in self.joints),
        ]

    def to_dict(self) -> dict[str, Any]:
        """Return what was found by name, for JSON."""
        return {
            "format": "consistent_id servo 1",
            "robot": self.robot,
            "volts": self.volts,
            "validation_error": _number(self.validation_error()),
            "joints": {
                servo.joint: {
                    "friction": servo.chosen.name,
                    "gains": dict(servo.gains),
                    "deadband": servo.deadband,
                    "validation": {k: dict(v) for k, v in servo.validation.items()},
                    "forms": {
                        form.name: {
                            "values": dict(form.values),
                            "half_intervals": {
                                name: _number(value)
                                for name, value in form.half_intervals.items()
                            },
                            "training_error": form.training,
                            "left_out_error": form.left_out,
                        }
                        for form in servo.forms
                    },
                }
                for servo in self.joints
            },
        }


def _half(value: float) -> str:
    return f"{value:.2g}" if np.isfinite(value) else "not known"


def _number(value: float) -> float | None:
    return value if np.isfinite(value) else None


def _by_form(servo: JointServo) -> list[Mapping[str, float]]:
    return [servo.validation[form.name] for form in servo.forms]


def _mrad(value: float) -> str:
    return f"{1e3 * value:.1f} mrad"


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
        To learn from, and to be simulated only; of the latter only the duty's gain is
        used, where it is measured.
    forms : sequence of str
        Of `FORMS`.
    gain : float, optional, [1/rad]
        Share of full duty over position error, of logs without a duty.
    seed : int
        Of the search.

    Raises
    ------
    ModelError
        If bodies are not known, or a joint slides.
    RecordingError
        If there is no training log, a duty does not follow the position error, or a log
        has no duty and no gain is stated.

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
    known = [log.volts for log in training if log.volts is not None]
    volts = float(np.median(known)) if known else None
    joints = tuple(
        _identified(robot, place, training, validation, volts, forms, gain, seed)
        for place in range(len(robot))
    )
    return ServoFit(robot.name, joints, volts)


def _identified(
    robot: RobotModel,
    joint: int,
    training: Sequence[ServoLog],
    validation: Sequence[ServoLog],
    volts: float | None,
    forms: Sequence[str],
    gain: float | None,
    seed: int,
) -> JointServo:
    laws = [_law(log, joint, gain) for log in (*training, *validation)]
    deadband = float(np.median([law.deadband for law in laws]))
    pairs = [(law.gain, deadband) for law in laws]
    count = len(training)

    def cut(logs: Sequence[ServoLog], of: slice, window: float | None) -> Pieces:
        return cut_pieces(robot, logs, joint, pairs[of], volts, window)

    short = cut(training, slice(count), _window(training))
    whole = cut(training, slice(count), None)
    box = _box(training, joint, short)
    found, named = [], dict[str, dict[str, float]]()
    judged = cut(validation, slice(count, None), None) if validation else None
    for name in forms:
        names = (*_names(training, joint), *FORMS[name])
        found.append(_fitted(name, names, box, short, whole, seed))
        if judged is not None:
            errors = position_errors(_sets(found[-1].values), judged)[0].tolist()
            logs = [log.name for log in validation]
            named[name] = dict(zip(logs, errors, strict=True))
    gains = {
        log.name: law.gain
        for log, law in zip((*training, *validation), laws, strict=True)
    }
    return JointServo(robot.joint_names[joint], tuple(found), gains, deadband, named)


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


def _names(logs: Sequence[ServoLog], joint: int) -> tuple[str, ...]:
    """Return the parameters that logs can show, but for friction's form."""
    names = ["stall", "viscous", "armature", "coulomb", "delay", "zero"]
    if any(log.enabled is not None and not log.enabled[:, joint].all() for log in logs):
        names.insert(1, "back_emf")  # else it is part of viscous friction
    warm = [log.temperature[joint] for log in logs if log.temperature is not None]
    warm = [value for value in warm if np.isfinite(value)]
    if len(warm) > 1 and np.ptp(warm) >= _WARM:
        names.append("heat")
    return tuple(names)


def _box(
    logs: Sequence[ServoLog], joint: int, pieces: Pieces
) -> Mapping[str, tuple[float, float]]:
    """Return where parameters are searched, by the size of torque and speed."""
    speeds, carried, duties = [], [], []
    for log in logs:
        change = abs(np.diff(log.position[:, joint])) / np.diff(log.time)
        speeds.append(np.convolve(change, np.ones(9) / 9.0, mode="same"))
        if log.duty is not None:
            duties.append(abs(log.duty[:, joint]))
    for piece, q in enumerate(pieces.measured):
        still = pieces.still[:, piece].mean(axis=0)
        terms = (1.0 + 0.0 * q, np.cos(q), np.sin(q), np.cos(2 * q), np.sin(2 * q))
        carried.append(abs(sum(a * b for a, b in zip(still, terms, strict=True))))
    speed = max(float(np.quantile(np.concatenate(speeds), 0.99)), 0.1)
    inertia = float(pieces.inertia.mean())
    torque = float(np.quantile(np.concatenate(carried), 0.95))
    torque = max(torque, 5.0 * inertia * speed, 1e-4)
    duty = float(np.quantile(np.concatenate(duties), 0.95)) if duties else 0.5
    full = torque / max(duty, 0.02)
    return {
        "stall": (0.3 * full, 6.0 * full),
        "back_emf": (0.0, 3.0 * full / speed),
        "viscous": (0.0, 3.0 * full / speed),
        "armature": (0.01 * inertia, 3.0 * inertia),
        "coulomb": (0.0, 0.3 * full),
        "stribeck": (0.0, 0.3 * full),
        "stribeck_velocity": (0.01 * speed, 0.2 * speed),
        "motor_load": (0.0, 0.7),
        "outer_load": (0.0, 0.7),
        "motor_load_stribeck": (0.0, 0.7),
        "outer_load_stribeck": (0.0, 0.7),
        "heat": (-0.01, 0.03),
        "delay": (0.0, 0.04),
        "zero": (-0.1, 0.1),
    }


def _window(logs: Sequence[ServoLog]) -> float:
    """Return the length of windows: of each log, there are several [s]."""
    shortest = min(float(log.time[-1]) for log in logs)
    return min(WINDOW, shortest / _BLOCKS)


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


def _fitted(
    form: str,
    names: Sequence[str],
    box: Mapping[str, tuple[float, float]],
    short: Pieces,
    whole: Pieces,
    seed: int,
) -> ServoForm:
    from scipy.special import stdtrit

    low = np.array([box[name][0] for name in names])
    high = np.array([box[name][1] for name in names])

    def values(sets: Matrix) -> dict[str, Vector]:
        scaled = low + sets * (high - low)
        return dict(zip(names, scaled.T, strict=True))

    def of_windows(kept: IntArray) -> Callable[[Matrix], Vector]:
        return lambda sets: position_errors(values(sets), short)[:, kept].mean(axis=1)

    def of_both(sets: Matrix) -> Vector:
        known = values(sets)
        errors = position_errors(known, whole).mean(axis=1)
        return np.asarray(errors + position_errors(known, short).mean(axis=1))

    rng = np.random.default_rng(seed)
    middle = np.array([_MIDDLE.get(name, 0.25) for name in names])
    part = _parts(short)
    every = np.arange(len(part))
    first = evolved(of_windows(every), middle, _WIDE, _GENERATIONS, rng)
    best = evolved(of_both, first.best, _NARROW, _POLISHING, rng).best
    parts, errors = [], np.zeros(len(part))
    for group in np.unique(part):
        kept = np.flatnonzero(part != group)
        found = evolved(
            of_windows(kept),
            first.mean,
            _WIDER * first.width,
            _AGAIN,
            rng,
            first.spread,
        )
        parts.append(found.mean)
        mine = part == group
        logs = np.unique(short.source[mine])
        if (part[np.isin(short.source, logs)] == group).all():
            errors[mine] = position_errors(values(found.best[None]), whole)[0, logs]
        else:
            errors[mine] = position_errors(values(found.best[None]), short)[0, mine]
    count = len(parts)
    spread = np.array(parts)
    scatter = (count - 1) / count * ((spread - spread.mean(axis=0)) ** 2).sum(axis=0)
    factor = float(stdtrit(count - 1, 0.975))
    # The search is part of the scatter: the fit to all logs is not the mean of parts.
    apart = best - spread.mean(axis=0)
    half = np.sqrt(factor**2 * scatter + apart**2) * (high - low)
    if "delay" in names:
        place = list(names).index("delay")
        half[place] = max(half[place], STEP)
    # At a border that is not a physical one, the data do not determine a parameter.
    half[(best > 1.0 - _BORDER) | ((best < _BORDER) & (low != 0.0))] = np.inf
    best_values = low + best * (high - low)
    return ServoForm(
        form,
        dict(zip(names, best_values.tolist(), strict=True)),
        dict(zip(names, half.tolist(), strict=True)),
        float(position_errors(values(best[None]), whole).mean()),
        float(errors.mean()),
    )


def _sets(values: Mapping[str, float]) -> dict[str, Vector]:
    return {name: np.array([value]) for name, value in values.items()}


class Evolved(NamedTuple):
    """The end of an evolution.

    Parameters
    ----------
    best : ndarray, shape (parameters,)
        Point of least error.
    mean : ndarray, shape (parameters,)
        Of the last distribution, `width` its size and `spread` its covariance's shape.
    """

    best: Vector
    mean: Vector
    width: float
    spread: Matrix


def evolved(
    error: Callable[[Matrix], Vector],
    start: Vector,
    width: float,
    generations: int,
    rng: np.random.Generator,
    spread: Matrix | None = None,
) -> Evolved:
    """Search the unit cube for the least error by an evolution strategy.

    Covariance matrix adaptation [Hansen2016]_.

    Parameters
    ----------
    error : callable
        From points, shape (sets, parameters), to their errors.
    width : float
        First standard deviation.
    spread : ndarray, shape (parameters, parameters), optional
        First covariance's shape.
    """
    n, count = len(start), _POPULATION
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
    mean, C = start.copy(), np.eye(n) if spread is None else spread
    path, sizes = np.zeros(n), np.zeros(n)
    best, least = start, float(error(start[None])[0])
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
    return Evolved(best, np.clip(mean, 0.0, 1.0), width, C)

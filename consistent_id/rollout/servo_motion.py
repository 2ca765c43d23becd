"""The motion of a servo by its goals, for many sets of parameters side by side.

The motor's torque is ``stall duty (1 - heat (T - T0)) - back_emf dq`` while it is
driven.  The gears' friction depends on the load: with the motor's torque ``m`` and that
of the bodies on the joint ``e`` it is at most

    coulomb + abs(motor_load m - outer_load e) + s stribeck
    + s abs(motor_load_stribeck m - outer_load_stribeck e) + viscous abs(dq)

with ``s = exp(-(abs(dq) / stribeck_velocity) ** stribeck_power)``, and stops the joint
if it can.  Where motor and bodies pull against each other, ``s outer_square e^2`` is
added if the motor is the stronger, else ``s motor_square m^2``.  This is the family of
friction laws of [Duclusaud2024]_, in steps of first order.  One joint
moves; the others follow their measured motion.  The torque of the bodies is then a
Fourier series of the joint's position, which is computed beforehand without error.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from consistent_id._support.arrays import Array, IntArray, Matrix, Vector
from consistent_id.errors import ModelError, RecordingError
from consistent_id.recordings.signals.derivatives import sliding_polynomials
from consistent_id.regression.regressor import TorqueModel
from consistent_id.robot.model import RobotModel
from consistent_id.rollout.servo_log import ServoLog

STEP = 2.5e-3
"""Time step [s]."""

_HARMONICS = 5  # values of a Fourier series of order two
_SMOOTHED = 0.075  # s of measured motion, for its derivatives
_FASTEST = 100.0  # rad/s: a motion that diverges is held here

REFERENCE_TEMPERATURE = 30.0
"""At which the torque is `stall` [deg C]."""


@dataclass(frozen=True, slots=True, eq=False)
class Pieces:
    """Pieces of logs, as one joint's simulation needs them, side by side.

    Parameters
    ----------
    source : ndarray of int, shape (pieces,)
        The log that each is from.
    start, speed : ndarray, shape (pieces,), [rad, rad/s]
        Measured at the beginning.
    gain, deadband : ndarray, shape (pieces,)
        Gain and deadband of the firmware, [1/rad, rad].
    supply : ndarray, shape (pieces,)
        Voltage over the nominal one.
    warmth : ndarray, shape (pieces,), [K]
        Temperature above `REFERENCE_TEMPERATURE`; zero if not known.
    driven : ndarray, shape (steps, pieces)
        One while the motor is driven, else zero.
    goals : ndarray, shape (steps + 1, pieces), [rad s]
        Integral of the goal since the beginning.
    before : ndarray, shape (pieces,), [rad]
        Goal at the beginning, for times before it.
    inertia : ndarray, shape (steps, pieces) or (1, pieces), [kg m^2]
    still, moving : ndarray, shape (steps or 1, pieces, 5)
        Fourier coefficients of the bodies' torque at rest, and of the part that is
        proportional to the speed.
    times : tuple of ndarray, [s]
        Times of the samples of each piece, and `measured` positions [rad].
    step : float, [s]
        Time step.
    """

    source: IntArray
    start: Vector
    speed: Vector
    gain: Vector
    deadband: Vector
    supply: Vector
    warmth: Vector
    driven: Matrix
    goals: Matrix
    before: Vector
    inertia: Matrix
    still: Array
    moving: Array
    times: tuple[Vector, ...]
    measured: tuple[Vector, ...]
    step: float = STEP

    @property
    def steps(self) -> int:
        """Number of time steps."""
        return len(self.driven)


def rigid_model(robot: RobotModel) -> TorqueModel:
    """Return a robot's model without drives.

    Raises
    ------
    ModelError
        If the robot's file does not state all inertias.
    """
    if robot.nominal is None:
        raise ModelError(
            f"{robot.name}: a servo's torque is measured by known bodies, but not all "
            "links have inertias; state them in the file"
        )
    return TorqueModel(robot)


class LoggedDrive(NamedTuple):
    """The firmware and the supply of a servo in one log.

    Parameters
    ----------
    gain : float, [1/rad]
    deadband : float, [rad]
    supply : float
        Voltage over the nominal one.
    """

    gain: float
    deadband: float
    supply: float = 1.0


def cut_pieces(
    robot: RobotModel,
    logs: Sequence[ServoLog],
    joint: int,
    drives: Sequence[LoggedDrive],
    window: float | None = None,
    step: float = STEP,
) -> Pieces:
    """Cut logs into windows, for one joint's simulation.

    A window begins with a measured speed, whose error is large if samples are few.  So
    the samples it is smoothed over do not count, except at the start of a log.

    Parameters
    ----------
    drives : sequence of LoggedDrive
        That of the joint in each log.
    window : float, optional, [s]
        By default logs are not cut.
    step : float, [s]
        Of the simulation.
    """
    model = rigid_model(robot)
    longest = max(float(log.time[-1]) for log in logs)
    length = longest if window is None else min(window, longest)
    steps = int(np.ceil(length / step)) + 1
    made = []
    for source, (log, drive) in enumerate(zip(logs, drives, strict=True)):
        motion = _MeasuredMotion(log)
        whole = max(int((log.time[-1] + 0.02) / length), 1)
        settled = min(motion.span, 0.5 * length)
        for number in range(whole):
            begin = number * length
            first = begin + settled if number else -1e-9
            inside = (log.time >= first) & (log.time <= begin + length)
            if inside.any():
                rows = np.flatnonzero(inside)
                made.append((log, drive, motion, begin, rows, source))
    grid: Vector = step * np.arange(steps + 1, dtype=np.float64)
    loads = [
        _load(model, motion, joint, begin + grid[:-1])
        for _, _, motion, begin, *_ in made
    ]

    def of(values: Sequence[float]) -> Vector:
        return np.array(values, float)

    return Pieces(
        source=np.array([source for *_, source in made], np.intp),
        start=of([m.position_at(b)[joint] for _, _, m, b, *_ in made]),
        speed=of([m.velocity_at(b)[joint] for _, _, m, b, *_ in made]),
        gain=of([drive.gain for _, drive, *_ in made]),
        deadband=of([drive.deadband for _, drive, *_ in made]),
        supply=of([drive.supply for _, drive, *_ in made]),
        warmth=of([warmth_of(log, joint) for log, *_ in made]),
        driven=np.column_stack(
            [_driven(log, joint, begin + grid[:-1]) for log, _, _, begin, *_ in made]
        ),
        goals=np.column_stack(
            [_integral(log, joint, begin + grid) for log, _, _, begin, *_ in made]
        ),
        before=of([_held(log, joint, b) for log, _, _, b, *_ in made]),
        inertia=np.stack([load[0] for load in loads], axis=1),
        still=np.stack([load[1] for load in loads], axis=1),
        moving=np.stack([load[2] for load in loads], axis=1),
        times=tuple(log.time[rows] - begin for log, _, _, begin, rows, _ in made),
        measured=tuple(log.position[rows, joint] for log, _, _, _, rows, _ in made),
        step=step,
    )


class _MeasuredMotion:
    """A log's motion on a uniform clock, with derivatives smoothed over `span` [s]."""

    def __init__(self, log: ServoLog) -> None:
        step = max(log.period, 1e-3)
        self.time = np.arange(0.0, log.time[-1] + step, step)
        q = np.column_stack(
            [np.interp(self.time, log.time, column) for column in log.position.T]
        )
        span = min(2 * int(0.5 * _SMOOTHED / step) + 1, (len(q) - 1) | 1)
        span = max(span, 5)
        self.span = (span - 1) * step  # s
        self.q, self.dq, self.ddq = (
            sliding_polynomials(q, span, 2, derivative=order) / step**order
            for order in range(3)
        )

    def _at(self, values: Matrix, time: Vector | float) -> Array:
        return np.array([np.interp(time, self.time, column) for column in values.T]).T

    def position_at(self, time: Vector | float) -> Array:
        return self._at(self.q, time)

    def velocity_at(self, time: Vector | float) -> Array:
        return self._at(self.dq, time)

    def acceleration_at(self, time: Vector | float) -> Array:
        return self._at(self.ddq, time)


def _load(
    model: TorqueModel, motion: _MeasuredMotion, joint: int, time: Vector
) -> tuple[Vector, Matrix, Matrix]:
    """Return a joint's inertia, and its Fourier coefficients at rest and by speed."""
    alone = len(model.robot) == 1
    at = time[:1] if alone else time
    states = motion.position_at, motion.velocity_at, motion.acceleration_at
    q, dq, ddq = (np.array(values(at)) for values in states)
    dq[:, joint] = ddq[:, joint] = 0.0
    bodies = np.asarray(model.robot.nominal, float).ravel()

    def torque(place: float, speed: float = 0.0, rate: float = 0.0) -> Vector:
        moved, faster, more = q.copy(), dq.copy(), ddq.copy()
        moved[:, joint], faster[:, joint], more[:, joint] = place, speed, rate
        return np.asarray(model.rigid_torque(bodies, (moved, faster, more))[:, joint])

    angles = 2.0 * np.pi * np.arange(_HARMONICS) / _HARMONICS
    still = np.array([torque(angle) for angle in angles])
    quick = np.array([torque(angle, 1.0) for angle in angles]) - still
    inertia = torque(0.0, rate=1.0) - still[0]
    series = np.linalg.inv(_basis(angles))
    return inertia, (series @ still).T, (series @ quick).T


def _basis(q: Array) -> Array:
    return np.stack([term(q) for term in _TERMS], axis=-1)


def warmth_of(log: ServoLog, joint: int) -> float:
    """Return a motor's temperature above `REFERENCE_TEMPERATURE` [K]; 0 if unknown."""
    if log.temperature is None or not np.isfinite(log.temperature[joint]):
        return 0.0
    return float(log.temperature[joint]) - REFERENCE_TEMPERATURE


def _row(log: ServoLog, time: Vector | float) -> Array:
    place = np.searchsorted(log.time, time, side="right") - 1
    return np.clip(place, 0, len(log.time) - 1)


def _held(log: ServoLog, joint: int, time: float) -> float:
    return float(log.goal[_row(log, time), joint])


def _driven(log: ServoLog, joint: int, time: Vector) -> Vector:
    if log.enabled is None:
        return np.ones(len(time))
    return np.asarray(log.enabled[_row(log, time), joint] > 0.5, float)


def _integral(log: ServoLog, joint: int, time: Vector) -> Vector:
    """Return the integral of the goal, constant between samples, from `time[0]`."""
    goal = log.goal[:, joint]
    whole = np.concatenate([[0.0], np.cumsum(goal[:-1] * np.diff(log.time))])
    row = _row(log, time)
    found = whole[row] + goal[row] * (time - log.time[row])
    return np.asarray(found - found[0])


def _delayed(pieces: Pieces, delay: Vector) -> Array:
    """Return mean goals of each step, shape (steps, sets, pieces), [rad]."""
    # Positions and speeds are half a step apart: a torque acts from half a step before
    # a position to half a step after it.
    edges = np.arange(pieces.steps + 1) - 0.5 - delay[:, None] / pieces.step
    place = np.clip(np.floor(edges).astype(int), 0, pieces.steps - 1)
    share = (edges - place)[..., None]
    goals = pieces.goals
    at = goals[place] + share * (goals[place + 1] - goals[place])
    early = (edges < 0.0)[..., None]
    at = np.where(early, edges[..., None] * pieces.step * pieces.before, at)
    return np.moveaxis(np.diff(at, axis=1) / pieces.step, 0, 1)


Friction = Callable[[Array, Array, Array], Array]
"""From the motor's torque, that of the bodies, and speed to friction [N m]."""


def simulated(
    parameters: Mapping[str, Vector],
    pieces: Pieces,
    friction: Callable[[Mapping[str, Array]], Friction | None] | None = None,
) -> Array:
    """Return positions, shape (steps, sets, pieces), [rad].

    Parameters
    ----------
    parameters : mapping of str to ndarray, shape (sets,)
        By the names of the module's text, and ``armature``, ``delay``, ``zero`` (the
        joint's true position less the encoder's), ``latency`` (of the firmware's
        answer to a position, [s]).
    friction : callable, optional
        Another law than the module's, from parameters, shape (sets, 1); viscous and
        Coulomb friction are added to it.
    """
    p = {name: np.asarray(value, float)[:, None] for name, value in parameters.items()}
    none = np.zeros_like(p["stall"])
    goal = _delayed(pieces, p.get("delay", none)[:, 0])
    stall = p["stall"] * pieces.supply * (1.0 - p.get("heat", none) * pieces.warmth)
    emf, zero = p.get("back_emf", none), p.get("zero", none)
    coulomb, viscous = p.get("coulomb", none), p.get("viscous", none)
    inertia = pieces.inertia[:, None] + p.get("armature", none)
    driven = pieces.driven
    changes = np.ones(len(driven), np.bool_)
    if len(inertia) == 1:
        changes[2:] = (driven[2:] != driven[1:-1]).any(axis=1)
    by_load, bodies = (friction or _friction_by_load)(p), _Bodies(pieces)
    q = np.broadcast_to(pieces.start, stall.shape).copy()
    dq = np.broadcast_to(pieces.speed, stall.shape).copy()
    out = np.empty((pieces.steps, *stall.shape))
    dead, late = bool(pieces.deadband.any()), p.get("latency")
    for step in range(pieces.steps):
        out[step] = q
        error = goal[step] - q
        if late is not None:
            error = error + late * dq
        if dead:
            beyond = np.maximum(abs(error) - pieces.deadband, 0.0)
            error = np.copysign(beyond, error)
        duty = np.minimum(np.maximum(pieces.gain * error, -1.0), 1.0)
        pull = stall * duty * driven[step]
        outer = bodies.torque(step, q + zero, dq)
        most = coulomb
        if by_load is not None:
            motor = pull - emf * driven[step] * dq
            most = most + by_load(motor, outer, abs(dq))
        if changes[step]:
            # The speed given is that at the start, so the first torque acts for half a
            # step.  Damping is exact for a constant torque.
            length = 0.5 * pieces.step if step == 0 else pieces.step
            moved = inertia[min(step, len(inertia) - 1)]
            kept, gained = _damping(viscous + emf * driven[step], moved, length)
        impulse = kept * dq + length * (pull + outer)
        most = length * most
        impulse -= np.minimum(np.maximum(impulse, -most), most)
        dq = gained * impulse
        q = q + pieces.step * np.minimum(np.maximum(dq, -_FASTEST), _FASTEST)
    return out


class _Damping(NamedTuple):
    """Factors of speed and impulse: the new speed is ``gained (kept dq + impulse)``."""

    kept: Array
    gained: Array


def _damping(viscous: Array, inertia: Array, length: float) -> _Damping:
    decay = np.maximum(length * viscous / inertia, 1e-9)
    gained = -np.expm1(-decay) / (decay * inertia)
    return _Damping(np.exp(-decay) / gained, gained)


class _Bodies:
    """The torque of the bodies on the joint, without the terms that are zero."""

    def __init__(self, pieces: Pieces) -> None:
        self.still, self.moving = pieces.still, pieces.moving
        least = 1e-12 * max(float(abs(self.still).max()), 1e-12)
        self.rests = [
            k for k in range(_HARMONICS) if (abs(self.still[..., k]) > least).any()
        ]
        self.moves = [
            k for k in range(_HARMONICS) if (abs(self.moving[..., k]) > least).any()
        ]

    def torque(self, step: int, q: Array, dq: Array) -> Array:
        """Return the torque at positions and speeds, shape (sets, pieces)."""
        at = min(step, len(self.still) - 1)
        total = np.zeros_like(q)
        for k in self.rests:
            total -= self.still[at, :, k] * _TERMS[k](q)
        for k in self.moves:
            total -= self.moving[at, :, k] * _TERMS[k](q) * dq
        return total


_TERMS: tuple[Callable[[Array], Array], ...] = (
    np.ones_like,
    np.cos,
    np.sin,
    lambda q: np.cos(2.0 * q),
    lambda q: np.sin(2.0 * q),
)


def _friction_by_load(p: Mapping[str, Array]) -> Friction | None:
    """Return the friction that depends on load or is Stribeck's; None without."""
    if "motor_load" not in p:
        return None
    motor_load, outer_load = p["motor_load"], p["outer_load"]
    stribeck, width = p["stribeck"], np.maximum(p["stribeck_velocity"], 1e-3)
    motor_slow, outer_slow = p["motor_load_stribeck"], p["outer_load_stribeck"]
    power = p.get("stribeck_power")
    of_motor, of_outer = p.get("motor_square"), p.get("outer_square")

    def law(motor: Array, outer: Array, speed: Array) -> Array:
        share = speed / width
        rests = np.exp(-(share if power is None else share**power))
        more = stribeck + abs(motor_slow * motor - outer_slow * outer)
        if of_motor is not None and of_outer is not None:
            against = np.sign(motor) != np.sign(outer)
            drives = abs(motor) > abs(outer)
            square = np.where(drives, of_outer * outer**2, of_motor * motor**2)
            more = more + against * square
        return np.asarray(abs(motor_load * motor - outer_load * outer) + rests * more)

    return law


def position_errors(
    parameters: Mapping[str, Vector],
    pieces: Pieces,
    friction: Callable[[Mapping[str, Array]], Friction | None] | None = None,
) -> Array:
    """Return mean absolute errors of position, shape (sets, pieces), [rad].

    The error of a motion that is not finite is 100 rad, so that a search leaves it.
    """
    off = _residuals(simulated(parameters, pieces, friction), pieces)
    return np.array([abs(each).mean(axis=1) for each in off]).T


def position_residuals(parameters: Mapping[str, Vector], pieces: Pieces) -> Matrix:
    """Return errors of position, shape (sets, samples of all pieces), [rad]."""
    return np.concatenate(_residuals(simulated(parameters, pieces), pieces), axis=1)


def _residuals(out: Array, pieces: Pieces) -> list[Matrix]:
    """Return errors of simulated positions of each piece, shape (sets, samples)."""
    return [
        np.nan_to_num(_at_samples(out, pieces, piece) - seen, nan=_FASTEST)
        for piece, seen in enumerate(pieces.measured)
    ]


def sampled_motion(
    parameters: Mapping[str, Vector], pieces: Pieces, age: Vector
) -> list[Matrix]:
    """Return positions of each piece, shape (sets, samples), [rad].

    Parameters
    ----------
    age : ndarray, shape (sets,), [s]
        By which positions are older than their times.
    """
    out = np.moveaxis(simulated(parameters, pieces), 0, -1)
    grid = pieces.step * np.arange(pieces.steps)
    found = []
    for piece, times in enumerate(pieces.times):
        columns = zip(age, out[:, piece], strict=True)
        found.append(np.array([np.interp(times - a, grid, q) for a, q in columns]))
    return found


def _at_samples(out: Array, pieces: Pieces, piece: int) -> Matrix:
    """Return simulated positions of a piece, shape (sets, samples)."""
    place = np.minimum(pieces.times[piece] / pieces.step, pieces.steps - 1)
    low = np.minimum(place.astype(int), pieces.steps - 2)
    share = (place - low)[:, None]
    at = out[low, :, piece]
    return np.asarray((at + share * (out[low + 1, :, piece] - at)).T)


def finite_errors(values: Mapping[str, Vector], pieces: Pieces) -> Vector:
    """Return errors of one set, shape (pieces,); refuse a motion that diverges."""
    if not np.isfinite(simulated(values, pieces)).all():
        raise RecordingError(
            "the simulated motion of the best parameters is not finite; check goals, "
            "voltage and temperature of the logs, and inertias of the robot"
        )
    return np.asarray(position_errors(values, pieces)[0])

"""Experiments on the robots of `faults_robots`, and what can go wrong with them.

A fault changes what the user has: the URDF or the log.  What the robot does on another
motion, which no user sees, stays true.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from faults_robots import (
    DRIVE,
    DURATION,
    QUANTUM,
    RATE,
    Motion,
    Robot,
    as_drawn,
    random_motion,
    times,
    urdf,
)
from scipy.signal import butter, sosfilt, sosfiltfilt

import consistent_id as ci


@dataclass(frozen=True)
class Experiment:
    """What a user has, and what only the laboratory knows.

    Parameters
    ----------
    robot : Robot
        As it is.
    drawn : Robot
        As its URDF says.
    model : TorqueModel
        The truth, with its `parameters`.
    motion : Motion
    noise : ndarray, shape (joints,), [N m or N]
    text : str
        The URDF.
    log : Recording
        Position, velocity and torque, as logged.
    besides : callable, optional
        Torque that no model knows, from a motion.
    """

    robot: Robot
    drawn: Robot
    model: ci.TorqueModel
    parameters: np.ndarray
    motion: Motion
    noise: np.ndarray
    text: str
    log: ci.Recording
    besides: Callable[[ci.Recording], np.ndarray] | None = None

    def hidden(self, rng: np.random.Generator) -> ci.Recording:
        """Return another motion with its true torque, free of noise."""
        motion = random_motion(self.robot, rng).at(self.robot.joints, times(12.0))
        return self.true_torque(motion)

    def true_torque(self, motion: ci.Recording) -> ci.Recording:
        """Return a motion with the torque that it takes."""
        log = ci.simulate_torque(self.model, self.parameters, motion)
        if self.besides is None:
            return log
        return replace(log, torque=log.torque + self.besides(motion))


Fault = Callable[[Experiment, np.random.Generator], Experiment]


def experiment(robot: Robot, rng: np.random.Generator, load_urdf) -> Experiment:  # type: ignore[no-untyped-def]
    """Return an experiment without a fault.

    `load_urdf` is from URDF text to a robot model.
    """
    model = ci.TorqueModel(load_urdf(urdf(robot)), DRIVE)
    motion = random_motion(robot, rng)
    states = motion.at(robot.joints, times())
    rigid = ci.TorqueModel(model.robot)
    bodies = np.asarray(model.robot.nominal)
    size = np.std(ci.simulate_torque(rigid, bodies, states).torque, axis=0)
    speed = np.std(states.velocity, axis=0)
    quick = np.std(states.acceleration, axis=0)
    drive = []
    for j, terms in enumerate(model.terms):
        share = size[j] * rng.uniform(0.5, 1.0)
        values = {
            "viscous": 0.2 * share / speed[j],
            "coulomb": 0.12 * share,
            "stribeck": 0.03 * share,
            "load_friction": 0.01,
            "offset": 0.02 * share * rng.normal(),
            "rotor_inertia": 0.03 * share / quick[j],
        }
        drive += [values[name] for name in terms.names]
    parameters = np.append(bodies, drive)
    noise = rng.uniform(0.005, 0.02) * np.maximum(size, 1e-3)
    drawn = as_drawn(robot, rng)
    bare = Experiment(
        robot, drawn, model, parameters, motion, noise, urdf(drawn), states
    )
    return replace(bare, log=logged(bare, states, rng))


def logged(
    case: Experiment, states: ci.Recording, rng: np.random.Generator
) -> ci.Recording:
    """Return what is logged along a motion: encoders' steps, noisy torque."""
    log = case.true_torque(states)
    torque = log.torque + case.noise * rng.normal(size=log.torque.shape)
    seen = np.round(states.position / QUANTUM) * QUANTUM
    speed = np.std(states.velocity, axis=0)
    velocity = states.velocity + 0.003 * speed * rng.normal(size=seen.shape)
    return replace(
        log, position=seen, velocity=velocity, acceleration=None, torque=torque
    )


def _with(case: Experiment, **channels: np.ndarray) -> Experiment:
    if len(channels.get("time", case.log.time)) != len(case.log):
        return replace(case, log=ci.Recording(case.log.joints, **channels))
    return replace(case, log=replace(case.log, **channels))


def _joint(case: Experiment, rng: np.random.Generator) -> int:
    """Return a joint whose torque is not small beside the others'."""
    size = np.std(case.log.torque, axis=0)
    return int(rng.choice(np.flatnonzero(size >= 0.02 * size.max())))


def _pair(case: Experiment, rng: np.random.Generator) -> list[int]:
    turning = [j for j, p in enumerate(case.robot.parts) if p.kind == "revolute"]
    return [int(j) for j in rng.choice(turning, 2, replace=False)]


def _turning(case: Experiment) -> np.ndarray:
    return np.array([part.kind == "revolute" for part in case.robot.parts])


def clocks(scale: float) -> Fault:
    return lambda case, rng: _with(case, time=case.log.time * scale)


def channel(name: str, change: Callable[[np.ndarray], np.ndarray]) -> Fault:
    """Change a whole channel."""
    return lambda case, rng: _with(case, **{name: change(getattr(case.log, name))})


def of_one(
    name: str, change: Callable[[np.ndarray, np.random.Generator], np.ndarray]
) -> Fault:
    """Change the channel of one joint whose torque matters."""

    def fault(case: Experiment, rng: np.random.Generator) -> Experiment:
        values = getattr(case.log, name).copy()
        j = _joint(case, rng)
        values[:, j] = change(values[:, j], rng)
        return _with(case, **{name: values})

    return fault


def together(*faults: Fault) -> Fault:
    """Apply faults to the same joint: each gets the same random numbers."""

    def fault(case: Experiment, rng: np.random.Generator) -> Experiment:
        seed = int(rng.integers(2**31))
        for one in faults:
            case = one(case, np.random.default_rng(seed))
        return case

    return fault


def exchanged(*names: str) -> Fault:
    """Exchange two turning joints in the named channels."""

    def fault(case: Experiment, rng: np.random.Generator) -> Experiment:
        pair = _pair(case, rng)
        channels = {name: getattr(case.log, name).copy() for name in names}
        for values in channels.values():
            values[:, pair] = values[:, pair[::-1]]
        return _with(case, **channels)

    return fault


def degrees(*names: str) -> Fault:
    def fault(case: Experiment, rng: np.random.Generator) -> Experiment:
        unit = np.where(_turning(case), np.degrees(1.0), 1.0)
        return _with(case, **{name: getattr(case.log, name) * unit for name in names})

    return fault


def late(name: str, low: float, high: float) -> Fault:
    """Delay a channel by a time between two [s]."""

    def fault(case: Experiment, rng: np.random.Generator) -> Experiment:
        shift = max(round(rng.uniform(low, high) * RATE), 1)
        values = np.roll(getattr(case.log, name), shift, axis=0)
        moved = _with(case, **{name: values})
        return replace(moved, log=moved.log.samples(slice(shift, None)))

    return fault


def filtered(name: str, cutoff: float, *, causal: bool) -> Fault:
    def fault(case: Experiment, rng: np.random.Generator) -> Experiment:
        sections = butter(2, cutoff / (RATE / 2), output="sos")
        run = sosfilt if causal else sosfiltfilt
        values = run(sections, getattr(case.log, name), axis=0)
        return _with(case, **{name: values})

    return fault


def part_of_torque(*, gravity: bool, inertial: bool, friction: bool) -> Fault:
    """Log only some parts of the torque, as a controller's own model splits it."""

    def fault(case: Experiment, rng: np.random.Generator) -> Experiment:
        states = case.motion.at(case.robot.joints, case.log.time)
        bodies = case.model.layout.inertial_size
        x = case.parameters.copy()
        x[bodies:] = 0.0
        still = replace(
            states, velocity=0 * states.velocity, acceleration=0 * states.acceleration
        )
        weight = ci.simulate_torque(case.model, x, still).torque
        moved = ci.simulate_torque(case.model, x, states).torque - weight
        kept = case.log.torque - weight - moved  # friction, rotors and noise
        torque = gravity * weight + inertial * moved + friction * kept
        if not friction:
            torque = torque + rng.normal(size=torque.shape) * case.noise
        return _with(case, torque=torque)

    return fault


def command(case: Experiment, rng: np.random.Generator) -> Experiment:
    """Log what a PD controller's position error asks for, ahead of the motor."""
    error = np.roll(case.log.position, -3, axis=0) - case.log.position
    gain = np.std(case.log.torque, axis=0) / np.std(case.log.velocity, axis=0)
    return _with(case, torque=10.0 * gain * error)


def currents(case: Experiment, rng: np.random.Generator) -> Experiment:
    """Log motor currents, A, as if they were torques."""
    ratio = rng.uniform(5.0, 15.0, len(case.robot.parts))
    return _with(case, torque=case.log.torque / ratio)


def held(share: float) -> Fault:
    """Let the robot stand still for a share of the log."""

    def fault(case: Experiment, rng: np.random.Generator) -> Experiment:
        stop = (1.0 - share) * DURATION
        q, dq, ddq = case.motion.states(np.minimum(times(), stop))
        moves = (times() < stop)[:, None]
        states = ci.Recording(case.robot.joints, times(), q, moves * dq, moves * ddq)
        return replace(case, log=logged(case, states, rng))

    return fault


def moved(change: Callable[[Motion, int], Motion]) -> Fault:
    """Move otherwise; `change` gets the motion and a joint."""

    def fault(case: Experiment, rng: np.random.Generator) -> Experiment:
        other = replace(case, motion=change(case.motion, _joint(case, rng)))
        states = other.motion.at(case.robot.joints, times())
        return replace(other, log=logged(other, states, rng))

    return fault


def _one_still(motion: Motion, j: int) -> Motion:
    amplitude = motion.amplitude.copy()
    amplitude[j] = 0.0
    return replace(motion, amplitude=amplitude)


def periodic(motion: Motion, j: int) -> Motion:
    """Return a motion that repeats every 6 s: the standard experiment."""
    step = 1.0 / 6.0
    frequency = np.maximum(np.round(motion.frequency / step), 1.0) * step
    return replace(motion, frequency=frequency)


def short(seconds: float) -> Fault:
    return lambda case, rng: replace(
        case, log=case.log.samples(slice(0, round(seconds * RATE)))
    )


def drawn(change: Callable[[Robot, np.random.Generator], Robot]) -> Fault:
    """Give the user another URDF."""
    return lambda case, rng: replace(case, text=urdf(change(case.drawn, rng)))


def real(change: Callable[[Robot, np.random.Generator], Robot]) -> Fault:
    """Let the robot be another than its URDF says."""

    def fault(case: Experiment, rng: np.random.Generator) -> Experiment:
        robot = change(case.robot, rng)
        bodies = [
            ci.InertialParameters.from_central(p.mass, p.com, p.inertia).vector
            for p in robot.parts
        ]
        x = case.parameters.copy()
        x[: case.model.layout.inertial_size] = np.concatenate(bodies)
        other = replace(case, robot=robot, parameters=x)
        states = case.motion.at(case.robot.joints, times())
        return replace(other, log=logged(other, states, rng))

    return fault


def parts(change: Callable[..., dict[str, object]]) -> Callable[..., Robot]:
    """Change every part by what `change` returns for it."""
    return lambda robot, rng: replace(
        robot, parts=tuple(replace(p, **change(p, rng)) for p in robot.parts)
    )


def one_part(change: Callable[..., dict[str, object]]) -> Callable[..., Robot]:
    """Change the part in the middle."""

    def of(robot: Robot, rng: np.random.Generator) -> Robot:
        k = len(robot.parts) // 2
        changed = replace(robot.parts[k], **change(robot.parts[k], rng))
        return replace(robot, parts=(*robot.parts[:k], changed, *robot.parts[k + 1 :]))

    return of


def leaning(degrees_: float) -> Fault:
    """Mount the robot leaning; its URDF says upright."""

    def fault(case: Experiment, rng: np.random.Generator) -> Experiment:
        angle = np.radians(degrees_)
        gravity = 9.81 * np.array([np.sin(angle), 0.0, -np.cos(angle)])
        model = replace(case.model, robot=replace(case.model.robot, gravity=gravity))
        other = replace(case, model=model)
        states = case.motion.at(case.robot.joints, times())
        return replace(other, log=logged(other, states, rng))

    return fault


def robot_has(torque_of: Callable[..., np.ndarray]) -> Fault:
    """Give the robot a torque that no model knows."""

    def fault(case: Experiment, rng: np.random.Generator) -> Experiment:
        size, j = np.std(case.log.torque, axis=0), _joint(case, rng)
        other = replace(case, besides=lambda motion: torque_of(motion, size, j))
        states = case.motion.at(case.robot.joints, times())
        return replace(other, log=logged(other, states, rng))

    return fault


def _spring(log: ci.Recording, size: np.ndarray, j: int) -> np.ndarray:
    torque = np.zeros_like(log.position)
    torque[:, j] = 1.5 * size[j] * np.sin(2.0 * log.position[:, j])
    return torque


def collision(torque: np.ndarray) -> np.ndarray:
    """Push all joints for an eighth of the log."""
    pushed, first = torque.copy(), len(torque) // 3
    pushed[first : first + len(torque) // 8] += 3.0 * np.std(torque, axis=0)
    return pushed


def _coupled(log: ci.Recording, size: np.ndarray, j: int) -> np.ndarray:
    """Friction of a motor that turns with the sum of two joints."""
    torque = np.zeros_like(log.position)
    k = j - 1 if j else 1
    speed = log.velocity[:, j] + log.velocity[:, k]
    torque[:, [j, k]] = (size[j] * np.tanh(speed / 0.02))[:, None]
    return torque


def gap(case: Experiment, rng: np.random.Generator) -> Experiment:
    """Lose a tenth of the rows while the stamps go on as if nothing were lost."""
    n = len(case.log)
    kept = np.r_[: n // 2, n // 2 + n // 10 : n]
    log = case.log.samples(kept)
    return replace(case, log=replace(log, time=np.arange(len(kept)) / RATE))


def spikes(values: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    out = values.copy()
    rows = rng.choice(len(out), len(out) // 50, replace=False)
    out[rows] += 20.0 * np.std(values) * rng.choice([-1, 1], len(rows))
    return out


def wrapped(values: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Let an encoder jump by a turn where it passes its end."""
    middle, width = np.median(values), 0.6 * np.ptp(values)
    return np.mod(values - middle + width / 2, width) + middle - width / 2


def drift(values: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    return values + np.linspace(-1.0, 1.0, len(values)) * 1.5 * np.std(values)


def clipped(values: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    limit = 0.5 * abs(values).max()
    return np.clip(values, -limit, limit)


def second_half(
    change: Callable[[np.ndarray], np.ndarray],
) -> Callable[..., np.ndarray]:
    """Change what a channel says from its middle on."""

    def of(values: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        out, half = values.copy(), len(values) // 2
        out[half:] = change(out[half:])
        return out

    return of


def stepped(values: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    step = 0.5 * np.std(values)
    return np.round(values / step) * step


def noise(values: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    return np.std(values) * rng.normal(size=values.shape)


def another_log(case: Experiment, rng: np.random.Generator) -> Experiment:
    """Torque of another run."""
    states = random_motion(case.robot, rng).at(case.robot.joints, times())
    return _with(case, torque=logged(case, states, rng).torque[: len(case.log)])


def placeholders(part: object, rng: np.random.Generator) -> dict[str, object]:
    return {"mass": 1.0, "com": (0.0, 0.0, 0.0), "size": (0.346, 0.346, 0.346)}


def units(length: float, gram: float) -> Fault:
    return lambda case, rng: replace(
        case, text=urdf(case.drawn, length=length, gram=gram)
    )


SIGN = ("torque sign", "torque channel")
ORDER = ("channel order", "channel exchange", "exchanged channels")
ZERO = ("offset zero", "joint zero offset")
CHANNEL = ("torque channel", "gravity", "torque unit", "torque gain")
GAIN = ("torque gain", "torque unit", "torque channel")
LAG = ("lag", "delay", "drive filter")
ROBOT = ("model", "robot", "geometry", "datasheet", "placeholder inertials")

CATALOGUE: dict[str, tuple[tuple[str, ...], Fault]] = {
    # The clock
    "clock in ms": (("clock",), clocks(1e3)),
    "clock in us": (("clock",), clocks(1e6)),
    "clock in ns": (("clock",), clocks(1e9)),
    "clock runs at half": (("clock",), clocks(2.0)),
    "clock runs twice as fast": (("clock",), clocks(0.5)),
    "clock 20 % fast": (("clock",), clocks(0.8)),
    "clock counts samples": (("clock",), clocks(RATE)),
    "a tenth of the rows lost": (("clock", "gap", "outliers"), gap),
    # Positions
    "positions and velocities in degrees": (
        ("degrees",),
        degrees("position", "velocity"),
    ),
    "positions in degrees": (("degrees",), degrees("position")),
    "velocities in degrees": (("degrees", "clock"), degrees("velocity")),
    "one joint in degrees": (
        ("degrees", "encoder scale"),
        together(
            of_one("position", lambda v, _: v * np.degrees(1)),
            of_one("velocity", lambda v, _: v * np.degrees(1)),
        ),
    ),
    "one encoder reversed": (
        ("position sign", *SIGN),
        together(
            of_one("position", lambda v, _: -v), of_one("velocity", lambda v, _: -v)
        ),
    ),
    "motion of two joints exchanged": (ORDER, exchanged("position", "velocity")),
    "positions of two joints exchanged": (ORDER, exchanged("position")),
    "velocities of two joints exchanged": (ORDER, exchanged("velocity")),
    "torques of two joints exchanged": (ORDER, exchanged("torque")),
    "two joints exchanged altogether": (
        (*ORDER, *ROBOT),
        exchanged("position", "velocity", "torque"),
    ),
    "zero off by 90 degrees": (ZERO, of_one("position", lambda v, _: v + np.pi / 2)),
    "zero off by 25 degrees": (ZERO, of_one("position", lambda v, _: v + 0.436)),
    "zero off by 10 degrees": (ZERO, of_one("position", lambda v, _: v + 0.175)),
    "zeros of all off by 6 degrees": (ZERO, channel("position", lambda q: q + 0.105)),
    "encoder scale 10 % off": (
        ("encoder scale", "degrees"),
        together(
            of_one("position", lambda v, _: 1.1 * v),
            of_one("velocity", lambda v, _: 1.1 * v),
        ),
    ),
    "position at the motor, gear 100": (
        ("encoder scale", "degrees"),
        together(
            of_one("position", lambda v, _: 100 * v),
            of_one("velocity", lambda v, _: 100 * v),
        ),
    ),
    "encoder counts": (
        ("encoder scale", "degrees"),
        channel("position", lambda q: q / 1e-4),
    ),
    "encoder wraps": (("wrapped encoder", "outliers"), of_one("position", wrapped)),
    "encoder stuck for half the log": (
        ("dead channel", "frozen channel", "clock"),
        of_one("position", second_half(lambda v: 0 * v + v[0])),
    ),
    "encoder dead": (("dead channel", "rank"), of_one("position", lambda v, _: 0 * v)),
    "encoder steps of 0.02 rad": (
        ("encoder resolution", "noise"),
        channel("position", lambda q: np.round(q / 0.02) * 0.02),
    ),
    "position late by 50 to 100 ms": (LAG, late("position", 0.05, 0.10)),
    # Velocities
    "velocity reversed": (
        ("velocity sign", "clock", *ORDER),
        of_one("velocity", lambda v, _: -v),
    ),
    "velocity twice too large": (
        ("clock", "velocity"),
        channel("velocity", lambda v: 2 * v),
    ),
    "velocity zero": (
        ("dead channel", "clock", "velocity"),
        channel("velocity", lambda v: 0 * v),
    ),
    "velocity late by 50 to 100 ms": ((*LAG, "velocity"), late("velocity", 0.05, 0.10)),
    # Torque
    "one torque reversed": (SIGN, of_one("torque", lambda t, _: -t)),
    "all torques reversed": (SIGN, channel("torque", lambda t: -t)),
    "torque in kN m": (GAIN, channel("torque", lambda t: t / 1e3)),
    "torque in N mm": (GAIN, channel("torque", lambda t: 1e3 * t)),
    "torque times 100": (GAIN, channel("torque", lambda t: 100 * t)),
    "torque at the motor, gear 100": (GAIN, channel("torque", lambda t: t / 100)),
    "one gain a fifth too small": (GAIN, of_one("torque", lambda t, _: 0.8 * t)),
    "one gain half": (GAIN, of_one("torque", lambda t, _: 0.5 * t)),
    "one gain twice": (GAIN, of_one("torque", lambda t, _: 2 * t)),
    "all gains 1.3": (GAIN, channel("torque", lambda t: 1.3 * t)),
    "all gains 0.7": (GAIN, channel("torque", lambda t: 0.7 * t)),
    "motor currents": (CHANNEL, currents),
    "torque without gravity": (
        CHANNEL,
        part_of_torque(gravity=False, inertial=True, friction=True),
    ),
    "torque without friction": (
        CHANNEL,
        part_of_torque(gravity=True, inertial=True, friction=False),
    ),
    "external torque only": (
        CHANNEL,
        part_of_torque(gravity=False, inertial=False, friction=False),
    ),
    "friction only": (
        CHANNEL,
        part_of_torque(gravity=False, inertial=False, friction=True),
    ),
    "gravity only": (
        CHANNEL,
        part_of_torque(gravity=True, inertial=False, friction=False),
    ),
    "command of a PD controller": (CHANNEL, command),
    "all torques zero": (("dead channel",), channel("torque", lambda t: 0 * t)),
    "one torque zero": (("dead channel",), of_one("torque", lambda t, _: 0 * t)),
    "one torque is noise": (
        ("dead channel", "torque channel"),
        of_one("torque", noise),
    ),
    "all torques are noise": (
        CHANNEL,
        lambda case, rng: _with(case, torque=noise(case.log.torque, rng)),
    ),
    "torque of another run": ((*CHANNEL, *LAG), another_log),
    "torque of another joint": (
        ORDER,
        lambda case, rng: _with(case, torque=np.roll(case.log.torque, 1, axis=1)),
    ),
    "one torque clipped": (("saturation",), of_one("torque", clipped)),
    "outliers": (("outliers",), of_one("torque", spikes)),
    "torque late by 20 to 40 ms": (LAG, late("torque", 0.02, 0.04)),
    "torque late by 50 to 100 ms": (LAG, late("torque", 0.05, 0.10)),
    "torque late by 150 to 250 ms": (LAG, late("torque", 0.15, 0.25)),
    "torque through a 1 Hz filter": (LAG, filtered("torque", 1.0, causal=True)),
    "torque smoothed at 0.2 Hz": (LAG, filtered("torque", 0.2, causal=False)),
    "torque drifts": (("drift", "torque channel"), of_one("torque", drift)),
    "one torque stops half-way": (
        ("dead channel", "frozen channel"),
        of_one("torque", second_half(lambda v: 0 * v)),
    ),
    "torque in coarse steps": (
        ("torque resolution", "noise"),
        of_one("torque", stepped),
    ),
    "torque without its sign": (SIGN, of_one("torque", lambda t, _: abs(t))),
    "torque very noisy": (
        ("noise", "torque channel"),
        lambda case, rng: _with(
            case, torque=case.log.torque + noise(case.log.torque, rng)
        ),
    ),
    # The robot is not its URDF's
    "URDF in mm": (("model", "units", *ROBOT), units(1e3, 1.0)),
    "URDF in g": (("model", "units", *ROBOT, *GAIN), units(1.0, 1e3)),
    "base leans by 90 degrees": (("gravity",), leaning(90.0)),
    "base upside down": (("gravity",), leaning(180.0)),
    "base leans by 30 degrees": (("gravity",), leaning(30.0)),
    "placeholder inertials": ((*ROBOT, *GAIN), drawn(parts(placeholders))),
    "masses doubled": (
        (*ROBOT, *GAIN),
        drawn(parts(lambda p, _: {"mass": 2 * p.mass})),
    ),
    "a mass ten times too small": (
        (*ROBOT, *GAIN),
        drawn(one_part(lambda p, _: {"mass": 0.1 * p.mass})),
    ),
    "a link 30 % too long": (
        ROBOT,
        drawn(one_part(lambda p, _: {"xyz": tuple(np.multiply(1.3, p.xyz).tolist())})),
    ),
    "an axis reversed": (
        ("position sign", *SIGN, *ROBOT),
        drawn(one_part(lambda p, _: {"axis": tuple(-a for a in p.axis)})),
    ),
    "a frame turned by 90 degrees": (
        (*ROBOT, *ZERO, *SIGN),
        drawn(one_part(lambda p, _: {"rpy": (np.pi / 2, 0.0, 0.0)})),
    ),
    "a load nobody told of": (
        (*ROBOT, *GAIN, "load"),
        real(
            lambda robot, rng: replace(
                robot,
                parts=(
                    *robot.parts[:-1],
                    replace(robot.parts[-1], mass=robot.parts[-1].mass + 4.0),
                ),
            )
        ),
    ),
    # The experiment
    "half of it at rest": (("standstill",), held(0.5)),
    "nothing moves": (("standstill", "rank"), held(0.98)),
    "one joint does not move": (("rank",), moved(_one_still)),
    "very small motion": (
        ("small motion", "rank", "noise", "standstill", "encoder resolution"),
        moved(lambda m, _: replace(m, amplitude=0.01 * m.amplitude)),
    ),
    "very slow motion": (
        ("slow motion", "rank", "standstill"),
        moved(lambda m, _: replace(m, frequency=0.03 * m.frequency)),
    ),
    "two seconds": (("rank", "short"), short(2.0)),
    "a collision": (("outliers", "contact"), channel("torque", collision)),
    "a spring nobody told of": (("spring", *ROBOT), robot_has(_spring)),
    "coupled joints": (("coupling", *ROBOT), robot_has(_coupled)),
}
"""Label -> the kinds as which it may be named, and what does it."""

CLEAN: dict[str, Fault] = {
    "clean": lambda case, rng: case,
    "clean, periodic": moved(periodic),
}

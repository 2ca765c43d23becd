"""Faults of a log: its clock, and its channels."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from faults_experiment import (
    Experiment,
    Fault,
    logged,
    strong_joint,
    turning,
    turning_pair,
    with_channels,
)
from faults_robots import RATE, random_motion, times
from scipy.signal import butter, sosfilt, sosfilt_zi, sosfiltfilt

import consistent_id as ci


def clocks(scale: float) -> Fault:
    return lambda case, rng: with_channels(case, time=case.log.time * scale)


def channel(name: str, change: Callable[[np.ndarray], np.ndarray]) -> Fault:
    """Change a whole channel."""
    return lambda case, rng: with_channels(
        case, **{name: change(getattr(case.log, name))}
    )


def of_one(
    name: str, change: Callable[[np.ndarray, np.random.Generator], np.ndarray]
) -> Fault:
    """Change the channel of one joint whose torque matters."""

    def fault(case: Experiment, rng: np.random.Generator) -> Experiment:
        values = getattr(case.log, name).copy()
        j = strong_joint(case, rng)
        values[:, j] = change(values[:, j], rng)
        return with_channels(case, **{name: values})

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
        pair = turning_pair(case, rng)
        channels = {name: getattr(case.log, name).copy() for name in names}
        for values in channels.values():
            values[:, pair] = values[:, pair[::-1]]
        return with_channels(case, **channels)

    return fault


def degrees(*names: str) -> Fault:
    def fault(case: Experiment, rng: np.random.Generator) -> Experiment:
        unit = np.where(turning(case), np.degrees(1.0), 1.0)
        return with_channels(
            case, **{name: getattr(case.log, name) * unit for name in names}
        )

    return fault


def late(name: str, low: float, high: float) -> Fault:
    """Delay a channel by a time between two [s]."""

    def fault(case: Experiment, rng: np.random.Generator) -> Experiment:
        shift = max(round(rng.uniform(low, high) * RATE), 1)
        values = np.roll(getattr(case.log, name), shift, axis=0)
        moved = with_channels(case, **{name: values})
        return replace(moved, log=moved.log.samples(slice(shift, None)))

    return fault


def filtered(name: str, cutoff: float, *, causal: bool) -> Fault:
    def fault(case: Experiment, rng: np.random.Generator) -> Experiment:
        sections = butter(2, cutoff / (RATE / 2), output="sos")
        run = sosfilt if causal else sosfiltfilt
        values = run(sections, getattr(case.log, name), axis=0)
        return with_channels(case, **{name: values})

    return fault


def drive_filter(cutoff: float) -> Fault:
    """Let the torque go through a filter of first order, as drives' have."""

    def fault(case: Experiment, rng: np.random.Generator) -> Experiment:
        sections = butter(1, cutoff / (RATE / 2), output="sos")
        start = sosfilt_zi(sections)[:, :, None] * case.log.torque[0]
        values, _ = sosfilt(sections, case.log.torque, axis=0, zi=start)
        return with_channels(case, torque=values)

    return fault


def without_velocity(case: Experiment, rng: np.random.Generator) -> Experiment:
    """Log no velocities."""
    return replace(case, log=replace(case.log, velocity=None))


def zeros(degrees_: float, *, every: bool = False) -> Fault:
    """Let the encoder of a joint, or all, read more than the URDF's angle."""

    def fault(case: Experiment, rng: np.random.Generator) -> Experiment:
        joints = len(case.robot.parts)
        moved = np.zeros(joints)
        moved[range(joints) if every else strong_joint(case, rng)] = np.radians(
            degrees_
        )
        off = with_channels(case, position=case.log.position + moved)
        return replace(off, reads=moved)

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
        return with_channels(case, torque=torque)

    return fault


def command(case: Experiment, rng: np.random.Generator) -> Experiment:
    """Log what a PD controller's position error asks for, ahead of the motor."""
    error = np.roll(case.log.position, -3, axis=0) - case.log.position
    gain = np.std(case.log.torque, axis=0) / np.std(case.log.velocity, axis=0)
    return with_channels(case, torque=10.0 * gain * error)


def currents(case: Experiment, rng: np.random.Generator) -> Experiment:
    """Log motor currents, A, as if they were torques."""
    ratio = rng.uniform(5.0, 15.0, len(case.robot.parts))
    return with_channels(case, torque=case.log.torque / ratio)


def collision(torque: np.ndarray) -> np.ndarray:
    """Push all joints for an eighth of the log."""
    pushed, first = torque.copy(), len(torque) // 3
    pushed[first : first + len(torque) // 8] += 3.0 * np.std(torque, axis=0)
    return pushed


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
    return with_channels(case, torque=logged(case, states, rng).torque[: len(case.log)])

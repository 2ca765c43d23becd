"""Intervals of drives: delay of commands, calibration.  See `coverage_methods`.

Each function yields errors over standard errors, one array for each log.
"""

import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.interpolate import make_interp_spline

sys.path.insert(0, str(Path(__file__).parent))
from coverage import LEVEL, arm, motion

import consistent_id as ci
from consistent_id.signals import DriveCalibration, PDGains, calibrated, commanded

Noise = Callable[[tuple[int, int], np.random.Generator], np.ndarray]
GAINS = PDGains(300.0, 10.0)
LATE = 0.01  # s, by which commands are late: a sample


def told() -> tuple[ci.TorqueModel, np.ndarray, ci.Recording]:
    """Return an arm, its parameters and a log whose commands make its torque."""
    model, x = arm(3)
    states = motion(model)
    spline = make_interp_spline(states.time, states.position, k=5)
    step = 0.005
    time = np.arange(0.0, states.time[-1] - 0.02, step)
    states = ci.Recording(
        states.joints, time, *(spline.derivative(k)(time) for k in range(3))
    )
    ahead = time + LATE + 0.5 * step  # commands are held for a sample
    q, dq, ddq = (spline.derivative(k)(ahead) for k in range(3))
    torque = model.predict(x, q, dq, ddq)
    command = q + (torque + GAINS.kd * dq) / GAINS.kp
    return model, x, replace(states, position_command=command)


def shaken(
    make: Callable[..., ci.Recording], noise: Noise, rng: np.random.Generator
) -> Callable[..., list[ci.Recording]]:
    """Return the same recording with noise of `LEVEL` on its torque, as a function."""
    first = make()
    added = LEVEL * first.torque.std(axis=0) * noise((len(first) + 9, 3), rng)

    def noisy(*known: object) -> list[ci.Recording]:
        one = make(*known)
        return [replace(one, torque=one.torque + added[: len(one)])]

    return noisy


def command_delays(noise: Noise, replicates: int) -> Iterator[np.ndarray]:
    """Yield errors of the delay of commands.

    They are beside the delay that is found without noise, because commands are
    interpolated between samples: this error is not noise.
    """
    model, _, log = told()
    rng = np.random.default_rng(7)

    def make(delay: float = LATE) -> ci.Recording:
        return commanded(log, GAINS, delay=delay)

    clean = ci.estimation.command_delay(model, lambda late: [make(late)]).seconds
    for _ in range(replicates):
        found = ci.estimation.command_delay(model, shaken(make, noise, rng))
        yield np.array([(found.seconds - clean) / found.standard_error])


def calibrations(noise: Noise, replicates: int) -> Iterator[np.ndarray]:
    """Yield errors of torque scales and encoder biases, bodies being known."""
    model, x, log = told()
    names = model.layout.names[: model.layout.inertial_size]
    bodies = dict(zip(names, x.tolist(), strict=False))
    known = [ci.constraints.FixedParameters(bodies)]
    start = DriveCalibration(LATE)
    truth = np.repeat([1.0, 0.0], 3)
    rng = np.random.default_rng(8)

    def make(given: DriveCalibration = start) -> ci.Recording:
        return calibrated(log, GAINS, given).samples(slice(0, len(log) - 9))

    for _ in range(replicates):
        found = ci.estimation.fit_calibration(
            model,
            shaken(make, noise, rng),
            ("scale", "encoder_bias"),
            start=start,
            constraints=known,
        )
        error = (found.values[1:] - truth) / found.standard_errors[1:]
        yield error[found.known[1:]]

"""Intervals of drives: delays, springs, calibration.  See `coverage_methods`.

Each function yields errors over standard errors, one array for each log.
"""

import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.interpolate import make_interp_spline

sys.path.insert(0, str(Path(__file__).parent))
from coverage_arm import LEVEL, arm, motion
from coverage_raw import Preparation, encoded

import consistent_id as ci
from consistent_id.regression.elastic_joints import DAMPING
from consistent_id.rollout.settings import Settings
from consistent_id.signals import DriveCalibration, PDGains, calibrated

Noise = Callable[[tuple[int, int], np.random.Generator], np.ndarray]
GAINS = PDGains(300.0, 10.0)
LATE = 0.01  # s, by which commands are late: a sample
LINK, ROTOR = 0.03, 0.05  # kg m^2, on either side of a spring
SPRING = LINK * (2.0 * np.pi * 8.3) ** 2  # N m/rad


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
    return model, x, replace(states, position_command=command, torque=torque)


def logs_of_commands(
    noise: Noise, replicates: int, seed: int
) -> Iterator[Callable[[DriveCalibration], list[ci.Recording]]]:
    """Yield logs, each a function from what is known of drives to the prepared log.

    Torque is computed from commands and positions in steps, and has noise of `LEVEL`;
    then motion and torque are filtered.
    """
    model, _, exact = told()
    rng, prepared = np.random.default_rng(seed), Preparation(model, exact)
    for _ in range(replicates):
        raw = replace(exact, position=encoded(exact.position, rng))
        size = LEVEL * exact.torque.std(axis=0)
        added = size * noise(exact.torque.shape, rng)
        prepared.log(_computed(raw, added, DriveCalibration(LATE)))
        yield lambda known, raw=raw, added=added: [
            prepared.alike(_computed(raw, added, known))
        ]


def _computed(
    raw: ci.Recording, added: np.ndarray, known: DriveCalibration
) -> ci.Recording:
    log = calibrated(raw, GAINS, known)
    return replace(log, torque=log.torque + added[: len(log)])


def command_delays(noise: Noise, replicates: int) -> Iterator[np.ndarray]:
    """Yield errors of the delay of commands.

    They are beside the mean over all logs, because commands are held and interpolated
    between samples: this error is not noise, and the same in all logs.
    """
    model, _, _ = told()
    found = [
        ci.estimation.command_delay(
            model, lambda late, log=log: log(DriveCalibration(late))
        )
        for log in logs_of_commands(noise, replicates, 7)
    ]
    seconds = np.array([one.seconds for one in found])
    # The mean of n logs takes one nth of their variance.
    off = (seconds - seconds.mean()) * np.sqrt(replicates / (replicates - 1))
    yield from (off / [one.standard_error for one in found])[:, None]


def springs(noise: Noise, replicates: int) -> Iterator[np.ndarray]:
    """Yield errors of the compliance of a spring between a motor and its link.

    Logs are prepared as `rollout` does before it chooses a cut-off.  Only those count
    in which the spring is found.
    """
    time, slow = np.arange(1600) / 200.0, 2.0 * np.pi / 8.0
    tones = 2.0 * np.pi * np.array([0.5, 1.25, 2.0, 3.0, 3.5])
    tones = np.concatenate([tones, tones + slow, tones - slow])  # they swell and fade
    sizes = 0.1 * np.repeat([0.5, -0.25, -0.25], 5)
    motor = (
        sizes
        * np.tile(np.exp(1j * np.arange(5)), 3)
        * np.exp(1j * time[:, None] * tones)
    )
    own = np.sqrt(SPRING / LINK)
    coupling = own**2 + 2j * DAMPING * own * tones
    larger = coupling / (coupling - tones**2)  # the link's motion over the motor's
    torque = -(tones**2) * (ROTOR + LINK * larger) * motor
    states = (motor, torque)
    q, tau = (x.imag.sum(axis=1, keepdims=True) for x in states)
    robot = ci.from_modified_dh("arm", [ci.DHRow(0.0, 0.0)], gravity=(0.0, 0.0, 0.0))
    body = ci.InertialParameters([1.0, 0, 0, 0, 0.002, 0, 0.05, 0, 0, LINK])
    link = replace(robot.links[0], nominal=body)
    drive = ci.DriveTerms(rotor_inertia=True)
    model = ci.TorqueModel(replace(robot, links=(link,)), drive)
    rng, cutoff = np.random.default_rng(16), Settings().cutoff
    for _ in range(replicates):
        seen = tau + LEVEL * tau.std() * noise(tau.shape, rng)
        raw = ci.Recording(robot.joint_names, time, encoded(q, rng), torque=seen)
        smooth = ci.low_passed(raw, motion_cutoff=cutoff, torque_cutoff=cutoff)
        log = ci.differentiated(smooth)
        found = ci.estimation.joint_springs(model, [log])
        if found.misfit < 1.0:
            yield (found.compliance - 1.0 / SPRING) / found.standard_errors


def calibrations(noise: Noise, replicates: int) -> Iterator[np.ndarray]:
    """Yield errors of torque scales and encoder biases, bodies being known."""
    model, x, _ = told()
    names = model.layout.names[: model.layout.inertial_size]
    bodies = dict(zip(names, x.tolist(), strict=False))
    known = [ci.constraints.FixedParameters(bodies)]
    start = DriveCalibration(LATE)
    truth = np.repeat([1.0, 0.0], 3)
    for log in logs_of_commands(noise, replicates, 8):
        found = ci.estimation.fit_calibration(
            model,
            log,
            ("scale", "encoder_bias"),
            start=start,
            constraints=known,
        )
        error = (found.values[1:] - truth) / found.standard_errors[1:]
        yield error[found.known[1:]]

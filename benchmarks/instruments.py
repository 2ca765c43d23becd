"""Least squares and instrumental variables in a closed loop, over cut-offs.

``python benchmarks/instruments.py [--draws N] [--write PAGE]`` takes a minute. A
simulated arm of three joints, with viscous and dry friction, follows sines under
feedforward and PD of a model that is 10 % off; encoders of 1e-4 rad, torque noise of
0.1 N m.  Instruments are the commanded motion, or that of the robot that least squares
with a moderate cut-off identified, simulated in the same loop.  Where the model lacks
dry friction, which is no noise, instruments do not help.
"""

import argparse

import numpy as np
from pages import add_write, shown_on

import consistent_id as ci
from consistent_id.diagnosis.coverage import column_noise
from consistent_id.laboratory import (
    Controller,
    Encoders,
    SimulatedRobot,
    controlled,
    with_friction,
)
from consistent_id.recordings.joint_paths import Sinusoid, SinusoidalMotion
from consistent_id.recordings.signals.derivatives import noise_gain

CUTOFFS = (5.0, 10.0, 20.0, 40.0, 70.0, 100.0, 150.0)  # [Hz]
MODERATE = 15.0  # [Hz]
STEP, NOISE = 1e-4, 0.1  # rad, N m
INNER = slice(300, -300)  # without the filters' ends
ARM = ci.from_modified_dh(
    "arm", [ci.DHRow(0, 0, 0.3), ci.DHRow(-np.pi / 2, 0), ci.DHRow(0, 0.4)]
)
TRUE = with_friction(
    ARM,
    [4, 0.8, 0.1, 0, 0.1, 0, 0.3, 0, 0, 0.3] * 3,
    viscous=[2, 1, 0.5],
    coulomb=[3, 3, 1],
    velocity_scale=0.05,
)
WANTED = SinusoidalMotion(
    8.0,
    1000.0,
    (
        (Sinusoid(0.6, 0.6, 0.5), Sinusoid(0.2, 0.2, 1.1)),
        (Sinusoid(0.5, 0.5, 0.4), Sinusoid(0.2, 0.2, 0.9)),
        (Sinusoid(0.6, 0.6, 0.7), Sinusoid(0.3, 0.3, 0.3)),
    ),
).recording(ARM.joint_names)
CONTROLLER = Controller(TRUE.model, 0.9 * TRUE.parameters)
BASE = ci.regression.base_parameters(TRUE.model)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--draws", type=int, default=5, help="of the torque's noise")
    add_write(parser)
    options = parser.parse_args()
    with shown_on(options.write):
        report(options.draws)


HEADER = (
    *("cut-off", "least squares", "its error as predicted", "commanded as instruments"),
    *("simulated as instruments", "p", "without dry friction: least squares"),
    "instruments",
)


def report(draws: int) -> None:
    """Print the table: errors of torque without noise, median over draws."""
    loop = controlled(TRUE, CONTROLLER, Encoders(STEP), WANTED)
    print(f"| {' | '.join(HEADER)} |\n|{'---:|' * len(HEADER)}", flush=True)
    for cutoff in CUTOFFS:
        rows = np.array([_errors(loop, cutoff, seed) for seed in range(draws)])
        middle, p = np.median(rows[:, :-1], axis=0), rows[:, -1].max()
        *good, wls, iv = middle
        told = " | ".join(f"{value:.3f} %" for value in good)
        row = f"{cutoff:.0f} Hz | {told} | {p:.2g} | {wls:.2f} % | {iv:.2f} %"
        print(f"| {row} |", flush=True)


def _errors(loop, cutoff: float, seed: int) -> list[float]:
    """Return errors [%] of all ways, and the test's p-value."""
    rng = np.random.default_rng(seed)
    torque = loop.motion.torque + NOISE * rng.normal(size=loop.torque.shape)
    raw = ci.Recording(ARM.joint_names, WANTED.time, loop.readings, torque=torque)
    log, model = _prepared(raw, cutoff).samples(INNER), TRUE.model
    plain = ci.estimation.weighted_least_squares(
        model, ci.build_regression(model, log), base=BASE
    )
    commanded, simulated = WANTED.samples(INNER), _simulated(raw)
    ways = (commanded, simulated)
    found = [
        ci.estimation.instrumental_variables(model, log, way, base=BASE) for way in ways
    ]
    lacking = ci.TorqueModel(ARM, ci.DriveTerms(viscous=True))
    poor = ci.estimation.weighted_least_squares(
        lacking, ci.build_regression(lacking, log)
    )
    found += [poor, ci.estimation.instrumental_variables(lacking, log, commanded)]
    errors = [_error(loop, estimate) for estimate in (plain, *found)]
    predicted = 100.0 * _predicted(raw, log, cutoff)
    p = ci.estimation.endogeneity_test(model, log, commanded, base=BASE).p_value
    return [errors[0], predicted, *errors[1:], p]


def _prepared(raw: ci.Recording, cutoff: float) -> ci.Recording:
    return ci.differentiated(ci.low_passed(raw, motion_cutoff=cutoff))


def _predicted(raw: ci.Recording, log: ci.Recording, cutoff: float) -> float:
    gain = noise_gain(raw, lambda recording: _prepared(recording, cutoff))
    return column_noise(TRUE.model, log, gain * STEP**2 / 12.0, BASE).torque_error


def _simulated(raw: ci.Recording) -> ci.Recording:
    """Return the motion of the constrained estimate's robot in the same loop."""
    log = _prepared(raw, MODERATE).samples(INNER)
    regression = ci.build_regression(TRUE.model, log)
    constraints = (ci.PhysicalConsistency(), ci.NonNegativeDrive())
    estimate = ci.constrained_least_squares(
        TRUE.model, regression, constraints=constraints, base=BASE
    )
    robot = SimulatedRobot(TRUE.model, estimate.parameters)
    return controlled(robot, CONTROLLER, Encoders(), WANTED).motion.samples(INNER)


def _error(loop, estimate: ci.Estimate) -> float:
    truth = loop.motion.samples(INNER)
    motion = truth.position, truth.velocity, truth.acceleration
    clean = TRUE.model.predict(TRUE.parameters, *motion)
    left = estimate.predict(truth) - clean
    return float(100.0 * np.linalg.norm(left) / np.linalg.norm(clean))


if __name__ == "__main__":
    main()

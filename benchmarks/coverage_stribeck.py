"""How often intervals of friction hold the truth if Stribeck velocities are wrong.

``python benchmarks/coverage_stribeck.py [--replicates 40] [--write PAGE]``

Arms of `coverage`.  The model states one velocity for all joints; each joint's own is
up to 1.41 times as large or small, as between velocities that a selection tries.
"""

import argparse
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
from coverage_arm import LEVEL, arm, motion, noise
from pages import add_write, shown_on

import consistent_id as ci
from consistent_id.regression.residual_noise import unconstrained_fit

KINDS = ("white", "AR(1) 0.9", "low-passed")
STATED, WRONG = 0.15, 1.41  # rad/s; ratio at the most
SIZES = {"viscous": 1.0, "coulomb": 1.5, "stribeck": 1.0}  # N m s/rad, N m, N m


def with_velocities(
    model: ci.TorqueModel, velocities: np.ndarray
) -> tuple[ci.TorqueModel, list[str]]:
    """Return the arm with Stribeck friction, and the kinds of its coefficients."""
    drive = tuple(
        ci.DriveTerms(
            viscous=True,
            coulomb="tanh",
            velocity_scale=0.01,
            stribeck_velocity=float(velocity),
        )
        for velocity in velocities
    )
    found = replace(model, drive=drive)
    return found, [kind for _, kind in found.layout.drive]


def held(joints: int, kind: str, replicates: int) -> np.ndarray:
    """Return the shares of intervals that hold the truth, shape (logs, 2).

    With the errors of velocities, and without.
    """
    bare, truth = arm(joints)
    bodies, rng = truth[: 10 * joints], np.random.default_rng(5)
    model, kinds = with_velocities(bare, np.full(joints, STATED))
    base = ci.regression.base_parameters(model)
    own = np.array(base.independent) >= len(bodies)
    states, shares = motion(bare), []
    for _ in range(replicates):
        wrong = STATED * np.exp(np.log(WRONG) * rng.uniform(-1.0, 1.0, joints))
        sizes = [SIZES[each] * rng.uniform(0.7, 1.5) for each in kinds]
        x = np.concatenate([bodies, sizes])
        log = ci.simulate_torque(with_velocities(bare, wrong)[0], x, states)
        shaken = LEVEL * log.torque.std(axis=0) * noise(kind, log, rng)
        log = replace(log, torque=log.torque + shaken)
        regression = ci.build_regression(model, log)
        found = ci.estimation.weighted_least_squares(model, regression, base=base)
        error = abs(found.base_values - base.projection @ x)[own]
        weighted = regression.weighted(found.sigma)
        inside = []
        for shapes in (weighted.noise.shapes, ()):
            noisy = replace(weighted, noise=replace(weighted.noise, shapes=shapes))
            scatter = unconstrained_fit(noisy, base).noise
            cov = scatter.steps @ scatter.scatter @ scatter.steps.T
            half = scatter.quantiles * np.sqrt(np.diag(cov))
            inside.append(np.mean(error <= half[own]))
        shares.append(inside)
    return np.array(shares)


def report(replicates: int) -> None:
    """Print the table."""
    print("| arm | noise | 95 % intervals that hold the truth | without |")
    print("|---|---|--:|--:|")
    for joints in (2, 4):
        for kind in KINDS:
            shares = held(joints, kind, replicates)
            errors = shares.std(axis=0, ddof=1) / np.sqrt(len(shares))
            cells = (
                f"{mean:.1%} ± {error:.1%}"
                for mean, error in zip(shares.mean(axis=0), errors, strict=True)
            )
            print(f"| {joints} joints | {kind} | {' | '.join(cells)} |", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--replicates", type=int, default=40)
    add_write(parser)
    options = parser.parse_args()
    with shown_on(options.write):
        report(options.replicates)


if __name__ == "__main__":
    main()

"""How often the test of consistency rejects constraints: size, and power.

``python benchmarks/consistency_size.py [--replicates N] [--duration S] [--cases ...]
[--kinds ...] [--write PAGE]`` makes logs of robots on the boundary of their
constraints.  The level of the noise is estimated from each log.  Twelve friction terms
are zero, or all links are points of known mass.  A test with a nominal 5 % should
reject 5 % of them.  The second figure of each row is for a robot that is beyond the
boundary, one parameter by some standard deviations of its least-squares estimate.  The
third is that of an ideal test of friction terms, which is told the covariance of least
squares: nothing is estimated but the parameters.
"""

import argparse
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.optimize import nnls

sys.path.insert(0, str(Path(__file__).parent))
import coverage_arm
import coverage_methods
from pages import add_write, shown_on

import consistent_id as ci
from consistent_id.comparison.consistency_test import consistency_test

KINDS = ("white", "AR(1) 0.9", "pink", "outliers", "changing level")
BEYOND = 2.5  # standard deviations of least squares
LOGS, DRAWS = 300, 4000  # of the ideal test: logs for the covariance, drawn estimates


def friction() -> tuple[ci.TorqueModel, np.ndarray, list[ci.constraints.Constraint]]:
    """Return an arm of four joints whose twelve friction terms are zero."""
    model, truth = coverage_arm.arm(4)
    drive = ci.DriveTerms(
        viscous=True, coulomb="tanh", velocity_scale=0.05, offset=True
    )
    model = ci.TorqueModel(model.robot, drive)
    first = model.layout.inertial_size
    known = np.concatenate([truth[:first], np.zeros(len(model.layout) - first)])
    terms = model.layout.names[first:]
    bounds = ci.constraints.ParameterBounds({name: (0.0, np.inf) for name in terms})
    return model, known, [bounds]


def points() -> tuple[ci.TorqueModel, np.ndarray, list[ci.constraints.Constraint]]:
    """Return an arm of three joints whose links are points of known mass."""
    model, truth = coverage_arm.arm(3)
    for k in range(3):
        body = ci.InertialParameters(truth[10 * k : 10 * k + 10])
        point = body.from_central(body.mass, body.com, np.zeros((3, 3)))
        truth[10 * k : 10 * k + 10] = point.vector
    return model, truth, [ci.PhysicalConsistency(margin=0.0), ci.FixedMasses()]


CASES = {"twelve friction terms": (friction, -3), "links that are points": (points, 29)}


def noise(kind: str, clean: ci.Recording, rng: np.random.Generator) -> np.ndarray:
    """Return noise of unit variance, shape (samples, joints)."""
    if kind == "pink":
        return coverage_methods.noise(kind, clean.torque.shape, rng)
    if kind != "changing level":
        return coverage_arm.noise(kind, clean, rng)
    white = coverage_arm.noise("white", clean, rng)
    level = np.exp(np.sin(np.linspace(0.0, 6.0 * np.pi, len(white))))[:, None]
    return white * level / np.sqrt(np.mean(level**2))


def rejected(case: str, kind: str, beyond: float, replicates: int) -> float:
    """Return the share of data sets that contradict the constraints."""
    make, place = CASES[case]
    model, truth, constraints = make()
    base = ci.regression.base_parameters(model)
    motion = coverage_arm.motion(model)
    rng, found = np.random.default_rng(2), []
    clean = ci.simulate_torque(model, truth, motion)
    size = coverage_arm.LEVEL * clean.torque.std(axis=0)

    def shaken(known: bool = False) -> ci.Regression:
        log = replace(clean, torque=clean.torque + size * noise(kind, clean, rng))
        return ci.build_regression(model, log, noise=not known)

    if beyond:
        # What an estimate of the error would add is no part of the test.
        place_in_base = base.names.index(model.layout.names[place])
        found_values = [
            ci.estimation.weighted_least_squares(
                model, shaken(known=True), base=base
            ).base_values[place_in_base]
            for _ in range(LOGS)
        ]
        truth[place] -= beyond * np.std(found_values, ddof=1)
        clean = ci.simulate_torque(model, truth, motion)
    for _ in range(replicates):
        test = consistency_test(model, shaken(), constraints=constraints, base=base)
        found.append(test.significant)
    return float(np.mean(found))


def ideal_power(kind: str, beyond: float) -> float:
    """Return the power at 5 % of the likelihood-ratio test with known covariance."""
    model, truth, _ = friction()
    base = ci.regression.base_parameters(model)
    terms = model.layout.names[model.layout.inertial_size :]
    places = [base.names.index(name) for name in terms]
    clean = ci.simulate_torque(model, truth, coverage_arm.motion(model))
    size = coverage_arm.LEVEL * clean.torque.std(axis=0)
    rng, found = np.random.default_rng(7), []
    for _ in range(LOGS):
        log = replace(clean, torque=clean.torque + size * noise(kind, clean, rng))
        regression = ci.build_regression(model, log, noise=False)
        estimate = ci.estimation.weighted_least_squares(model, regression, base=base)
        found.append(estimate.base_values[places])
    covariance = np.cov(np.transpose(found))
    whiten = np.linalg.cholesky(np.linalg.inv(covariance)).T
    shift = np.zeros(len(places))
    shift[CASES["twelve friction terms"][1]] = beyond
    away = shift * np.sqrt(np.diag(covariance))
    drawn = rng.multivariate_normal(np.zeros(len(places)), covariance, (2, DRAWS))
    right, wrong = (
        [nnls(whiten, whiten @ x)[1] for x in part]
        for part in (drawn[0], drawn[1] - away)
    )
    return float(np.mean(wrong > np.quantile(right, 0.95)))


def main() -> None:
    """Print size and power for each case and kind of noise."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--replicates", type=int, default=200)
    parser.add_argument("--duration", type=float, default=10.0, help="of a log, in s")
    parser.add_argument("--cases", nargs="+", choices=CASES, default=CASES)
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=KINDS)
    add_write(parser)
    given = parser.parse_args()
    with shown_on(given.write):
        report(given)


def report(given: argparse.Namespace) -> None:
    """Print the table."""
    coverage_arm.DURATION = given.duration
    print(
        f"| boundary | noise | size | power at {BEYOND:g} deviations | ideal |\n"
        "|---|---|--:|--:|--:|"
    )
    for case in given.cases:
        for kind in given.kinds:
            size, power = (
                rejected(case, kind, beyond, count)
                for beyond, count in (
                    (0.0, given.replicates),
                    (BEYOND, given.replicates // 2),
                )
            )
            known = case == "twelve friction terms"
            ideal = f"{ideal_power(kind, BEYOND):.0%}" if known else "-"
            row = f"| {case} | {kind} | {size:.1%} | {power:.0%} | {ideal} |"
            print(row, flush=True)


if __name__ == "__main__":
    main()

"""How often intervals hold the truth where torque is filtered, at several cut-offs.

``python benchmarks/coverage_filtered.py [--replicates 40] [--write docs/coverage.md]``

The arm of three joints of `coverage` and a UR10 (example-robot-data), with sharp dry
friction.  Torque is filtered by `low_passed`, and rows by `build_regression`, which is
the way of the documentation and of every problem file with a `torque_cutoff`.
"""

import argparse
import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
from scipy import stats
from threadpoolctl import threadpool_limits

sys.path.insert(0, str(Path(__file__).parent))
from coverage_arm import LEVEL, arm, motion, noise
from pages import stamp

import consistent_id as ci

CUTOFFS = (2.0, 5.0, 10.0)  # Hz
KINDS = ("white", "AR(1) 0.9")
WIDTH = 0.02  # rad/s, of friction's change of sign: sharp beside speeds of 1 rad/s
EXAMPLES = Path(pin.__file__).parents[4] / "share" / "example-robot-data" / "robots"
URDF = EXAMPLES / "ur_description/urdf/ur10_robot.urdf"
BEGIN, END = "<!-- filtered: begin -->", "<!-- filtered: end -->"


def ur10() -> tuple[ci.TorqueModel, np.ndarray]:
    """Return a UR10 with dry friction, and true parameters: the file's bodies."""
    robot = ci.robot.load_urdf(URDF)
    drive = ci.DriveTerms(viscous=True, coulomb="tanh", velocity_scale=WIDTH)
    model = ci.TorqueModel(robot, drive)
    friction = np.random.default_rng(10).uniform(0.5, 2.0, 3 * len(robot))
    bodies = np.ravel(robot.nominal)
    return model, np.concatenate([bodies, friction[: len(model.layout) - len(bodies)]])


def sharp(model: ci.TorqueModel, truth: np.ndarray) -> ci.TorqueModel:
    """Return a model whose friction changes its sign sharply; parameters stay."""
    drive = ci.DriveTerms(viscous=True, coulomb="tanh", velocity_scale=WIDTH)
    found = ci.TorqueModel(model.robot, drive)
    if len(found.layout) != len(truth):
        raise ValueError(f"{len(truth)} parameters, expected {len(found.layout)}")
    return found


def scores(
    model: ci.TorqueModel, truth: np.ndarray, kind: str, cutoff: float, replicates: int
) -> Iterator[np.ndarray]:
    """Yield errors of base parameters over their standard errors, log by log."""
    base = ci.regression.base_parameters(model)
    clean = ci.simulate_torque(model, truth, motion(model))
    size = LEVEL * clean.torque.std(axis=0)
    rng = np.random.default_rng(3)
    for _ in range(replicates):
        log = replace(clean, torque=clean.torque + size * noise(kind, clean, rng))
        smooth = ci.signals.low_passed(log, torque_cutoff=cutoff)
        regression = ci.build_regression(model, smooth)
        found = ci.estimation.weighted_least_squares(model, regression, base=base)
        yield (found.base_values - base.projection @ truth) / found.standard_errors


def of_friction(model: ci.TorqueModel) -> np.ndarray:
    """Return which base parameters are friction's."""
    base, bodies = ci.regression.base_parameters(model), 10 * len(model.robot)
    return np.array(base.independent) >= bodies


def held(z: Sequence[np.ndarray]) -> tuple[float, float]:
    """Return the share of errors inside 95 % intervals, and its standard error.

    Parameters of one log hang together; the error is that of the mean over logs.
    """
    inside = np.mean(abs(np.array(z)) <= stats.norm.ppf(0.975), axis=1)
    return float(inside.mean()), float(inside.std(ddof=1) / np.sqrt(len(inside)))


def table(replicates: int, cutoffs: Sequence[float] = CUTOFFS) -> str:
    """Measure the table; its rows are printed as they are found."""
    lines = [
        f"`python benchmarks/coverage_filtered.py`{stamp()}, "
        f"{replicates} logs for each row:",
        "",
        "| arm | noise | cut-off | all base parameters | friction |",
        "|---|---|--:|--:|--:|",
    ]
    print(*lines, sep="\n", flush=True)
    small, truth = arm(3)
    for name, model, x in (("3 joints", sharp(small, truth), truth), ("UR10", *ur10())):
        rubs = of_friction(model)
        for kind in KINDS:
            for cutoff in cutoffs:
                z = list(scores(model, x, kind, cutoff, replicates))
                cells = [held(z), held([own[rubs] for own in z])]
                said = " | ".join(f"{s:.1%} ± {error:.1%}" for s, error in cells)
                lines.append(f"| {name} | {kind} | {cutoff:g} Hz | {said} |")
                print(lines[-1], flush=True)
    return "\n".join(lines)


def section(replicates: int) -> str:
    """Measure the table, between the marks at which it is replaced."""
    return f"{BEGIN}\n\n{table(replicates)}\n\n{END}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--replicates", type=int, default=40)
    parser.add_argument("--write", type=Path)
    options = parser.parse_args()
    with threadpool_limits(1):
        found = section(options.replicates)
    if options.write:
        before, _, rest = options.write.read_text().partition(BEGIN)
        _, _, after = rest.partition(END)
        options.write.write_text(f"{before}{found}{after}")


if __name__ == "__main__":
    main()

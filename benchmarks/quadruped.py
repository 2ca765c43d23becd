"""The trunk of a robot on its feet, from simulated logs without force sensors.

    python benchmarks/quadruped.py --robot humanoid --logs 3 [--write PAGE]

MuJoCo simulates the robot on the ground, its trunk swaying, with contact, friction and
noise; on the trunk is a box that the model does not know.  Of the other bodies and of
rotor inertias all is known, as from a log of the robot hung up by its trunk; or, with
`--unknown`, nothing is.  Below which speed joints rest is chosen from the log, see
`rest_speed`.  Next to touch-down and lift-off samples are left out, as `impact_guard`
says, or as many periods of the cut-off as `--guards` tries; around rests as
`rest_guard` says, or as many as `--reaches` tries.  `--problem FOLDER` writes a problem
file and logs instead.  The quadruped's description is in CONSISTENT_ID_DATASETS.
"""

import argparse
import sys
from collections.abc import Iterator, Sequence
from itertools import product
from pathlib import Path
from time import process_time
from typing import NamedTuple

import numpy as np
from pages import add_write, shown_on
from standing_problem import write_problem
from standing_robots import ROBOTS, StandingRobot
from standing_simulation import SECONDS, RobotFellError, prepared, simulated

import consistent_id as ci
from consistent_id.constraints import Constraint

DRIVE = ci.DriveTerms(
    rotor_inertia=True, viscous=True, coulomb="tanh", velocity_scale=0.02
)
SIGNS = (ci.PhysicalConsistency(), ci.NonNegativeDrive())


class TrunkErrors(NamedTuple):
    """Relative error of mass, distance of centres of mass [m], relative moments."""

    mass: float
    apart: float
    moments: np.ndarray

    def __str__(self) -> str:
        moments = ", ".join(f"{m:+.1%}" for m in self.moments)
        return (
            f"mass {self.mass:+.2%}, centre {1e3 * self.apart:.2f} mm, "
            f"moments {moments}"
        )


def trunk_errors(vector: np.ndarray, robot: StandingRobot) -> TrunkErrors:
    """Return how far off the ten parameters of the trunk are."""
    trunk = ci.InertialParameters(vector)
    true = robot.true_trunk
    moments, right = (
        np.linalg.eigvalsh(body.central_inertia) for body in (trunk, true)
    )
    apart = float(np.linalg.norm(trunk.com - true.com))
    return TrunkErrors(trunk.mass / true.mass - 1.0, apart, moments / right - 1.0)


class MovingRows(NamedTuple):
    """A log without the torque of joints at rest, and what was found of rests."""

    log: ci.Recording
    rests: ci.estimation.RestSpeed


def moving_rows(
    model: ci.TorqueModel,
    log: ci.Recording,
    constraints: Sequence[Constraint],
    cutoff: float,
) -> MovingRows:
    found = ci.estimation.rest_speed(
        model, log, constraints=constraints, reach=ci.signals.rest_guard(cutoff)
    )
    if found.speed == 0.0:
        return MovingRows(log, found)
    return MovingRows(
        ci.signals.without_rests(log, found.speed, reach=found.reach), found
    )


def left_out(
    model: ci.TorqueModel,
    log: ci.Recording,
    constraints: Sequence[Constraint],
    cutoff: float,
    rests: float | None,
) -> Iterator[tuple[str, ci.Recording]]:
    """Yield a log without samples next to impacts, then without rests, too."""
    whole = ci.signals.without_impacts(log, ci.signals.impact_guard(cutoff))
    yield "impacts left out", whole
    if rests is not None:
        slow = ci.signals.without_rests(
            whole, rests, reach=ci.signals.rest_guard(cutoff)
        )
        yield f"rests below {rests:g} rad/s too", slow
        return
    started = process_time()
    moving = moving_rows(model, whole, constraints, cutoff)
    yield (
        f"rests below {moving.rests.speed:.3f} rad/s and {moving.rests.reach:.3f} s "
        f"around them too, chosen in {process_time() - started:.1f} CPU s",
        moving.log,
    )


def guarded(
    log: ci.Recording, cutoff: float, periods: Sequence[float]
) -> Iterator[tuple[str, ci.Recording]]:
    """Yield a log without samples next to impacts, for each number of periods."""
    for count in periods:
        yield (
            f"{count:g} periods left out",
            ci.signals.without_impacts(log, count / cutoff),
        )


REST = 0.03
"""rad/s: below, joints rest when guards of rests are compared."""


def reached(
    log: ci.Recording, cutoff: float, periods: Sequence[float]
) -> Iterator[tuple[str, ci.Recording]]:
    """Yield a log without impacts and rests, these with guards of some periods."""
    whole = ci.signals.without_impacts(log, ci.signals.impact_guard(cutoff))
    for count in periods:
        log = ci.signals.without_rests(whole, REST, reach=count / cutoff)
        yield f"{count:g} periods around rests below {REST:g} rad/s", log


def told(
    model: ci.TorqueModel,
    log: ci.Recording,
    constraints: Sequence[Constraint],
    robot: StandingRobot,
) -> list[str]:
    """Say how many rows a log has, and how far off the trunk is."""
    started = process_time()
    regression = ci.regression.contact_free_regression(model, log)
    base = ci.regression.contact_free_base(model, log.contacts)
    found = ci.constrained_least_squares(
        model, regression, constraints=constraints, base=base
    )
    errors = trunk_errors(found.links[robot.number], robot)
    return [
        str(regression.counts[0]),
        found.certificate.verdict,
        f"{errors.mass:+.2%}",
        f"{1e3 * errors.apart:.2f} mm",
        ", ".join(f"{m:+.1%}" for m in errors.moments),
        f"{found.fit.misfit:.2%}",
        f"{process_time() - started:.2f}",
    ]


def options_given() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robot", choices=ROBOTS, default="quadruped")
    parser.add_argument("--logs", type=int, default=3, help="simulated, each its seed")
    parser.add_argument("--first", type=int, default=0, help="seed of the first")
    parser.add_argument(
        "--guards", type=float, nargs="+", help="periods of the cut-off, each tried"
    )
    parser.add_argument(
        "--reaches", type=float, nargs="+", help="periods around rests, each tried"
    )
    parser.add_argument("--rests", type=float, help="speed of rests, else chosen")
    parser.add_argument("--seconds", type=float, default=SECONDS, help="of each log")
    parser.add_argument("--problem", type=Path, help="folder for a problem file")
    parser.add_argument("--unknown", action="store_true", help="nothing known, too")
    add_write(parser)
    return parser.parse_args()


def main() -> None:
    options = options_given()
    robot = ROBOTS[options.robot]()
    if options.problem is not None:
        print(f"written: {write_problem(options.problem, robot)}")
        return
    with shown_on(options.write):
        report(options, robot)


HEADER = (
    *("log", "samples", "dry friction", "rows used", "number", "optimum"),
    *("mass", "centre", "moments", "misfit", "CPU s"),
)


def report(options: argparse.Namespace, robot: StandingRobot) -> None:
    """Print the table of the trunk's errors."""
    model = ci.regression.contact_free_model(ci.TorqueModel(robot.nominal, DRIVE))
    known = [*SIGNS, ci.constraints.FixedParameters(robot.known())]
    print(f"{len(model.layout)} parameters, {6 + len(robot.nominal)} rows a sample")
    print(f"| {' | '.join(HEADER)} |\n{'|---' * len(HEADER)}|", flush=True)
    seeds = range(options.first, options.first + options.logs)
    for seed, dry in product(seeds, (False, True)):
        try:
            raw = simulated(robot, seed, options.seconds, dry_friction=dry)
        except RobotFellError as error:
            print(error, file=sys.stderr)
            continue
        log, cutoff = prepared(raw, robot.cutoff), robot.cutoff
        if options.guards is not None:
            cases = list(guarded(log, cutoff, options.guards))
        elif options.reaches is not None:
            cases = list(reached(log, cutoff, options.reaches))
        else:
            slow = left_out(model, log, known, cutoff, options.rests)
            cases = [("all rows", log), *slow]
        used = [(label, rows, known) for label, rows in cases]
        if options.unknown:
            used.append(("nothing known", log, SIGNS))
        for label, rows, constraints in used:
            cells = told(model, rows, constraints, robot)
            about = (str(seed), str(len(log)), "yes" if dry else "no", label)
            print(f"| {' | '.join((*about, *cells))} |", flush=True)


if __name__ == "__main__":
    main()

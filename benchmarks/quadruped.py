"""The trunk of a robot on its feet, from simulated logs without force sensors.

    python benchmarks/quadruped.py --robot humanoid --logs 3

MuJoCo simulates the robot on the ground, its trunk swaying, with contact, friction and
noise; on the trunk is a box that the model does not know.  Of the other bodies and of
rotor inertias all is known, as from a log of the robot hung up by its trunk; or, with
`--unknown`, nothing is.  Below which speed joints rest is chosen from the log, see
`rest_speed`.  Next to touch-down and lift-off samples are left out, as `impact_guard`
says, or as many periods of the cut-off as `--guards` tries.  `--problem FOLDER` writes
a problem file and logs instead.  The quadruped's description is in
CONSISTENT_ID_DATASETS.
"""

import argparse
from collections.abc import Iterator, Sequence
from itertools import product
from pathlib import Path
from time import process_time
from typing import NamedTuple

import numpy as np
from standing_problem import write_problem
from standing_robots import ROBOTS, StandingRobot
from standing_simulation import CUTOFF, SECONDS, prepared, simulated

import consistent_id as ci
from consistent_id.constraints import Constraint

REACH = 0.5 / CUTOFF  # s: what a filter spreads friction's jump by
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


def trunk_errors(found: ci.Estimate, robot: StandingRobot) -> TrunkErrors:
    trunk = ci.InertialParameters(found.links[robot.number])
    true = robot.true_trunk
    moments, right = (
        np.linalg.eigvalsh(body.central_inertia) for body in (trunk, true)
    )
    apart = float(np.linalg.norm(trunk.com - true.com))
    return TrunkErrors(trunk.mass / true.mass - 1.0, apart, moments / right - 1.0)


class MovingRows(NamedTuple):
    """A log without the torque of joints at rest, and the speed below which they are.

    Of zero, all torque is left.
    """

    log: ci.Recording
    speed: float


def moving_rows(
    model: ci.TorqueModel, log: ci.Recording, constraints: Sequence[Constraint]
) -> MovingRows:
    speed = ci.rest_speed(model, log, constraints=constraints, reach=REACH).speed
    return MovingRows(ci.without_rests(log, speed, reach=REACH), speed)


def left_out(
    model: ci.TorqueModel,
    log: ci.Recording,
    constraints: Sequence[Constraint],
    rests: float | None,
) -> Iterator[tuple[str, ci.Recording]]:
    """Yield a log without samples next to impacts, then without rests, too."""
    whole = ci.without_impacts(log, ci.impact_guard(CUTOFF))
    yield "impacts left out", whole
    if rests is not None:
        slow = ci.without_rests(whole, rests, reach=REACH)
        yield f"rests below {rests:g} rad/s too", slow
        return
    started = process_time()
    moving = moving_rows(model, whole, constraints)
    yield (
        f"rests below {moving.speed:.3f} rad/s too, chosen in "
        f"{process_time() - started:.1f} CPU s",
        moving.log,
    )


def guarded(
    log: ci.Recording, periods: Sequence[float]
) -> Iterator[tuple[str, ci.Recording]]:
    """Yield a log without samples next to impacts, for each number of periods."""
    for count in periods:
        yield f"{count:g} periods left out", ci.without_impacts(log, count / CUTOFF)


def told(
    model: ci.TorqueModel,
    log: ci.Recording,
    constraints: Sequence[Constraint],
    robot: StandingRobot,
) -> str:
    """Say how many rows a log has, and how far off the trunk is."""
    started = process_time()
    regression = ci.contact_free_regression(model, log)
    base = ci.contact_free_base(model, log.contacts)
    found = ci.constrained_least_squares(
        model, regression, constraints=constraints, base=base
    )
    return (
        f"{regression.counts[0]} rows, {found.certificate.verdict}, "
        f"{trunk_errors(found, robot)}, misfit {found.fit.misfit:.2%}, "
        f"{process_time() - started:.2f} CPU s"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robot", choices=ROBOTS, default="quadruped")
    parser.add_argument("--logs", type=int, default=3, help="simulated, each its seed")
    parser.add_argument("--first", type=int, default=0, help="seed of the first")
    parser.add_argument(
        "--guards", type=float, nargs="+", help="periods of the cut-off, each tried"
    )
    parser.add_argument("--rests", type=float, help="speed of rests, else chosen")
    parser.add_argument("--seconds", type=float, default=SECONDS, help="of each log")
    parser.add_argument("--problem", type=Path, help="folder for a problem file")
    parser.add_argument("--unknown", action="store_true", help="nothing known, too")
    options = parser.parse_args()
    robot = ROBOTS[options.robot]()
    if options.problem is not None:
        print(f"written: {write_problem(options.problem, robot)}")
        return
    model = ci.contact_free_model(ci.TorqueModel(robot.nominal, DRIVE))
    known = [*SIGNS, ci.FixedParameters(robot.known())]
    print(f"{len(model.layout)} parameters, {6 + len(robot.nominal)} rows a sample")
    seeds = range(options.first, options.first + options.logs)
    for seed, dry in product(seeds, (False, True)):
        log = prepared(simulated(robot, seed, options.seconds, dry_friction=dry))
        print(f"log {seed}, {len(log)} samples, dry friction in the joints: {dry}")
        if options.guards is None:
            cases = [("all rows", log), *left_out(model, log, known, options.rests)]
        else:
            cases = list(guarded(log, options.guards))
        for label, used in cases:
            print(f"  {label}: {told(model, used, known, robot)}", flush=True)
        if options.unknown:
            print(f"  nothing known: {told(model, log, SIGNS, robot)}", flush=True)


if __name__ == "__main__":
    main()

"""The trunk of a robot on its feet, from simulated logs without force sensors.

    python benchmarks/quadruped.py --robot humanoid --logs 3

MuJoCo simulates the robot on the ground, its trunk swaying, with contact, friction and
noise; on the trunk is a box that the model does not know.  Of the other bodies and of
rotor inertias all is known, as from a log of the robot hung up by its trunk; or, with
`--unknown`, nothing is.  Below which speed joints rest is chosen from the log, see
`rest_speed`.  `--problem FOLDER` writes a problem file and logs instead.  The
quadruped's description is in CONSISTENT_ID_DATASETS.
"""

import argparse
from collections.abc import Sequence
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


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robot", choices=ROBOTS, default="quadruped")
    parser.add_argument("--logs", type=int, default=3, help="simulated, each its seed")
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
    for seed, dry in product(range(options.logs), (False, True)):
        log = prepared(simulated(robot, seed, options.seconds, dry_friction=dry))
        started = process_time()
        moving = moving_rows(model, log, known)
        print(
            f"log {seed}, {len(log)} samples, dry friction in the joints: {dry}; rests "
            f"below {moving.speed:.3f} rad/s, chosen in {process_time() - started:.1f} "
            "CPU s"
        )
        cases = [
            ("others known", known, log),
            ("others known, joints at rest left out", known, moving.log),
            ("nothing known", SIGNS, log),
        ]
        for label, constraints, used in cases if options.unknown else cases[:-1]:
            started = process_time()
            regression = ci.contact_free_regression(model, used)
            base = ci.contact_free_base(model, log.contacts)
            found = ci.constrained_least_squares(
                model, regression, constraints=constraints, base=base
            )
            seconds = process_time() - started
            print(
                f"  {label}: {regression.counts[0]} rows, "
                f"{found.certificate.verdict}, {trunk_errors(found, robot)}, misfit "
                f"{found.fit.misfit:.1%}, {seconds:.2f} CPU s",
                flush=True,
            )


if __name__ == "__main__":
    main()

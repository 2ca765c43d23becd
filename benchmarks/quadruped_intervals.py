"""Whether intervals hold the trunk of a robot that MuJoCo simulates on its feet.

Of each log of `quadruped.py` the ten parameters of the trunk are estimated, all other
bodies known; samples next to touch-down and lift-off are left out, and joints at rest
as `rest_speed` chooses.  The radius of round feet is found by `contact_radius`; its
standard error is among the errors.  Counted are the parameters that 95 % intervals
hold: by noise as correlated as the residuals are; by the standard errors of
`uncertainty`; and among all consistent robots.

    python benchmarks/quadruped_intervals.py --robot quadruped --logs 8 --first 200
        [--write PAGE]
"""

import argparse
import sys
from time import process_time
from typing import NamedTuple

import numpy as np
import quadruped
from pages import add_write, shown_on
from standing_robots import ROBOTS, StandingRobot
from standing_simulation import RobotFellError, prepared, simulated

import consistent_id as ci
from consistent_id.constraints import Constraint
from consistent_id.estimation.uncertainties.parameter_uncertainty import uncertainty
from consistent_id.regression.residual_noise import NORMAL
from consistent_id.regression.segments import segment_regressions


class MovingLog(NamedTuple):
    """A log without impacts and rests, feet where they touch, and its variants."""

    log: ci.Recording
    variants: list[ci.Recording]
    said: str


class Held(NamedTuple):
    """How many of ten parameters three kinds of intervals hold; the trunk's errors."""

    counts: np.ndarray
    farthest: str
    trunk: quadruped.TrunkErrors


def moving_log(
    robot: StandingRobot,
    model: ci.TorqueModel,
    raw: ci.Recording,
    constraints: list[Constraint],
) -> MovingLog:
    free, whole = ci.regression.contact_free_model(model), prepared(raw, robot.cutoff)
    whole = ci.signals.without_impacts(whole, ci.signals.impact_guard(robot.cutoff))
    moving = quadruped.moving_rows(free, whole, constraints, robot.cutoff)
    said = f"{moving.rests.speed:.3f} rad/s"
    if not any(foot.radius for foot in robot.feet):
        return MovingLog(moving.log, [], said)
    feet = ci.estimation.contact_radius(free, moving.log, constraints=constraints)
    log = ci.estimation.with_radii(moving.log, feet.offset)
    said += f", {1e3 * feet.offset:+.2f} +- {1e3 * feet.standard_error:.2f} mm"
    return MovingLog(log, [ci.estimation.with_radii(log, feet.standard_error)], said)


def held(
    robot: StandingRobot,
    model: ci.TorqueModel,
    moving: MovingLog,
    constraints: list[Constraint],
) -> Held:
    found = uncertainty(
        model,
        segment_regressions(model, moving.log),
        constraints=constraints,
        base=ci.regression.contact_free_base(model, moving.log.contacts),
        replicates=2,
        variants=[ci.build_regression(model, log) for log in moving.variants],
    )
    own = slice(10 * robot.number, 10 * robot.number + 10)
    mine = found.parameters[own]
    values, errors = (
        np.array([getattr(p, what) for p in mine])
        for what in ("value", "standard_error")
    )
    added = [m.variance for m in (found.blocks, found.shifts) if m is not None]
    noise = np.sqrt(np.maximum(errors**2 - sum(v[own] for v in added), 0.0))
    off = abs(values - robot.true_trunk.vector)
    low, high = np.array([p.consistent for p in mine]).T
    inside = (low <= robot.true_trunk.vector) & (robot.true_trunk.vector <= high)
    counts = [off <= NORMAL * noise, off <= found.quantile * errors, inside]
    return Held(
        np.sum(counts, axis=1),
        f"{(off / errors).max():.2f} of {found.quantile:.2f}",
        quadruped.trunk_errors(values, robot),
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robot", choices=ROBOTS, default="quadruped")
    parser.add_argument("--logs", type=int, default=8, help="simulated, each its seed")
    parser.add_argument("--first", type=int, default=200, help="seed of the first")
    parser.add_argument("--without-friction", action="store_true", help="no dry one")
    add_write(parser)
    options = parser.parse_args()
    with shown_on(options.write):
        report(options)


HEADER = (
    *("log", "noise alone", "`uncertainty`", "consistent robots"),
    *("farthest, in standard errors", "errors", "rests, feet", "CPU s"),
)


def report(options: argparse.Namespace) -> None:
    """Print the table, and its sums."""
    robot = ROBOTS[options.robot]()
    model = ci.TorqueModel(robot.nominal, quadruped.DRIVE)
    constraints = [*quadruped.SIGNS, ci.constraints.FixedParameters(robot.known())]
    print(f"| {' | '.join(HEADER)} |\n{'|---' * len(HEADER)}|", flush=True)
    totals, logs = np.zeros(3, dtype=int), 0
    for seed in range(options.first, options.first + options.logs):
        started = process_time()
        try:
            raw = simulated(robot, seed, dry_friction=not options.without_friction)
        except RobotFellError as error:
            print(f"{seed}: {error}", file=sys.stderr)
            continue
        moving = moving_log(robot, model, raw, constraints)
        one = held(robot, model, moving, constraints)
        totals, logs = totals + one.counts, logs + 1
        print(
            f"| {seed} | {' | '.join(map(str, one.counts))} | {one.farthest} | "
            f"{one.trunk} | {moving.said} | {process_time() - started:.0f} |",
            flush=True,
        )
    sums = " | ".join(f"{total} of {10 * logs}" for total in totals)
    print(f"| all | {sums} |  |  |  |  |")


if __name__ == "__main__":
    main()

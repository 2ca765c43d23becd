"""Whether intervals hold the trunk of a robot that MuJoCo simulates on its feet.

Of each log of `quadruped.py`, with dry friction, the ten parameters of the trunk are
estimated, all other bodies known, joints at rest and samples next to touch-down and
lift-off left out.  Counted are those that
95 % intervals hold: by noise as correlated as the residuals are; with the scatter
between blocks of the motion, as `uncertainty` adds it to standard errors; and among all
consistent robots.

    python benchmarks/quadruped_intervals.py --robot quadruped --logs 4
"""

import argparse
from time import process_time

import numpy as np
import quadruped
from standing_robots import ROBOTS
from standing_simulation import CUTOFF, prepared, simulated

import consistent_id as ci
from consistent_id.comparison.parameter_uncertainty import NORMAL, uncertainty
from consistent_id.regression.segments import segment_regressions


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robot", choices=ROBOTS, default="quadruped")
    parser.add_argument("--logs", type=int, default=4, help="simulated, each its seed")
    parser.add_argument("--first", type=int, default=0, help="seed of the first")
    options = parser.parse_args()
    robot = ROBOTS[options.robot]()
    trunk = robot.true_trunk.vector
    own = slice(10 * robot.number, 10 * robot.number + 10)
    model = ci.TorqueModel(robot.nominal, quadruped.DRIVE)
    constraints = [*quadruped.SIGNS, ci.FixedParameters(robot.known())]
    print("log | by noise | with blocks | consistent robots | farthest, errors")
    totals = np.zeros(3, dtype=int)
    for seed in range(options.first, options.first + options.logs):
        started = process_time()
        whole = prepared(simulated(robot, seed))
        log = ci.without_impacts(whole, ci.impact_guard(CUTOFF))
        free = ci.contact_free_model(model)
        log = quadruped.moving_rows(free, log, constraints).log
        found = uncertainty(
            model,
            segment_regressions(model, log),
            constraints=constraints,
            base=ci.contact_free_base(model, log.contacts),
            replicates=2,
        )
        mine = found.parameters[own]
        values, errors = (
            np.array([getattr(p, what) for p in mine])
            for what in ("value", "standard_error")
        )
        between = np.zeros(10) if found.blocks is None else found.blocks.variance[own]
        noise = np.sqrt(np.maximum(errors**2 - between, 0.0))
        off = abs(values - trunk)
        low, high = np.array([p.consistent for p in mine]).T
        held = np.array(
            [
                np.sum(off <= NORMAL * noise),
                np.sum(off <= found.quantile * errors),
                np.sum((low <= trunk) & (trunk <= high)),
            ]
        )
        totals += held
        print(
            f"{seed} | {' | '.join(map(str, held))} | {(off / errors).max():.2f} of "
            f"{found.quantile:.2f} | {process_time() - started:.0f} CPU s",
            flush=True,
        )
    print(f"all | {' | '.join(map(str, totals))} | of {10 * options.logs}")


if __name__ == "__main__":
    main()

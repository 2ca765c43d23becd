"""Whether intervals hold the trunk of Go2 that MuJoCo simulates, with dry friction.

Of each log of `quadruped.py` the ten parameters of the trunk are estimated with known
legs, joints at rest left out.  Counted are those that 95 % intervals hold: by noise as
correlated as the residuals are; with the scatter between blocks of the motion, as
`uncertainty` adds it to standard errors; and among all consistent robots.

    python benchmarks/quadruped_intervals.py --logs 4
"""

import argparse
import os
from pathlib import Path
from time import process_time

import numpy as np
import quadruped

import consistent_id as ci
from consistent_id.comparison.parameter_uncertainty import NORMAL, uncertainty
from consistent_id.regression.segments import segment_regressions


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--logs", type=int, default=4, help="simulated, each its seed")
    parser.add_argument("--first", type=int, default=0, help="seed of the first")
    options = parser.parse_args()
    path = Path(os.environ["CONSISTENT_ID_DATASETS"]) / "unitree_go2" / "go2.xml"
    truth = quadruped.robots(path)
    trunk = truth.with_box.links[0].nominal.vector
    drive = ci.DriveTerms(
        rotor_inertia=True, viscous=True, coulomb="tanh", velocity_scale=0.02
    )
    model = ci.TorqueModel(truth.nominal, drive)
    constraints = [
        ci.PhysicalConsistency(),
        ci.NonNegativeDrive(),
        ci.FixedParameters(quadruped.known_of_legs(truth, path)),
    ]
    print("log | by noise | with blocks | consistent robots | farthest, errors")
    totals = np.zeros(3, dtype=int)
    for seed in range(options.first, options.first + options.logs):
        started = process_time()
        log = quadruped.prepared(quadruped.simulated(path, seed))
        log = ci.without_rests(log, quadruped.REST, reach=quadruped.REACH)
        found = uncertainty(
            model,
            segment_regressions(model, log),
            constraints=constraints,
            base=ci.contact_free_base(model, log.contacts),
            replicates=2,
        )
        values, errors = (
            np.array([getattr(p, what) for p in found.parameters[:10]])
            for what in ("value", "standard_error")
        )
        between = np.zeros(10) if found.blocks is None else found.blocks.variance[:10]
        noise = np.sqrt(np.maximum(errors**2 - between, 0.0))
        off = abs(values - trunk)
        low, high = np.array([p.consistent for p in found.parameters[:10]]).T
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

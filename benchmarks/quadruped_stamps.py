"""Whether the trunk of a foreign simulation is found when torque is stamped too early.

    python benchmarks/quadruped_stamps.py --robot a1 anymal --logs 2 [--write PAGE]

Logs are those of `quadruped_foreign.py`, which shares nothing with consistent_id.  Of
each the default draft (`draft_problem`, with nothing stated but a floating base and the
inertial unit's site) is fitted to its training part, with the delay that is found, and
with `--as-stamped` once more without.  Counted are the trunk's ten parameters that 95 %
intervals of `uncertainty` hold.
"""

import argparse
import tempfile
from pathlib import Path
from time import process_time

import msgspec
import numpy as np
from pages import add_write, shown_on
from quadruped_foreign import ROBOTS, STAMPS, nominal_file, stamped_logs

import consistent_id as ci
from consistent_id.problems.loading import problem_of
from consistent_id.problems.problem import Problem
from consistent_id.problems.problem_estimates import variant_regressions

COLUMNS = ("robot", "stamp", "seed", "delay [ms]", "fit", "mass", "centre", "moments")


def drafted(robot: Path, log: Path) -> ci.Problem:
    """Return the default problem: the first 70 % of the motion are for training."""
    draft = ci.draft_problem(robot, log, base="floating", imu="imu")
    return draft.problem()


def as_stamped(problem: Problem) -> Problem:
    """Return the same problem without a delay of the torque."""
    data = problem.table.data
    how = msgspec.structs.replace(data.preparation, delays={})
    data = msgspec.structs.replace(data, preparation=how)
    table = msgspec.structs.replace(problem.table, data=data)
    read = {entry.file: problem.read(entry.file) for entry in data.recordings}
    return problem_of(table, problem.folder / "problem.toml", read=read)


def row(problem: Problem, true: np.ndarray) -> list[str]:
    """Return errors of the trunk, and how many intervals hold it."""
    logs = problem.training
    segments = ci.regression.segment_regressions(problem.model, logs)
    found = ci.uncertainty(
        problem.model,
        segments,
        constraints=problem.constraints,
        base=ci.regression.contact_free_base(problem.model, logs[0].contacts),
        replicates=2,
        variants=variant_regressions(problem, logs),
    )
    own = found.parameters[:10]
    values = np.array([p.value for p in own])
    errors = np.array([p.standard_error for p in own])
    inside = int(np.sum(abs(values - true) <= found.quantile * errors))
    body, right = ci.InertialParameters(values), ci.InertialParameters(true)
    moments = np.linalg.eigvalsh(body.central_inertia)
    off = moments / np.linalg.eigvalsh(right.central_inertia) - 1.0
    apart = 1e3 * float(np.linalg.norm(body.com - right.com))
    return [
        f"{body.mass / right.mass - 1:+.2%}",
        f"{apart:.2f} mm",
        ", ".join(f"{m:+.1%}" for m in off),
        f"{inside} of 10",
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robot", choices=ROBOTS, nargs="+", default=list(ROBOTS))
    parser.add_argument("--logs", type=int, default=2, help="simulated, each its seed")
    parser.add_argument("--first", type=int, default=10, help="seed of the first")
    parser.add_argument("--stamps", choices=STAMPS, nargs="+", default=list(STAMPS))
    parser.add_argument("--as-stamped", action="store_true", help="without it, too")
    add_write(parser)
    options = parser.parse_args()
    with shown_on(options.write):
        report(options)


def report(options: argparse.Namespace) -> None:
    """Print the table."""
    header = (*COLUMNS, "true values in 95 % intervals", "CPU s")
    print(f"| {' | '.join(header)} |\n{'|---' * len(header)}|", flush=True)
    for name in options.robot:
        for seed in range(options.first, options.first + options.logs):
            logs = stamped_logs(ROBOTS[name], seed)
            for stamp in options.stamps:
                folder = Path(tempfile.mkdtemp())
                robot = nominal_file(ROBOTS[name], folder)
                problem = drafted(robot, logs.write(folder / "log.csv", stamp))
                fits = {"corrected": problem}
                if options.as_stamped:
                    fits["as stamped"] = as_stamped(problem)
                for fit, one in fits.items():
                    started = process_time()
                    errors = row(one, logs.true)
                    late = one.found_in_training.delay
                    said = "-"
                    if late is not None:
                        width = 1e3 * late.half_width
                        said = f"{1e3 * late.seconds:+.2f} +- {width:.2f}"
                    used = f"{process_time() - started:.0f}"
                    cells = name, stamp, str(seed), said, fit
                    print(f"| {' | '.join((*cells, *errors, used))} |", flush=True)


if __name__ == "__main__":
    main()

"""What designs bring in a closed loop: rehearsals of several robots in MuJoCo.

``python benchmarks/rehearsals.py [ROBOT ...] [--robots 3] [--seconds 10] [--write
PAGE]``: a table for each robot of example-robot-data, with its design, the rival
objective's, random paths and sinusoids, and last the errors of all in shares of the
random paths'.
"""

import argparse
import sys
from pathlib import Path

import numpy as np
from pages import add_write, shown_on

sys.path.insert(0, str(Path(__file__).parent))
from excitation_cases import EXAMPLES

from consistent_id.excitation.sources import problem_to_excite
from consistent_id.laboratory.rehearsal.dry_runs import dry_run
from consistent_id.problems.statement import Statement

ROBOTS = {
    "UR10": ("ur_description/urdf/ur10_robot.urdf", None),
    "UR5": ("ur_description/urdf/ur5_robot.urdf", None),
    "Panda": ("panda_description/urdf/panda.urdf", "panda_link8"),
    "Kinova": ("kinova_description/robots/kinova.urdf", "j2s6s200_link_6"),
    "Z1": ("z1_description/urdf/z1.urdf", "link06"),
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", default=[], help=", ".join(ROBOTS))
    parser.add_argument("--robots", type=int, default=3, help="planted, of each")
    parser.add_argument("--seconds", type=float, default=10.0, help="of each search")
    parser.add_argument("--executor", help="processes, dask, ... (default: here)")
    add_write(parser)
    options = parser.parse_args()
    with shown_on(options.write):
        report(options)


def report(options: argparse.Namespace) -> None:
    """Print the tables; how limits were used goes to stderr."""
    ratios: dict[str, list[float]] = {}
    header: tuple[str, ...] = ()
    rows: list[tuple[str, ...]] = []
    for name in options.names or ROBOTS:
        file, tip = ROBOTS[name]
        changes = {"share": 0.9, "acceleration": 10.0}
        problem = problem_to_excite(EXAMPLES / file, changes, Statement(tip=tip))
        found = dry_run(
            problem,
            robots=options.robots,
            rivals=True,
            time_limit=options.seconds,
            executor=options.executor,
        )
        table, *others = found.tables()
        header, rows = table.header, [*rows, *((name, *row) for row in table.rows)]
        for other in (table, *others):
            print(f"\n{other.text()}", file=sys.stderr, flush=True)
        means = {
            motion: np.median([one.mean_error for one in some])
            for motion, some in found.rehearsals.items()
        }
        for motion, mean in means.items():
            ratios.setdefault(motion, []).append(mean / means["random paths"])
    print(f"| robot | {' | '.join(header)} |\n|---{'|---' * len(header)}|")
    for row in rows:
        print(f"| {' | '.join(row)} |")
    print("\n| motion | error over that of random paths, geometric mean | most |")
    print("|---|---:|---:|")
    for motion, some in ratios.items():
        print(f"| {motion} | {np.exp(np.mean(np.log(some))):.2f} | {max(some):.2f} |")


if __name__ == "__main__":
    main()

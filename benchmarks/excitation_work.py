"""How long a unit of work takes, by robot, objective and what is in the way.

``python benchmarks/excitation_work.py``: processor time of single searches over their
work, see ``consistent_id/excitation/search_problem.py``.  One is a second of the
processor that the constants there were measured on.
"""

import sys
import time
from dataclasses import replace
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
import excitation_cases as cases

from consistent_id.excitation.aims import Aim
from consistent_id.excitation.path_search import FoundPath, searched_path
from consistent_id.excitation.search_problem import search_problem
from consistent_id.excitation.verification import demands
from consistent_id.regression.base import base_parameters


def main() -> None:
    print(
        "| robot | objective | harmonics | iterations | work | processor [s] | ratio |"
    )
    print("|---|---|---:|---:|---:|---:|---:|")
    for case in (
        cases.rx60(),
        cases.example("UR10"),
        cases.example("UR10", effort=True),
        cases.example("Panda"),
        cases.example("Panda", effort=True),
    ):
        base, guards = base_parameters(case.model), demands(case.model, case.limits)
        for objective in ("D", "condition"):
            for harmonics in (5, 12):
                form, aim = replace(case.form, harmonics=harmonics), Aim(objective)
                problem = search_problem(case.model, base, form, aim, case.limits)
                problem = problem.guarded(guards.guards)
                problem.random(0)  # compiles
                began = time.process_time()
                found = searched_path(problem, FoundPath(0))
                seconds = time.process_time() - began
                print(
                    f"| {case.name} | {objective} | {harmonics} | {found.iterations} "
                    f"| {found.work:.2f} | {seconds:.2f} "
                    f"| {seconds / found.work:.2f} |",
                    flush=True,
                )


if __name__ == "__main__":
    main()

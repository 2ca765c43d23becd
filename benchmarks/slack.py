"""What choosing the slack from training data brings on validation recordings.

``python benchmarks/slack.py [--write docs/model-selection.md]``, with recordings in
``CONSISTENT_ID_DATASETS``.  Everything is chosen on training recordings, as the problem
files prepare them; the judge is the torque of the validation recordings below 5 Hz.
"""

import argparse
from pathlib import Path

import msgspec
import numpy as np
from pages import written_to

import consistent_id as ci
from consistent_id.estimation.estimate import torque_errors
from consistent_id.estimation.method import Method
from consistent_id.problems.loading import problem_of
from consistent_id.problems.study import Study

PROBLEMS = ("ur10e", "kuka_kr300", "staubli_tx40", "tiago")
JUDGE = 5.0  # Hz
HEADER = (
    "| robot | default slack [%] | slack chosen | constrained [%] "
    "| weighted constrained [%] | cross-validated [%] | recommended |",
    "|---|---:|---:|---:|---:|---:|---|",
)


def row(name: str) -> str:
    """Return a robot's row of the table."""
    problem = ci.load_problem(f"problems/{name}")
    study = Study(problem)
    found = study.slacks[Method.CONSTRAINED]
    default = ci.constrained_least_squares(
        problem.model,
        study.regression,
        constraints=problem.constraints,
        prior=problem.prior,
        base=study.base,
    )
    estimates = [default, *map(study.estimate, study.recommendation.candidates)]
    judge = judged_at(problem, JUDGE).validation
    errors = np.array([[e.stacked for e in torque_errors(estimates, r)] for r in judge])
    cells = ["; ".join(f"{100 * e:.2f}" for e in column) for column in errors.T]
    slack = found.slacks[found.best]
    cells.insert(1, slack)
    return f"| {name} | {' | '.join(cells)} | {study.recommendation.method} |"


def judged_at(problem: ci.Problem, cutoff: float) -> ci.Problem:
    """Return the problem with another filter of the torque."""
    change, data = msgspec.structs.replace, problem.table.data
    preparation = change(data.preparation, torque_cutoff=cutoff)
    table = change(problem.table, data=change(data, preparation=preparation))
    return problem_of(table, problem.source)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", type=Path, help="page to write the table to")
    page = parser.parse_args().write
    rows = [row(name) for name in PROBLEMS]
    with written_to(page, "slack", PROBLEMS):
        print("\n".join([*HEADER, *rows]))


if __name__ == "__main__":
    main()

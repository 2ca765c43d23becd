"""Errors with the selected band of the torque, beside those with 5, 10 and 15 Hz.

``python benchmarks/bands.py [--only NAME ...] [--write docs/model-selection.md]``, with
recordings in ``CONSISTENT_ID_DATASETS``.  Terms, masses and rows are those of the
problem files.  The cut-off of the motion keeps its ratio to that of the torque.  Errors
of different bands do not compare.  So each estimate predicts the validation recordings
as the file prepares their motion, and each row has one filter of the torque.
"""

import argparse
from pathlib import Path

import msgspec
import numpy as np
from pages import written_to
from selection_bare import recommended
from slack import judged_at

import consistent_id as ci
from consistent_id.estimation.estimate import torque_errors
from consistent_id.problems.loading import problem_of
from consistent_id.problems.study import Study

PROBLEMS = ("ur10e", "kuka_kr300", "staubli_tx40", "tiago")
BANDS = (5.0, 10.0, 15.0)  # Hz, those of training and those of the judge
HEADER = (
    "| robot | judged below | selected band [%] "
    f"| {' | '.join(f'{band:g} Hz [%]' for band in BANDS)} | selected over best |",
    "|---|--:|--:|" + "--:|" * (len(BANDS) + 1),
)


def trained_in(problem: ci.Problem, band: float) -> ci.Problem:
    """Return the problem with another band of the torque, and of the motion."""
    change, data = msgspec.structs.replace, problem.table.data
    old = data.preparation
    motion = old.motion_cutoff * band / old.torque_cutoff
    preparation = change(old, torque_cutoff=band, motion_cutoff=motion)
    table = change(problem.table, data=change(data, preparation=preparation))
    return problem_of(table, problem.source)


def rows_of(name: str) -> list[str]:
    """Return a robot's rows of the table, one for each filter of the judge."""
    problem = ci.load_problem(f"problems/{name}")
    selected = problem.table.data.preparation.torque_cutoff
    estimates = [
        recommended(Study(p))
        for p in (problem, *(trained_in(problem, band) for band in BANDS))
    ]
    rows = []
    for cutoff in BANDS:
        judge = judged_at(problem, cutoff).validation
        errors = np.array(
            [[e.stacked for e in torque_errors(estimates, r)] for r in judge]
        )
        cells = ["; ".join(f"{100 * e:.2f}" for e in column) for column in errors.T]
        ratio = float(np.max(errors[:, 0] / errors[:, 1:].min(axis=1)))
        cells[0] += f" ({selected:g} Hz)"
        line = f"| {name} | {cutoff:g} Hz | {' | '.join(cells)} | {ratio:.2f} |"
        rows.append(line)
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", nargs="+", choices=PROBLEMS, default=PROBLEMS)
    parser.add_argument("--write", type=Path, help="page to write the table to")
    options = parser.parse_args()
    rows = [row for name in options.only for row in rows_of(name)]
    with written_to(options.write, "bands", options.only):
        print("\n".join([*HEADER, *rows]))


if __name__ == "__main__":
    main()

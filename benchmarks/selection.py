"""How well `select_model` chooses, blind: real recordings and simulated robots.

``python benchmarks/selection.py [--write docs/model-selection.md]``

Real robots (``CONSISTENT_ID_DATASETS``): the files of ``hand_made/``, which were
written before the selection was, with the model as the file has it, with the plain
default, and with the one that is selected from the training recordings.  Errors are of
the validation recordings, their torque filtered as the hand-made file asks.

Simulated robots (`selection_robots`): a draft of a log, plain and selected, against
the true model fitted to the same rows.  Errors are of another motion's true torque.

Bare calls (`selection_bare`): the same logs as the real robots', without a file.
"""

import argparse
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
from selection_bare import COLUMNS, HAND_MADE, bare, recommended
from selection_robots import DURATION, TRUTHS, Case, case_of, written

import consistent_id as ci
from consistent_id.estimation.estimate import torque_errors
from consistent_id.problems.loading import problem_of
from consistent_id.problems.study import Study

PROBLEMS = ("ur10e", "kuka_kr300", "staubli_tx40", "tiago")
_BEGIN, _END = "<!-- figures: begin -->", "<!-- figures: end -->"


def real(name: str) -> list[str]:
    """Return the row of a real robot."""
    problem = ci.load_problem(HAND_MADE / f"{name}.toml", trust=True)
    selection = ci.problems.select_model(problem)
    plain = replace(selection, choice=selection.start)
    models = (problem, plain.chosen(), selection.chosen())
    errors = [recommended_error(model, problem) for model in models]
    return [name, *errors, *_cost(selection)]


def recommended_error(problem: ci.Problem, judge: ci.Problem) -> str:
    """Return the recommended estimate's error on each validation recording.

    The torque is filtered as `judge` asks; nothing else of a study is computed.
    """
    cutoff = judge.table.data.preparation.torque_cutoff
    change = msgspec.structs.replace
    data = problem.table.data
    preparation = change(data.preparation, torque_cutoff=cutoff)
    table = change(problem.table, data=change(data, preparation=preparation))
    study = Study(problem_of(table, judge.source))
    estimate = recommended(study)
    errors = [torque_errors([estimate], r)[0].stacked for r in study.validation]
    return "; ".join(_percent(error) for error in errors)


def simulated(name: str, seed: int) -> list[str]:
    """Return the row of a simulated robot."""
    case = case_of(TRUTHS[name], seed)
    with tempfile.TemporaryDirectory() as folder:
        model, log = written(case, Path(folder))
        draft = ci.draft_problem(model, log)
        plain = ci.draft_problem(model, log, select=False)
        problems = [plain.problem(), draft.problem()]
        errors = [_of_hidden(_fitted(p), case) for p in problems]
        errors.append(_of_hidden(_oracle(problems[1], case), case))
    if draft.selection is None:
        return [name, *map(_percent, errors), "", "", draft.notes[-1]]
    return [name, *map(_percent, errors), *_cost(draft.selection)]


def _fitted(problem: ci.Problem) -> ci.Estimate:
    regression = ci.build_regression(problem.model, problem.training)
    constraints = problem.constraints
    return ci.constrained_least_squares(
        problem.model, regression, constraints=constraints
    )


def _oracle(problem: ci.Problem, case: Case) -> ci.Estimate:
    """Fit the true model to the rows of a problem, true masses known."""
    regression = ci.build_regression(case.model, problem.training)
    return ci.constrained_least_squares(case.model, regression)


def _of_hidden(estimate: ci.Estimate, case: Case) -> float:
    """Return the error on a motion that was not recorded."""
    states = case.hidden.of(estimate.model.robot.joint_names)
    error = estimate.predict(states) - states.torque
    return float(np.linalg.norm(error) / np.linalg.norm(states.torque))


def _percent(error: float) -> str:
    return f"{100 * error:.2f}"


def _cost(selection: ci.problems.ModelSelection) -> list[str]:
    labels = "; ".join(step.move.label for step in selection.steps)
    return [f"{selection.seconds:.1f}", str(selection.fits), labels or "nothing"]


def table(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a Markdown table."""
    lines = [columns, ["---"] * len(columns), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--real", nargs="*", default=list(PROBLEMS))
    parser.add_argument("--simulated", nargs="*", default=list(TRUTHS))
    parser.add_argument("--bare", nargs="*", default=list(PROBLEMS))
    parser.add_argument("--seed", type=int, default=2)
    parser.add_argument("--write", type=Path)
    options = parser.parse_args()
    rows = []
    for name in options.real:
        rows.append(real(name))
        print(*rows[-1], sep=" | ", flush=True)
    first = table(_REAL, rows)
    rows = []
    for name in options.simulated:
        rows.append(simulated(name, options.seed))
        print(*rows[-1], sep=" | ", flush=True)
    parts = ["", first, _SIMULATED_INTRO, table(_SIMULATED, rows)]
    rows = []
    for name in options.bare:
        rows.append(bare(name))
        print(*rows[-1], sep=" | ", flush=True)
    text = "\n\n".join([*parts, _BARE_INTRO, table(COLUMNS, rows), ""])
    if options.write:
        page = options.write.read_text()
        before, _, rest = page.partition(_BEGIN)
        _, _, after = rest.partition(_END)
        options.write.write_text(f"{before}{_BEGIN}{text}{_END}{after}")


_REAL = (
    "robot",
    "hand-made file [%]",
    "plain default [%]",
    "selected [%]",
    "CPU [s]",
    "fits",
    "chosen",
)
_SIMULATED = (
    "simulated robot",
    "plain default [%]",
    "selected [%]",
    "true model [%]",
    "CPU [s]",
    "fits",
    "chosen",
)
_SIMULATED_INTRO = (
    f"Simulated robots, {DURATION:.0f} s of random motion of which 70 % train; the "
    "error is that of the true torque of another motion:"
)
_BARE_INTRO = (
    "`identify robot.urdf log`, with stated column names, gains, joints with torque "
    "and joints that stand still. For `staubli_tx40`, the error is that on the last "
    "part of its one log, which neither model was trained on:"
)


if __name__ == "__main__":
    main()

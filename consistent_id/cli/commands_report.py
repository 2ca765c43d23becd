"""What ``consistent-id report`` does: a problem worked through, as one HTML file."""

from dataclasses import dataclass
from pathlib import Path

from consistent_id._support.files import require_writable
from consistent_id.cli.commands import check_problem, uncertainty_of
from consistent_id.problems.problem import Problem
from consistent_id.problems.study import run_study
from consistent_id.report import Advice, advise, write_report


@dataclass(frozen=True, slots=True)
class Reported:
    """A report that was written.

    Parameters
    ----------
    path : Path
    advice : Advice
    faults : int
        Found in the recordings.
    size : int
        Of the file, in bytes.
    """

    path: Path
    advice: Advice
    faults: int
    size: int


def report_problem(
    problem: Problem,
    output: Path,
    *,
    seed: int = 0,
    command: str = "",
    progress: bool = False,
) -> Reported:
    """Work a problem through and write all that was found as one HTML file.

    Parameters
    ----------
    problem : Problem
    output : Path
    seed : int
        Of the bootstrap.
    command : str
        By which the report is made again.
    progress : bool
        Show how far it is, on the standard error.

    Raises
    ------
    ProblemError, InfeasibleError, NotExcitedError, SolverError
        See `run_study`; before that, if the file cannot be written.
    """
    require_writable(output.parent)
    study = run_study(problem, progress=progress)
    uncertainty, _ = uncertainty_of(problem, seed=seed, progress=progress)
    # What is simulated needs no detective.
    recorded = problem.table.data is not None
    diagnosis = check_problem(problem)[0] if recorded else None
    path = write_report(
        study,
        output,
        diagnosis=diagnosis,
        uncertainty=uncertainty,
        seed=seed,
        command=command,
    )
    faults = 0 if diagnosis is None else len(diagnosis.faults)
    advice = advise(study.comparison, diagnosis)
    return Reported(path, advice, faults, path.stat().st_size)

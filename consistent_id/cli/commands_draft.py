"""What the shell does with a robot and a log that have no problem file."""

from dataclasses import dataclass, replace
from pathlib import Path

from consistent_id._support.files import write_atomically
from consistent_id._support.tables import Table
from consistent_id.cli.commands import check_problem, compare_problem
from consistent_id.comparison.comparison import verdict_table
from consistent_id.diagnosis import Diagnosis
from consistent_id.diagnosis.diagnosis_table import diagnosis_table
from consistent_id.problems.draft import Draft, draft_table
from consistent_id.problems.study import Study

_BEST = "constrained"


@dataclass(frozen=True, slots=True, eq=False)
class LogIdentified:
    """A log worked through.

    Parameters
    ----------
    draft : Draft
    findings : Diagnosis
        What is wrong with the log.
    study : Study
    tables : list of Table
        In short, the verdict first.
    written : list of Path
    """

    draft: Draft
    findings: Diagnosis
    study: Study
    tables: list[Table]
    written: list[Path]


def identify_log(
    draft: Draft, output: Path | None = None, *, progress: bool = False
) -> LogIdentified:
    """Identify a robot from one log.

    Parameters
    ----------
    draft : Draft
    output : Path, optional
        Folder for the problem file, estimates, tables and figures.
    progress : bool
    """
    problem = draft.problem()
    findings, _ = check_problem(problem)
    study, _, written = compare_problem(problem, output, progress=progress)
    if output is not None:
        file = write_atomically(output / "problem.toml", draft.text(output))
        estimates = [e.save(output / _file_name(e.method)) for e in study.estimates]
        written = [file, *estimates, *written]
    verdicts = verdict_table(study.comparison)
    if findings.faults:
        kinds = ", ".join(dict.fromkeys(fault.kind for fault in findings.faults))
        warning = f"the log seems faulty ({kinds}; see below): trust none of this yet"
        verdicts = replace(verdicts, notes=(warning, *verdicts.notes))
    tables = [
        verdicts,
        draft_table(draft),
        diagnosis_table(findings),
        study.comparison[_BEST].estimate.table(),
    ]
    return LogIdentified(draft, findings, study, tables, written)


def _file_name(method: str) -> str:
    return f"{method.replace(' ', '_')}.json"

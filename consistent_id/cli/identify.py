"""``consistent-id identify``: a problem, or a robot and a log without one."""

import argparse
from pathlib import Path
from typing import Any

from consistent_id.cli.answers import Answer, answered, show, shows_progress
from consistent_id.cli.log_options import add_draft_options, draft_of
from consistent_id.cli.options import (
    add_command,
    add_output,
    add_problem,
    add_time_limit,
)
from consistent_id.errors import ProblemError

_MORE = """With a URDF or MJCF file in place of PROBLEM, and a log, no problem file is
needed: columns are told from their names, the last 30 % of the motion judge, and
--output FOLDER also holds the problem.toml that says all this (see init).
Exit code 1: no estimate could be certified."""
_EXAMPLES = """
consistent-id identify robot.urdf log.csv
consistent-id identify robot.urdf log.csv --output results/robot --report robot.html
consistent-id identify problems/rx60
consistent-id identify problems/ur10e --uncertainty --output results/ur10e
"""


def add_identify(commands: Any) -> None:
    """Add the command to a parser's commands."""
    command = add_command(
        commands,
        "identify",
        "estimate parameters by every method",
        run_identify,
        more=_MORE,
        examples=_EXAMPLES,
    )
    add_problem(command)
    command.add_argument(
        "log", type=Path, nargs="?", help="a log, if PROBLEM is a URDF or MJCF file"
    )
    add_output(command, None)
    command.add_argument(
        "--report", type=Path, metavar="FILE", help="write a report (HTML)"
    )
    command.add_argument(
        "--uncertainty",
        action="store_true",
        help="also say how sure the constrained estimate is of each parameter",
    )
    command.add_argument(
        "--seed", type=int, default=0, help="of the bootstrap (default: 0)"
    )
    add_time_limit(command)
    add_draft_options(command)


def run_identify(options: argparse.Namespace) -> int:
    """Identify; return the exit code."""
    if options.log is not None:
        return show(options, _identify_log(options))
    return answered(options, _identify)


def _identify(options: argparse.Namespace) -> Answer:
    from consistent_id.cli.commands import identify_problem
    from consistent_id.problems.problem import load_problem
    from consistent_id.problems.study import run_study
    from consistent_id.report import write_report

    _refuse_drafting(options)
    problem = load_problem(options.problem)
    output = None if options.dry_run else options.output
    estimates, tables = identify_problem(problem, output)
    record: dict[str, object] = {"estimates": [e.to_dict() for e in estimates]}
    told = _uncertainty(options, problem, tables, record)
    if options.report is not None and not options.dry_run:
        study = run_study(problem, progress=shows_progress(options))
        told += f"\n\nwritten: {write_report(study, options.report)}"
    certified = any(e.certificate.verdict == "certified" for e in estimates)
    return Answer(0 if certified else 1, told, record)


def _identify_log(options: argparse.Namespace) -> Answer:
    from consistent_id.cli.commands_draft import identify_log
    from consistent_id.diagnosis.diagnosis_table import diagnosis_record
    from consistent_id.report import write_report
    from consistent_id.report.study_record import study_record

    draft = draft_of(options, options.problem, options.log)
    output = None if options.dry_run else options.output
    found = identify_log(draft, output, progress=shows_progress(options))
    written, tables = list(found.written), list(found.tables)
    if options.report is not None and not options.dry_run:
        report = write_report(found.study, options.report, diagnosis=found.findings)
        written.append(report)
    record: dict[str, object] = {
        **study_record(found.study),
        "findings": diagnosis_record(found.findings)["findings"],
    }
    told = _uncertainty(options, found.study.problem, tables, record)
    if written:
        told += "\n\nwritten: " + ", ".join(str(path) for path in written)
    reports = found.study.comparison.reports
    usable = any(report.verdict == "certified" for report in reports)
    return Answer(0 if usable else 1, told, record)


def _uncertainty(
    options: argparse.Namespace, problem: Any, tables: list[Any], record: dict[str, Any]
) -> str:
    """Return the tables' text, with how sure the parameters are if it is asked for."""
    from consistent_id.cli.commands import uncertainty_of

    if options.uncertainty:
        found, table = uncertainty_of(
            problem, seed=options.seed, progress=shows_progress(options)
        )
        tables.append(table)
        record["uncertainty"] = found.to_dict()
    return "\n\n".join(table.text() for table in tables)


def _refuse_drafting(options: argparse.Namespace) -> None:
    """Refuse options that would go unused, as the problem file says these things."""
    names = ("time", "position", "velocity", "torque", "torque_joints", "torque_gain")
    given = [name for name in (*names, "base", "tip") if getattr(options, name)]
    if options.masses != "model":
        given.append("masses")
    if given:
        flag = "--" + given[0].replace("_", "-")
        raise ProblemError(
            f"{flag} is for a robot and a log without a problem file; "
            f"{options.problem} says such things itself"
        )

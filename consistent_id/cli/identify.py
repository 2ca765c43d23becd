"""``consistent-id identify``: a problem, or a robot and a log without one."""

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from consistent_id.cli.answers import (
    Answer,
    answered,
    show,
    shows_progress,
    tables_answer,
)
from consistent_id.cli.base_options import given_base_options
from consistent_id.cli.log_options import DRAFT, draft_of
from consistent_id.cli.option import Option
from consistent_id.cli.options import (
    ACCEPT,
    FITS_EXECUTOR,
    OUTPUT,
    PROBLEM,
    SEED_OF_BOOTSTRAP,
    TIME_LIMIT,
    add_command,
)
from consistent_id.errors import ProblemError

if TYPE_CHECKING:
    from consistent_id._support.tables import Table
    from consistent_id.problems.study import Study

_MORE = """With a URDF or MJCF file in place of PROBLEM, and logs, no problem file is
needed: columns and units are found by their names, --validate names logs to judge by
(else the last 30 % of each motion are kept for that), and --output FOLDER also gets
this problem.toml (see init). When it has been judged, the recommended estimate is
fitted again, to all data: this is what is delivered (delivered.json).
Exit code 1: do not use the estimate."""
_EXAMPLES = """
consistent-id identify robot.urdf log.csv
consistent-id identify robot.urdf log.csv --output results/robot --report robot.html
consistent-id identify robot.urdf a.csv b.csv --validate c.csv --units deg ms
consistent-id identify problems/rx60
consistent-id identify problems/ur10e --uncertainty --output results/ur10e
"""


def add_identify(commands: Any) -> None:
    """Add the command to a parser's commands."""
    add_command(
        commands,
        "identify",
        "estimate parameters by every method",
        run_identify,
        PROBLEM,
        Option(
            "log [...]", "logs to learn from, if PROBLEM is a URDF or MJCF file", Path
        ),
        *OUTPUT,
        Option("--report FILE", "write a report (HTML)"),
        Option(
            "--uncertainty",
            "also print the uncertainty of each parameter of the constrained estimate",
        ),
        SEED_OF_BOOTSTRAP,
        Option(
            "--streamed",
            "read recordings piece by piece, however large they are, and estimate by "
            "the weighted constrained method alone",
        ),
        ACCEPT,
        FITS_EXECUTOR,
        TIME_LIMIT,
        *DRAFT,
        more=_MORE,
        examples=_EXAMPLES,
    )


def run_identify(options: argparse.Namespace) -> int:
    """Identify; return the exit code."""
    if options.streamed:
        return show(options, _identify_streamed(options))
    if options.log:
        return show(options, _identify_log(options))
    return answered(options, _identify)


def _identify(options: argparse.Namespace) -> Answer:
    from consistent_id.problems.loading import load_problem
    from consistent_id.problems.study import run_study
    from consistent_id.report.summary import excitation_table, headline_tables

    _refuse_drafting(options)
    _require_writable(options)
    study = run_study(
        load_problem(options.problem),
        seed=options.seed,
        progress=shows_progress(options),
        accepted=options.accept,
        costs=False,
    )
    tables = [
        *headline_tables(study),
        *study.problem.drives.tables(),
        excitation_table(study.excitation, study.training),
        *(report.judged.table() for report in study.comparison.reports),
    ]
    reports = study.comparison.reports
    record: dict[str, Any] = {
        **study.verdict.to_dict(),
        "estimates": [report.judged.to_dict() for report in reports],
        "delivered": study.delivered.to_dict(),
    }

    def write() -> list[Path]:
        from consistent_id.cli.results import write_estimates

        output = options.output
        return [] if output is None else write_estimates(study, output)

    return _answer(options, study, tables, record, write)


def _identify_streamed(options: argparse.Namespace) -> Answer:
    from consistent_id._support.files import require_writable
    from consistent_id._support.tables import Table
    from consistent_id.problems.loading import load_problem
    from consistent_id.problems.streaming.stream_estimate import stream_estimate

    if options.log or options.report is not None or options.uncertainty:
        raise ProblemError(
            "--streamed is for a problem file, without --report and --uncertainty, "
            "which take recordings as a whole; cut a part of the log for them"
        )
    _refuse_drafting(options)
    if options.output is not None and not options.dry_run:
        require_writable(options.output)
    problem = load_problem(options.problem)
    estimate = stream_estimate(
        problem,
        executor=options.executor or "serial",
        progress=shows_progress(options),
    )
    verdict = estimate.verdict
    head = Table(f"{problem.name}: {verdict.word}", (), (), verdict.brief)
    record = {**verdict.to_dict(), "estimates": [estimate.to_dict()]}

    def write() -> list[Path]:
        folder = options.output
        return [] if folder is None else [estimate.save(folder / "delivered.json")]

    tables = (head, estimate.table())
    return tables_answer(tables, record, usable=verdict.usable, write=write)


def _identify_log(options: argparse.Namespace) -> Answer:
    from consistent_id.diagnosis.findings import diagnosis_record, diagnosis_table
    from consistent_id.problems.draft_text import draft_table
    from consistent_id.problems.study import run_study
    from consistent_id.report.study_record import study_record
    from consistent_id.report.summary import headline_tables, study_tables

    _require_writable(options)
    draft = draft_of(options, options.problem, options.log)
    study = run_study(
        draft.problem(),
        seed=options.seed,
        progress=shows_progress(options),
        accepted=options.accept,
        costs=False,
    )
    tables = [*headline_tables(study), draft_table(draft)]
    record = study_record(study) if options.json else {}
    if draft.selection is not None:
        tables.append(draft.selection.table())
        record |= {"selection": draft.selection.to_dict()}
    if study.diagnosis is not None:
        tables.append(diagnosis_table(study.diagnosis))
        record |= {"findings": diagnosis_record(study.diagnosis)["findings"]}
    tables.append(study.delivered.table())

    def write() -> list[Path]:
        from consistent_id._support.files import write_atomically
        from consistent_id.cli.results import write_comparison, write_estimates

        output = options.output
        if output is None:
            return []
        text = draft.text(output, accepted=options.accept)
        return [
            write_atomically(output / "problem.toml", text),
            *write_estimates(study, output),
            *write_comparison(study, study_tables(study), output),
        ]

    return _answer(options, study, tables, record, write)


def _require_writable(options: argparse.Namespace) -> None:
    from consistent_id._support.files import require_writable, require_writable_file

    if not options.dry_run:
        if options.output is not None:
            require_writable(options.output)
        if options.report is not None:
            require_writable_file(options.report)


def _answer(
    options: argparse.Namespace,
    study: "Study",
    tables: list["Table"],
    record: dict[str, Any],
    write: Callable[[], list[Path]],
) -> Answer:
    """Add the uncertainty and write the report, if they are asked for."""
    uncertainty = study.uncertainty if options.uncertainty else None
    if uncertainty is not None:
        from consistent_id.report.uncertainty_table import uncertainty_table

        tables = [*tables, uncertainty_table(uncertainty)]
        record = {**record, "uncertainty": uncertainty.to_dict()}

    def write_all() -> list[Path]:
        from consistent_id.laboratory.rollout.study_section import rollout_section
        from consistent_id.report import write_report

        paths = write()
        if options.report is not None:
            report = write_report(
                study,
                options.report,
                uncertainty=uncertainty,
                further=rollout_section(study),
                seed=options.seed,
            )
            paths.append(report)
        return paths

    usable = study.verdict.usable
    return tables_answer(tables, record, usable=usable, write=write_all)


def _refuse_drafting(options: argparse.Namespace) -> None:
    """Refuse options that would go unused, as the problem file states these things."""
    columns = ("time", "position", "velocity", "torque", "torque_joints", "units")
    source = ("torque_gain", "gains", "position_command")
    names = (*columns, *source, "base", "tip", "lock", "validate")
    chosen = ("masses", "drive", "cutoff", "band", "no_select")
    given = [name for name in (*names, *chosen) if getattr(options, name)]
    given += given_base_options(options)
    given += ["bodies"] if options.bodies != "identified" else []
    if given:
        flag = "--" + given[0].replace("_", "-")
        raise ProblemError(
            f"{flag} is for a robot and a log without a problem file; "
            f"{options.problem} states it itself"
        )

"""``consistent-id check``: what is wrong with a problem's recordings, or with a log."""

import argparse
from dataclasses import replace

from consistent_id.cli.answers import Answer, shows_progress
from consistent_id.cli.options import ACCEPT, TIME_LIMIT, add_command
from consistent_id.cli.source import SOURCE, STATED, each, opened, stored

_MORE = """Clocks, units, signs, exchanged channels, joint zero offsets, delays,
saturation, data leakage between training and validation.
With a URDF or MJCF file in place of PROBLEM, and logs, no problem file is needed:
columns, units and the model are found as identify finds them.
Exit code 1: something is wrong."""
_EXAMPLES = """
consistent-id check problems/ur10e
consistent-id check robot.urdf log.csv
consistent-id check robot.urdf log.csv --position q_{joint} --torque tau_{joint}
"""


def add_check(command: argparse.ArgumentParser) -> None:
    """Give the command its options."""
    add_command(
        command,
        run_check,
        *SOURCE,
        ACCEPT,
        TIME_LIMIT,
        *STATED,
        more=_MORE,
        examples=_EXAMPLES,
    )


def run_check(options: argparse.Namespace) -> int:
    """Look at recordings; return the exit code."""
    return each(options, _check)


def _check(options: argparse.Namespace) -> Answer:
    from consistent_id._support.progress import stages
    from consistent_id.diagnosis.findings import diagnosis_record, diagnosis_table
    from consistent_id.estimation.verdict import BAD_RESULT, HELP
    from consistent_id.problems.log_check import check_problem

    results = stored(options)
    if results is not None and results.index.findings:  # else it has no recordings
        tables, record = results.tables("check"), results.index.findings
    else:
        source = opened(options)
        with stages(1, shows_progress(options)) as begin:
            begin("faults of the recordings")
            found = check_problem(source.problem)
        tables = source.noted([diagnosis_table(found), *source.tables()])
        record = diagnosis_record(found)
    faults = [
        fault
        for fault in record.get("findings", ())
        if fault["severity"] == "fault" and fault["kind"] not in options.accept
    ]
    if faults:
        page = f"{BAD_RESULT} {HELP}"
        tables[:1] = [replace(tables[0], notes=(*tables[0].notes, page))]
    text = "\n\n".join(table.text() for table in tables)
    return Answer(int(bool(faults)), text, record | {"accepted": options.accept})

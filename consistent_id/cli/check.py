"""``consistent-id check``: what is wrong with a problem's recordings, or with a log."""

import argparse
from dataclasses import replace
from pathlib import Path
from typing import Any

from consistent_id.cli.answers import Answer, answered, show, shows_progress
from consistent_id.cli.log_options import COLUMNS, GAINS, TORQUE_GAIN, known_of
from consistent_id.cli.option import Option, positive
from consistent_id.cli.options import ACCEPT, PROBLEM, TIME_LIMIT, add_command

_MORE = """Clocks, units, signs, exchanged channels, joint zero offsets, delays,
saturation, data leakage between training and validation.
With a URDF or MJCF file in place of PROBLEM, and a log, no problem file is needed:
columns and units are found by their names, as identify finds them.
Exit code 1: something is wrong."""
_EXAMPLES = """
consistent-id check problems/ur10e
consistent-id check robot.urdf log.csv
consistent-id check robot.urdf log.csv --position q_{joint} --torque tau_{joint}
"""


def add_check(commands: Any) -> None:
    """Add the command to a parser's commands."""
    add_command(
        commands,
        "check",
        "look for what is wrong with a log",
        run_check,
        PROBLEM,
        ACCEPT,
        TIME_LIMIT,
        Option("[log]", "a log, if PROBLEM is a URDF or MJCF file", Path),
        *COLUMNS,
        TORQUE_GAIN,
        *GAINS,
        Option("--cutoff HZ", "low-pass", positive, default=10.0),
        more=_MORE,
        examples=_EXAMPLES,
    )


def run_check(options: argparse.Namespace) -> int:
    """Look at recordings; return the exit code."""
    if options.log is not None:
        return show(options, _check(options))
    return answered(options, _check)


def _check(options: argparse.Namespace) -> Answer:
    from consistent_id._support.progress import stages
    from consistent_id.cli.checks import check_log
    from consistent_id.diagnosis.findings import diagnosis_record, diagnosis_table
    from consistent_id.estimation.verdict import BAD_RESULT, HELP
    from consistent_id.problems.loading import load_problem
    from consistent_id.problems.log_check import check_problem
    from consistent_id.problems.robot_logs import robot_logs

    notes: tuple[str, ...] = ()
    with stages(1, shows_progress(options)) as begin:
        begin("faults of the recordings")
        if options.log is None:
            found = check_problem(load_problem(options.problem))
        else:
            logs = robot_logs(options.problem, options.log, **known_of(options))
            found = check_log(logs, options.log, cutoff=options.cutoff)
            notes = logs.notes
    faults = [fault for fault in found.faults if fault.kind not in options.accept]
    table = diagnosis_table(found)
    text = replace(table, notes=(*table.notes, *notes)).text()
    if faults:
        text += f"\n{BAD_RESULT} {HELP}"
    record = diagnosis_record(found) | {"accepted": options.accept}
    return Answer(1 if faults else 0, text, record)

"""``consistent-id gains``: gains between currents and torque, by a known mass."""

import argparse
from dataclasses import replace
from pathlib import Path

from consistent_id.cli.answers import show, tables_answer
from consistent_id.cli.options import (
    ACCEPT,
    OUTPUT,
    TIME_LIMIT,
    Option,
    add_command,
    positive,
)
from consistent_id.cli.payload import (
    ROBOT_AND_LOAD,
    percentage,
    robot_without_load,
)
from consistent_id.cli.source import STATED

_RECORD = "gains.json"
_LOADED = "--loaded LOG ..."
_MORE = """PROBLEM is the robot without a load: a URDF or MJCF file followed by logs, a
problem file, or a folder of results whose logs are still there. --loaded names logs
with a load that was weighed. Gains between currents and torque are identified from
both, with 95 % intervals, and compared with those that are stated; the last line is for
the problem file, or for --torque-gain. Without a load, the gains are those with which
the bodies of the robot's file are right. Exit code 1: no gain is identifiable."""
_EXAMPLES = """
consistent-id gains robot.urdf empty.csv --loaded carrying.csv --known-mass 2.8
consistent-id gains robot.urdf empty.csv --torque-gain 1
consistent-id gains problems/ur10e --loaded carrying.csv --known-mass 2.805
"""


def add_gains(command: argparse.ArgumentParser) -> None:
    """Give the command its options."""
    add_command(
        command,
        run_gains,
        *(
            replace(option, required=False) if option.usage == _LOADED else option
            for option in ROBOT_AND_LOAD
        ),
        Option("--known-mass KG", "mass of the load, from a scale", positive),
        Option(
            "--accuracy PERCENT",
            "standard error up to which a gain counts as identified (default: 5)",
            percentage,
        ),
        *OUTPUT,
        ACCEPT,
        TIME_LIMIT,
        *STATED,
        more=_MORE,
        examples=_EXAMPLES,
    )


def run_gains(options: argparse.Namespace) -> int:
    """Identify gains; return the exit code."""
    from consistent_id._support.files import require_writable, write_json
    from consistent_id.service.gain_check import check_gains

    folder = options.output
    if folder is not None and not options.dry_run:
        require_writable(folder, [_RECORD])
    found = check_gains(
        robot_without_load(options),
        options.loaded or None,
        known_mass=options.known_mass,
        rows=options.loaded_rows,
        omit=options.loaded_omit or (),
        link=options.link,
        accuracy=options.accuracy or 0.05,
        accepted=options.accept,
    )
    record = found.to_dict()

    def write() -> list[Path]:
        return [] if folder is None else [write_json(folder / _RECORD, record)]

    usable = found.verdict.usable
    return show(
        options, tables_answer([found.table()], record, usable=usable, write=write)
    )

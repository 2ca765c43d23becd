"""``consistent-id gains``: gains between currents and torque.

They are found by a load of known mass, or by the bodies of the robot's file.
"""

import argparse
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

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
    LOADED,
    ROBOT_AND_LOAD,
    percentage,
    robot_without_load,
)
from consistent_id.cli.source import STATED, statement
from consistent_id.errors import ProblemError

if TYPE_CHECKING:
    from consistent_id.problems.nominal_gains import NominalGains
    from consistent_id.service.gain_check import GainCheck

_RECORD = "gains.json"
_MORE = """PROBLEM is the robot without a load: a URDF or MJCF file followed by logs, a
problem file, or a folder of results whose logs are still there. --loaded names logs
with a load that was weighed. Gains between currents and torque are identified from
both, with 95 % intervals, and compared with those that are stated; the last line is for
the problem file, or for --torque-gain. Exit code 1: no gain is identifiable.
Without --loaded, the gains are those that the bodies of the robot's file imply, if
its masses are right to 5 %, centres of mass to 15 % and second moments to 30 %: an
assumption that no log can confirm."""
_EXAMPLES = """
consistent-id gains robot.urdf empty.csv --loaded carrying.csv --known-mass 2.8
consistent-id gains robot.urdf log.csv
consistent-id gains problems/ur10e --loaded carrying.csv --known-mass 2.805
"""


def add_gains(command: argparse.ArgumentParser) -> None:
    """Give the command its options."""
    add_command(
        command,
        run_gains,
        *(replace(o, required=False) if o is LOADED else o for o in ROBOT_AND_LOAD),
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
    from consistent_id.service.gain_check import GainCheck

    folder = options.output
    if folder is not None and not options.dry_run:
        require_writable(folder, [_RECORD])
    by_load = bool(options.loaded) or options.known_mass is not None
    found = _by_load(options) if by_load else _by_model(options)
    record = found.to_dict()

    def write() -> list[Path]:
        return [] if folder is None else [write_json(folder / _RECORD, record)]

    usable = found.verdict.usable if isinstance(found, GainCheck) else True
    return show(
        options, tables_answer([found.table()], record, usable=usable, write=write)
    )


def _by_load(options: argparse.Namespace) -> "GainCheck":
    from consistent_id.service.gain_check import check_gains

    if not options.loaded or options.known_mass is None:
        raise ProblemError(
            "a load needs both its logs and its mass: --loaded LOG --known-mass KG; "
            "without both, the gains are those that the model's bodies imply"
        )
    return check_gains(
        robot_without_load(options),
        options.loaded,
        known_mass=options.known_mass,
        rows=options.loaded_rows,
        omit=options.loaded_omit or (),
        link=options.link,
        accuracy=options.accuracy or 0.05,
        accepted=options.accept,
    )


def _by_model(options: argparse.Namespace) -> "NominalGains":
    from consistent_id.problems.robot_logs import model_gains
    from consistent_id.service.gain_check import problem_gains

    if options.log:
        return model_gains(options.problem, options.log, statement(options))
    return problem_gains(robot_without_load(options))

"""``consistent-id payload`` and ``consistent-id gains``: a robot and a load.

The first weighs a load and writes it for the robot's controller.  The second finds the
gains between currents and torque, by a load of known mass or by the bodies of the
robot's file.
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
from consistent_id.cli.source import PROBLEM, STATED, opened, statement
from consistent_id.errors import ProblemError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from consistent_id.problems.nominal_gains import NominalGains
    from consistent_id.problems.problem import Problem
    from consistent_id.service.controller_formats import ControllerFormat
    from consistent_id.service.gain_check import GainCheck

_GAINS_RECORD = "gains.json"
_GAINS = """PROBLEM is the robot without a load: a URDF or MJCF file followed by logs, a
problem file, or a folder of results whose logs are still there. --loaded names logs
with a load that was weighed. Gains between currents and torque are identified from
both, with 95 % intervals, and compared with those that are stated; the last line is for
the problem file, or for --torque-gain. Exit code 1: no gain is identifiable.
Without --loaded, the gains are those that the bodies of the robot's file imply, if
its masses are right to 5 %, centres of mass to 15 % and second moments to 30 %: an
assumption that no log can confirm."""
_GAINS_EXAMPLES = """
consistent-id gains robot.urdf empty.csv --loaded carrying.csv --known-mass 2.8
consistent-id gains robot.urdf log.csv
consistent-id gains problems/ur10e --loaded carrying.csv --known-mass 2.805
"""


def numbers(text: str) -> tuple[float, ...]:
    """Read numbers that commas separate."""
    return tuple(float(word) for word in text.split(","))


def _numbers_from_1(text: str) -> tuple[int, ...]:
    rows = tuple(int(word) for word in text.split(","))
    if min(rows) < 1:
        raise ValueError
    return rows


def _rows(text: str) -> tuple[int, ...]:
    rows = _numbers_from_1(text)
    if len(rows) != 2:
        raise ValueError
    return rows


def percentage(text: str) -> float:
    """Read a positive share in percent."""
    return 0.01 * positive(text)


LOADED = Option("--loaded LOG ...", "logs with the load", Path, required=True)
ROBOT_AND_LOAD = (
    PROBLEM,
    Option("log [...]", "logs without the load, if PROBLEM is a URDF or MJCF", Path),
    LOADED,
    Option(
        "--loaded-rows FIRST,LAST",
        "rows of these logs to use, from 1 (default: all)",
        _rows,
    ),
    Option(
        "--loaded-omit ROW,ROW",
        "broken rows of these logs, from 1",
        _numbers_from_1,
    ),
    Option(
        "--link LINK",
        "link or fixed frame that carries the load, in whose frame controllers get "
        "it, such as tool0 (default: the last link)",
    ),
)
"""Arguments and options of commands on a robot and its load."""


def robot_without_load(options: argparse.Namespace) -> "Problem":
    """Return the robot without the load; from its results if these are named."""
    from consistent_id.problems.loading import is_results
    from consistent_id.report.results import open_results

    stated = statement(options).given
    if not options.log and not stated and is_results(options.problem):
        return open_results(options.problem).problem
    return opened(options).problem


_RECORD = "payload.json"
_MORE = """PROBLEM is the robot without the load: a URDF or MJCF file followed by
logs, a problem file, or a folder of results whose logs are still there. --loaded names
logs with the load; they are read like the others. Printed are mass, centre of mass and
inertia about it, physically consistent, with 95 % intervals that contain correlated
noise and the stated errors of gains. --output gets the load in the forms of
controllers. If the data do not determine the inertia, as static poses do not, the load
is written as a point mass. Exit code 1: do not use the load; nothing was written."""
_EXAMPLES = """
consistent-id payload robot.urdf empty.csv --loaded carrying.csv --link tool0
consistent-id payload results/robot --loaded carrying.csv --output results/load
consistent-id payload problems/ur10e --loaded carrying.csv --known-mass 2.805
consistent-id payload problem.toml --loaded a.csv b.csv --tool 0,0,0.12 --controller ur
"""


def _frame(text: str) -> str | tuple[float, ...]:
    """Return the name of a frame, or its place."""
    try:
        return numbers(text)
    except ValueError:
        return text


def add_payload(command: argparse.ArgumentParser) -> None:
    """Give the command its options."""
    from consistent_id.service.controller_formats import CONTROLLER_FORMATS

    add_command(
        command,
        run_payload,
        *ROBOT_AND_LOAD,
        Option(
            "--tool FRAME",
            "frame of the tool: a fixed frame of the file, or x,y,z or "
            "x,y,z,roll,pitch,yaw (m, rad) in the frame of --link (default: that one)",
            _frame,
        ),
        Option("--name NAME", "name of the load in files", default="payload"),
        Option(
            "--known-mass KG",
            "if the load was weighed: gains that convert currents to torque are "
            "tested, and corrected if they are wrong",
            positive,
        ),
        Option(
            "--gain-errors PERCENT ...",
            "standard errors of these gains: one for all joints, or one each (default: "
            "they are exact)",
            percentage,
        ),
        Option(
            "--controller NAME ...",
            "forms that --output gets (default: all)",
            choices=[known.name for known in CONTROLLER_FORMATS],
        ),
        *OUTPUT,
        ACCEPT,
        TIME_LIMIT,
        *STATED,
        more=_MORE,
        examples=_EXAMPLES,
    )


def run_payload(options: argparse.Namespace) -> int:
    """Weigh a load; return the exit code."""
    from consistent_id._support.files import write_atomically, write_json
    from consistent_id._support.tables import Table
    from consistent_id.service.controller_formats import (
        CONTROLLER_FORMATS,
        controller_text,
    )
    from consistent_id.service.weighing import weigh_load

    forms = _forms(options)
    errors = list(options.gain_errors)
    found = weigh_load(
        robot_without_load(options),
        options.loaded,
        rows=options.loaded_rows,
        omit=options.loaded_omit or (),
        link=options.link,
        tool=options.tool,
        name=options.name,
        known_mass=options.known_mass,
        gain_errors=errors if len(errors) > 1 else sum(errors),
        accepted=options.accept,
    )
    record, usable = found.to_dict(), found.sendable

    def write() -> list[Path]:
        folder = options.output
        if folder is None or not usable:
            return []
        load = found.for_controller
        texts = {form.file: controller_text(load, form.name) for form in forms}
        return [
            *(write_atomically(folder / file, text) for file, text in texts.items()),
            write_json(folder / _RECORD, record),
        ]

    tables = found.tables()
    kept = [form for form in CONTROLLER_FORMATS if not usable or form not in forms]
    old = [] if options.output is None else _present(options.output, kept)
    record["files_of_earlier_runs"] = old
    if old:
        note = f"{options.output} has {', '.join(old)} of an earlier run: delete them"
        tables.insert(1, Table("Not of this load", (), (), (note,)))
    return show(options, tables_answer(tables, record, usable=usable, write=write))


def _forms(options: argparse.Namespace) -> "list[ControllerFormat]":
    """Return the controllers' formats to write; refuse what none of them can have."""
    from consistent_id._support.files import require_writable
    from consistent_id.service.controller_formats import (
        CONTROLLER_FORMATS,
        require_load_name,
    )

    chosen = options.controller or [known.name for known in CONTROLLER_FORMATS]
    forms = [known for known in CONTROLLER_FORMATS if known.name in chosen]
    require_load_name(options.name)
    if options.output is None:
        return forms
    for form in forms:
        form.require_name(options.name)
    if not options.dry_run:
        require_writable(options.output, [_RECORD, *(form.file for form in forms)])
    return forms


def _present(folder: Path, forms: "Sequence[ControllerFormat]") -> list[str]:
    """Return the names of forms' files that are in a folder already."""
    return [form.file for form in forms if (folder / form.file).exists()]


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
        more=_GAINS,
        examples=_GAINS_EXAMPLES,
    )


def run_gains(options: argparse.Namespace) -> int:
    """Identify gains; return the exit code."""
    from consistent_id._support.files import require_writable, write_json
    from consistent_id.service.gain_check import GainCheck

    folder = options.output
    if folder is not None and not options.dry_run:
        require_writable(folder, [_GAINS_RECORD])
    by_load = bool(options.loaded) or options.known_mass is not None
    found = _by_load(options) if by_load else _by_model(options)
    record = found.to_dict()

    def write() -> list[Path]:
        return [] if folder is None else [write_json(folder / _GAINS_RECORD, record)]

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

"""The shell tool: ``consistent-id info | check | excite | identify | compare``.

Exit codes: 0 done, 1 refused (no usable estimate, or a faulty log), 2 wrong usage or
input, 3 solver failure, 130 interrupted.
"""

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from consistent_id.errors import ConsistentIdError, SolverError

if TYPE_CHECKING:
    from consistent_id.tables import Table

_EPILOG = """examples:
  consistent-id info problems/rx60
  consistent-id check problems/ur10e
  consistent-id check robot.urdf log.csv --position q_{joint} --torque tau_{joint}
  consistent-id excite problems/rx60 --time-limit 3 --output results/motion
  consistent-id identify problems/ur10e --uncertainty --output results/ur10e
  consistent-id compare problems/rx60
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the tool; return its exit code."""
    options = _parser().parse_args(arguments)
    try:
        return int(_COMMANDS[options.command](options))
    except SolverError as error:
        print(f"consistent-id: {error}", file=sys.stderr)
        return 3
    except ConsistentIdError as error:
        print(f"consistent-id: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("consistent-id: interrupted", file=sys.stderr)
        return 130
    except BrokenPipeError:
        sys.stderr.close()  # the reader, such as `head`, has gone
        return 0


def _parser() -> argparse.ArgumentParser:
    from consistent_id import __version__

    parser = argparse.ArgumentParser(
        prog="consistent-id",
        description="Identify the dynamic parameters of robots, as a real body could "
        "have them.",
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=__version__)
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for name, text in (
        ("info", "show a problem's robot, datasheet and base parameters"),
        ("check", "look for what is wrong with a log"),
        ("excite", "design an exciting trajectory within the robot's limits"),
        ("identify", "estimate a problem's parameters by every method"),
        ("compare", "compare least squares with constrained estimates"),
    ):
        command = commands.add_parser(name, help=text, description=text)
        command.add_argument(
            "problem", type=Path, help="folder with a problem.toml, or the file"
        )
        if name == "check":
            _add_log_options(command)
        command.add_argument(
            "--json", action="store_true", help="print JSON instead of tables"
        )
        if name == "identify":
            command.add_argument(
                "--uncertainty",
                action="store_true",
                help="also say how sure the constrained estimate is of each parameter",
            )
            command.add_argument(
                "--seed", type=int, default=0, help="of the bootstrap (default: 0)"
            )
        if name == "excite":
            _add_design_options(command)
        if name in ("excite", "identify", "compare"):
            default = "" if name == "identify" else " (default: results/NAME)"
            command.add_argument(
                "--output", type=Path, help=f"folder to write results to{default}"
            )
    return parser


def _add_log_options(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "log", type=Path, nargs="?", help="a log, if PROBLEM is a URDF or MJCF file"
    )
    for channel, pattern in (
        ("time", "time"),
        ("position", "q_{joint}"),
        ("velocity", None),
        ("torque", "tau_{joint}"),
    ):
        command.add_argument(
            f"--{channel}",
            default=pattern,
            metavar="NAME",
            help=f"column, with {{joint}} or {{number}} (default: {pattern})",
        )
    command.add_argument(
        "--cutoff", type=float, default=10.0, help="low-pass in Hz (default: 10)"
    )


def _add_design_options(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "--seed", type=int, default=0, help="of the random starts (default: 0)"
    )
    command.add_argument(
        "--starts", type=int, default=4, help="searches from random paths (default: 4)"
    )
    command.add_argument(
        "--time-limit", type=float, default=10.0, help="in seconds (default: 10)"
    )
    command.add_argument(
        "--workers", type=int, help="processes (default: one per processor)"
    )
    command.add_argument(
        "--sequential",
        action="store_true",
        help="count what the problem's training recordings tell already",
    )
    command.add_argument(
        "--dry-run",
        action="store_true",
        help="only show what would be designed, within which limits",
    )
    command.add_argument(
        "--format",
        default="csv,yaml",
        metavar="ENDINGS",
        help="files of samples: csv, yaml (ROS), parquet, npz, script (Universal "
        "Robots), by commas (default: csv,yaml)",
    )
    command.add_argument(
        "--replay",
        action="store_true",
        help="also write replay.html, the motion in 3-D; needs consistent-id[viz]",
    )


def _check(options: argparse.Namespace) -> int:
    from consistent_id.commands import check_log, check_problem
    from consistent_id.diagnosis.tell import diagnosis_record
    from consistent_id.problem import load_problem
    from consistent_id.readers import Columns

    if options.log is None:
        found, table = check_problem(load_problem(options.problem))
    else:
        columns = Columns(
            options.time, options.position, options.velocity, torque=options.torque
        )
        found, table = check_log(
            options.problem, options.log, columns, cutoff=options.cutoff
        )
    if options.json:
        print(json.dumps(diagnosis_record(found), indent=1))
    else:
        print(table.text())
    return 1 if found.faults else 0


def _info(options: argparse.Namespace) -> int:
    from consistent_id.commands import info
    from consistent_id.problem import load_problem

    _tell(options, info(load_problem(options.problem)))
    return 0


def _excite(options: argparse.Namespace) -> int:
    from consistent_id import excite as tool
    from consistent_id.excitation.replay import require_viewer
    from consistent_id.problem import load_problem

    problem = load_problem(options.problem)
    folder = options.output or Path("results") / problem.name
    if options.replay:
        require_viewer(folder / tool.REPLAY)
    if options.dry_run:
        _tell(options, tool.planned_tables(problem))
        return 0
    formats = tool.checked_formats(options.format)
    excited = tool.excite(
        problem,
        starts=options.starts,
        time_limit=options.time_limit,
        seed=options.seed,
        workers=options.workers,
        sequential=options.sequential,
        progress=sys.stderr.isatty(),
    )
    written = tool.write_excited(excited, folder, formats)
    if options.replay:
        written.append(tool.replay_excited(problem, excited, folder))
    if options.json:
        print(json.dumps(tool.excited_record(excited), indent=1, allow_nan=False))
    else:
        _tell(options, tool.excited_tables(excited))
        print("\nwritten: " + ", ".join(str(path) for path in written))
    return 0


def _tell(options: argparse.Namespace, tables: Sequence["Table"]) -> None:
    if options.json:
        print(json.dumps([_as_dict(table) for table in tables], indent=1))
    else:
        print("\n\n".join(table.text() for table in tables))


def _identify(options: argparse.Namespace) -> int:
    from consistent_id.commands import identify_problem, uncertainty_of
    from consistent_id.problem import load_problem

    problem = load_problem(options.problem)
    estimates, tables = identify_problem(problem, options.output)
    record: dict[str, object] = {"estimates": [e.to_dict() for e in estimates]}
    if options.uncertainty:
        found, table = uncertainty_of(
            problem, seed=options.seed, progress=sys.stderr.isatty()
        )
        tables.append(table)
        record["uncertainty"] = found.to_dict()
    if options.json:
        print(json.dumps(record, indent=1))
    else:
        print("\n\n".join(table.text() for table in tables))
    certified = any(e.certificate.verdict == "certified" for e in estimates)
    return 0 if certified else 1


def _compare(options: argparse.Namespace) -> int:
    from consistent_id.commands import compare_problem
    from consistent_id.problem import load_problem
    from consistent_id.record import study_record

    problem = load_problem(options.problem)
    output = options.output or Path("results") / problem.name
    study, tables, written = compare_problem(problem, output)
    if options.json:
        print(json.dumps(study_record(study), indent=1, allow_nan=False))
    else:
        print("\n\n".join(table.text() for table in tables))
        print("\nwritten: " + ", ".join(str(path) for path in written))
    usable = any(report.verdict == "certified" for report in study.comparison.reports)
    return 0 if usable else 1


def _as_dict(table: object) -> dict[str, object]:
    from dataclasses import asdict

    return asdict(table)  # type: ignore[call-overload, no-any-return]


_COMMANDS = {
    "info": _info,
    "check": _check,
    "excite": _excite,
    "identify": _identify,
    "compare": _compare,
}

"""The shell tool: ``consistent-id COMMAND``; its help lists the commands.

Exit codes: 0 done, 1 refused (no usable estimate, or a faulty log), 2 wrong usage or
input, 3 solver failure, 130 interrupted.
"""

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from consistent_id.cli_export import add_export, run_export
from consistent_id.cli_repair import add_repair, run_repair
from consistent_id.cli_report import add_report, run_report
from consistent_id.errors import ConsistentIdError, SolverError

_EPILOG = """examples:
  consistent-id info problems
  consistent-id info problems/rx60
  consistent-id check problems/ur10e
  consistent-id check robot.urdf log.csv --position q_{joint} --torque tau_{joint}
  consistent-id excite problems/rx60 --time-limit 3 --output results/motion
  consistent-id identify problems/ur10e --uncertainty --output results/ur10e
  consistent-id compare problems/rx60
  consistent-id report problems/ur10e --output ur10e.html
  consistent-id export problems/ur10e --format urdf --output ur10e.urdf
  consistent-id repair robot.urdf --dry-run
"""


class Answer(NamedTuple):
    """What a command has to say of one problem."""

    code: int
    text: str
    record: object


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the tool; return its exit code."""
    options = _parser().parse_args(arguments)
    try:
        return _run(options)
    except ConsistentIdError as error:
        return _told(error)
    except KeyboardInterrupt:
        print("consistent-id: interrupted", file=sys.stderr)
        return 130
    except BrokenPipeError:
        sys.stderr.close()  # the reader, such as `head`, has gone
        return 0


def _run(options: argparse.Namespace) -> int:
    from consistent_id.problem_folder import problem_files

    if options.command in _OF_ONE_FILE:
        return _OF_ONE_FILE[options.command](options)
    answer_to = _COMMANDS[options.command]
    if getattr(options, "log", None) is not None:
        return _shown(options, answer_to(options))
    files = problem_files(options.problem)
    if len(files) > 1 and options.command == "info":
        return _shown(options, _listed(options, files))
    if len(files) > 1:
        return _each(options, files)
    return _shown(options, answer_to(_of(options, files[0])))


def _each(options: argparse.Namespace, files: Sequence[Path]) -> int:
    """Work through several problems; one that fails does not stop the others."""
    from consistent_id.problem import require_distinct
    from consistent_id.problem_file import read_problem_table

    answer_to, codes, records, names = _COMMANDS[options.command], [], {}, []
    for file in files:
        try:
            names.append(read_problem_table(file).name)
            require_distinct(names)
            answer = answer_to(_of(options, file, names[-1]))
        except ConsistentIdError as error:
            codes.append(_told(error))
            continue
        codes.append(answer.code)
        records[names[-1]] = answer.record
        if not options.json:
            print(f"=== {names[-1]}\n\n{answer.text}\n", flush=True)
    if options.json:
        print(json.dumps(records, indent=1, allow_nan=False))
    return max(codes)


def _of(
    options: argparse.Namespace, file: Path, name: str | None = None
) -> argparse.Namespace:
    """Return the options for one problem; of several, each has its own folder."""
    chosen = argparse.Namespace(**{**vars(options), "problem": file})
    if name is not None and getattr(options, "output", None) is not None:
        chosen.output = options.output / name
    return chosen


def _shown(options: argparse.Namespace, answer: Answer) -> int:
    if options.json:
        print(json.dumps(answer.record, indent=1, allow_nan=False))
    else:
        print(answer.text)
    return answer.code


def _told(error: ConsistentIdError) -> int:
    print(f"consistent-id: {error}", file=sys.stderr)
    return 3 if isinstance(error, SolverError) else 2


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
            "problem",
            type=Path,
            help="folder with a problem.toml, the file, or a folder of several",
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
    add_report(commands)
    add_export(commands)
    add_repair(commands)
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
        "--torque-joints",
        nargs="+",
        default=(),
        metavar="JOINT",
        help="joints whose torque the log has (default: all)",
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


def _listed(options: argparse.Namespace, files: Sequence[Path]) -> Answer:
    from consistent_id.problem_list import list_problems

    table = list_problems(options.problem, files)
    return Answer(0, table.text(), [_as_dict(table)])


def _check(options: argparse.Namespace) -> Answer:
    from consistent_id.commands import check_log, check_problem
    from consistent_id.diagnosis.tell import diagnosis_record
    from consistent_id.problem import load_problem
    from consistent_id.readers import Columns

    if options.log is None:
        found, table = check_problem(load_problem(options.problem))
    else:
        columns = Columns(
            options.time,
            options.position,
            options.velocity,
            torque=options.torque,
            torque_joints=options.torque_joints,
        )
        found, table = check_log(
            options.problem, options.log, columns, cutoff=options.cutoff
        )
    return Answer(1 if found.faults else 0, table.text(), diagnosis_record(found))


def _info(options: argparse.Namespace) -> Answer:
    from consistent_id.commands import info
    from consistent_id.problem import load_problem

    tables = info(load_problem(options.problem))
    text = "\n\n".join(table.text() for table in tables)
    return Answer(0, text, [_as_dict(table) for table in tables])


def _excite(options: argparse.Namespace) -> Answer:
    from consistent_id.excitation.record import design_record, design_tables
    from consistent_id.excite import excite, write_excited
    from consistent_id.problem import load_problem

    problem = load_problem(options.problem)
    excited = excite(
        problem,
        starts=options.starts,
        time_limit=options.time_limit,
        seed=options.seed,
        workers=options.workers,
        sequential=options.sequential,
        progress=sys.stderr.isatty(),
    )
    folder = options.output or Path("results") / problem.name
    written = write_excited(excited, folder)
    text = "\n\n".join(table.text() for table in design_tables(excited.design))
    text += "\n\nwritten: " + ", ".join(str(path) for path in written)
    return Answer(0, text, design_record(excited.design, excited.validation))


def _identify(options: argparse.Namespace) -> Answer:
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
    certified = any(e.certificate.verdict == "certified" for e in estimates)
    text = "\n\n".join(table.text() for table in tables)
    return Answer(0 if certified else 1, text, record)


def _compare(options: argparse.Namespace) -> Answer:
    from consistent_id.commands import compare_problem
    from consistent_id.problem import load_problem
    from consistent_id.record import study_record

    problem = load_problem(options.problem)
    output = options.output or Path("results") / problem.name
    study, tables, written = compare_problem(problem, output)
    text = "\n\n".join(
        [
            *(table.text() for table in tables),
            "written: " + ", ".join(str(path) for path in written),
        ]
    )
    usable = any(report.verdict == "certified" for report in study.comparison.reports)
    return Answer(0 if usable else 1, text, study_record(study))


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
_OF_ONE_FILE = {"export": run_export, "repair": run_repair, "report": run_report}

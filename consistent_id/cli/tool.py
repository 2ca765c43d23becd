"""The shell tool: ``consistent-id COMMAND``; its help lists the commands.

Exit codes: 0 done, 1 do not use (the estimate, or a faulty log), 2 wrong usage or
input, 3 solver failure or out of time, 70 a bug, 130 interrupted, 143 terminated.
"""

import argparse
from difflib import get_close_matches
from importlib import import_module

from consistent_id.cli.answers import warnings_unless
from consistent_id.cli.endings import run_to_its_end, within

# A command is a file of this folder; it is imported when its options are asked for.
_COMMANDS = {
    "init": "write a commented problem file for a robot, and a log if there is one",
    "info": "show a problem's robot, datasheet and base parameters",
    "check": "look for what is wrong with a log",
    "select": "choose the model that the training data ask for",
    "excite": "design an exciting trajectory within the robot's limits",
    "rehearse": "play a designed motion on simulated robots of planted parameters",
    "identify": "estimate parameters by every method",
    "compare": "compare least squares with constrained estimates",
    "report": "write everything about a problem into one HTML file",
    "export": "write the estimate that identify delivers for other programs",
    "lint": "find what is wrong or odd in a URDF or MJCF file",
    "repair": "make the inertials of a URDF physically consistent, by undoing mistakes",
    "reproduce": "repeat the study of a paper: experiments, tables, verification",
    "rollout": "replay logged commands in MuJoCo",
    "compress": "compress recordings of any size into a regression",
    "fleet": "identify robots of one type together, and name outliers",
    "payload": "weigh what a robot carries, and write it as controllers take it",
    "gains": "identify gains between currents and torque by a load of known mass",
    "servo": "identify hobby servos from position, goal and duty, without torque",
    "demo": "copy the example problems into a folder",
    "completion": "print a script for tab completion",
}
_EPILOG = """examples:
  consistent-id identify robot.urdf log.csv --output results/robot
  consistent-id init robot.urdf log.csv
  consistent-id info problems
  consistent-id check robot.urdf log.csv --position q_{joint} --torque tau_{joint}
  consistent-id select problems/ur10e --dry-run
  consistent-id excite problems/rx60 --time-limit 3 --output results/motion
  consistent-id compare problems/rx60
  consistent-id report problems/ur10e --output ur10e.html
  consistent-id export problems/ur10e --format urdf --output ur10e.urdf
  consistent-id lint robot.urdf
  consistent-id repair robot.urdf --dry-run
  consistent-id reproduce problems/rx60 --quick
  consistent-id rollout problems/unitree_go2 --refine
  consistent-id compress problem.toml --output regression.json
  consistent-id fleet 'logs/*/problem.toml' --output results/fleet
  consistent-id payload robot.urdf empty.csv --loaded carrying.csv --link tool0
  consistent-id gains problems/ur10e --loaded carrying.csv --known-mass 2.805
  consistent-id servo arm.urdf a.csv b.csv --validate c.csv

consistent-id COMMAND --help has more. Exit codes: 0 done, 1 do not use (the
estimate, or a faulty log), 2 wrong usage or input, 3 solver failure or out of time,
70 a bug, 130 interrupted (what is shown then is the best so far), 143 terminated.
"""


def run_tool(options: argparse.Namespace) -> int:
    """Run the command that options of `tool_parser` name; return the exit code."""
    return run_to_its_end(options, _run)


def _run(options: argparse.Namespace) -> int:
    limit = getattr(options, "give_up_after", None)
    with warnings_unless(options.quiet), within(limit):
        return int(options.run(options))


def tool_parser(wanted: str | None = None) -> argparse.ArgumentParser:
    """Return the parser of all commands; with the options of one, or of all."""
    from consistent_id import __version__

    parser = argparse.ArgumentParser(
        prog="consistent-id",
        description="Identify dynamic parameters of robots that are physically "
        "consistent.",
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=__version__)
    if wanted and wanted not in _COMMANDS:
        near = get_close_matches(wanted, _COMMANDS, n=1)
        hint = f"did you mean {near[0]}?" if near else "--help lists the commands"
        parser.error(f"there is no command {wanted!r}; {hint}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for name, text in _COMMANDS.items():
        command = commands.add_parser(
            name,
            help=text,
            description=f"{text[0].upper()}{text[1:]}.",
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        if wanted in (None, name):
            getattr(import_module(f"consistent_id.cli.{name}"), f"add_{name}")(command)
    parser.set_defaults(tool_parser=tool_parser)  # of which completion is made
    return parser

"""The shell tool: ``consistent-id COMMAND``; its help lists the commands.

Exit codes: 0 done, 1 do not use (the estimate, or a faulty log), 2 wrong usage or
input, 3 solver failure or out of time, 70 a bug, 130 interrupted, 143 terminated.
"""

import argparse
import sys
from collections.abc import Sequence
from typing import Any

from consistent_id.cli.answers import warnings_unless
from consistent_id.cli.check import add_check
from consistent_id.cli.compare import add_compare
from consistent_id.cli.completion import add_completion
from consistent_id.cli.compress import add_compress
from consistent_id.cli.endings import run_to_its_end, within
from consistent_id.cli.excite import add_excite
from consistent_id.cli.export import add_export
from consistent_id.cli.fleet import add_fleet
from consistent_id.cli.identify import add_identify
from consistent_id.cli.info import add_info
from consistent_id.cli.init import add_init
from consistent_id.cli.lint import add_lint
from consistent_id.cli.rehearse import add_rehearse
from consistent_id.cli.repair import add_repair
from consistent_id.cli.report import add_report
from consistent_id.cli.reproduce import add_reproduce
from consistent_id.cli.rollout import add_rollout
from consistent_id.cli.select import add_select

_COMMANDS = (
    add_init,
    add_info,
    add_check,
    add_select,
    add_excite,
    add_rehearse,
    add_identify,
    add_compare,
    add_report,
    add_export,
    add_lint,
    add_repair,
    add_reproduce,
    add_rollout,
    add_compress,
    add_fleet,
    add_completion,
)
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

consistent-id COMMAND --help has more. Exit codes: 0 done, 1 do not use (the
estimate, or a faulty log), 2 wrong usage or input, 3 solver failure or out of time,
70 a bug, 130 interrupted (what is shown then is the best so far), 143 terminated.
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the tool; return its exit code."""
    words = sys.argv[1:] if arguments is None else arguments
    wanted = next((word for word in words if not word.startswith("-")), "")
    options = tool_parser(wanted).parse_args(words)
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
    commands: Any = parser.add_subparsers(
        dest="command", required=True, metavar="COMMAND"
    )
    commands.wanted = wanted
    for add in _COMMANDS:
        add(commands)
    parser.set_defaults(tool_parser=tool_parser)  # of which completion is made
    return parser

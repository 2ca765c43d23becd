"""``consistent-id excite PROBLEM``: its options, and what it prints."""

import argparse
from dataclasses import asdict
from pathlib import Path
from typing import Any

from consistent_id.cli.answers import Answer, answered, shows_progress
from consistent_id.cli.options import add_command, add_output, add_problem, positive

_EXAMPLES = """
consistent-id excite problems/rx60 --time-limit 3 --output results/motion
consistent-id excite problems/ur10e --sequential --starts 8 --seed 1
"""


def add_excite(commands: Any) -> None:
    """Add the command to a parser's commands."""
    command = add_command(
        commands,
        "excite",
        "design an exciting trajectory within the robot's limits",
        run_excite,
        examples=_EXAMPLES,
    )
    add_problem(command)
    command.add_argument(
        "--seed", type=int, default=0, help="of the random starts (default: 0)"
    )
    command.add_argument(
        "--starts", type=int, default=4, help="searches from random paths (default: 4)"
    )
    command.add_argument(
        "--time-limit",
        type=positive,
        default=10.0,
        metavar="SECONDS",
        help="of the search (default: 10)",
    )
    command.add_argument(
        "--workers", type=int, help="processes (default: one per processor)"
    )
    command.add_argument(
        "--sequential",
        action="store_true",
        help="count the information of the problem's training recordings",
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
    add_output(command, "results/NAME")


def run_excite(options: argparse.Namespace) -> int:
    """Design a trajectory; return the exit code."""
    return answered(options, _excite)


def _excite(options: argparse.Namespace) -> Answer:
    from consistent_id.excitation import output
    from consistent_id.excitation.playable import TRAINING, playable_design
    from consistent_id.excitation.replay import require_viewer
    from consistent_id.problems.problem import load_problem

    problem = load_problem(options.problem)
    folder = options.output or Path("results") / problem.name
    if options.replay:
        require_viewer(folder / output.REPLAY)
    if options.dry_run:
        plan = output.planned_tables(problem)
        text = "\n\n".join(table.text() for table in plan)
        return Answer(0, text, [asdict(table) for table in plan])
    formats = output.checked_formats(options.format)
    output.require_places(folder, formats)
    playable = playable_design(
        problem,
        starts=options.starts,
        time_limit=options.time_limit,
        seed=options.seed,
        workers=options.workers,
        sequential=options.sequential,
        progress=shows_progress(options),
    )
    written = output.write_design(playable, folder, formats)
    if options.replay and TRAINING in playable.moves:
        written.append(output.replay_design(problem, playable, folder))
    text = "\n\n".join(table.text() for table in output.playable_tables(playable))
    text += "\n\nwritten: " + ", ".join(str(path) for path in written)
    record = output.playable_record(playable)
    return Answer(1 if playable.refusals else 0, text, record)

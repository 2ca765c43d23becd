"""``consistent-id excite PROBLEM | ROBOT``: its options, and what it prints."""

import argparse
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from consistent_id.cli.answers import (
    Answer,
    answered,
    show,
    shows_progress,
    tables_answer,
)
from consistent_id.cli.excite_options import (
    MOTION,
    PART,
    SEARCH,
    motion_changes,
    parameters,
)
from consistent_id.cli.excite_standing import STANDING, standing_answer
from consistent_id.cli.option import Option, positive
from consistent_id.cli.options import PROBLEM, RESULTS, add_command

if TYPE_CHECKING:
    from consistent_id.excitation.playable import PlayableDesign
    from consistent_id.problems.problem import Problem

_MORE = """With a URDF or MJCF file in place of PROBLEM no problem file is needed; the
folder of results gets one. What is searched for in so many seconds on an idle machine
is searched for on a busy one too, in more. Exit code 1: something cannot be played."""
_EXAMPLES = """
consistent-id excite robot.urdf --acceleration 5 --duration 20
consistent-id excite problems/rx60 --time-limit 3 --output results/motion
consistent-id excite problems/rx60 --objective D --output results/least-errors
consistent-id excite problems/ur10e --sequential --starts 8 --seed 1
consistent-id excite problems/arm --earlier regression.json
consistent-id excite go2.xml --standing --velocity 4 --effort 23
"""
_FILE = "problem.toml"


def add_excite(commands: Any) -> None:
    """Add the command to a parser's commands."""
    add_command(
        commands,
        "excite",
        "design an exciting trajectory within the robot's limits",
        run_excite,
        PROBLEM,
        *PART,
        MOTION,
        Option("--seed N", "of the random starts", int, default=0),
        *SEARCH,
        Option(
            "--sequential", "count the information of the problem's training recordings"
        ),
        Option(
            "--earlier REGRESSION ...",
            "count the information of recordings that compress wrote, such as "
            "regression.json, too",
            Path,
        ),
        parameters(),
        STANDING,
        Option(
            "--format ENDINGS",
            "files of samples: csv, yaml (ROS), parquet, npz, script (Universal "
            "Robots), rsi (KUKA), franka, by commas",
            default="csv,yaml",
        ),
        Option(
            "--thin TOLERANCE",
            "of yaml: as few points as a controller needs that joins them by quintics, "
            "to stay within so many rad or m, such as 1e-4",
            positive,
        ),
        Option(
            "--replay",
            "also write replay.html, the motion in 3-D; needs consistent-id[viz]",
        ),
        *RESULTS,
        more=_MORE,
        examples=_EXAMPLES,
    )


def run_excite(options: argparse.Namespace) -> int:
    """Design a trajectory; return the exit code."""
    if options.standing is not None:
        return show(options, standing_answer(options))
    return answered(options, _excite)


def _excite(options: argparse.Namespace) -> Answer:
    from consistent_id.excitation import output
    from consistent_id.excitation.playable import playable_design
    from consistent_id.excitation.replay import require_viewer
    from consistent_id.excitation.sources import (
        earlier_recordings,
        estimated_parameters,
        problem_to_excite,
        with_open_parameters,
    )
    from consistent_id.robot.chains import Selection

    formats = output.checked_formats(options.format)
    part = Selection(options.base, options.tip)
    problem = problem_to_excite(options.problem, motion_changes(options), part)
    problem = with_open_parameters(problem, options.parameters)
    parameters = estimated_parameters(problem, options.parameters)
    earlier = earlier_recordings(problem, options.earlier)
    folder = options.output or Path("results") / problem.name
    if options.replay:
        require_viewer(folder / output.REPLAY)
    if options.dry_run:
        plan = output.planned_tables(problem, parameters)
        return tables_answer(plan, [asdict(table) for table in plan])
    output.require_places(folder, formats)
    draft = _draft(options, folder)
    playable = playable_design(
        problem,
        parameters=parameters,
        starts=options.starts,
        time_limit=options.time_limit,
        seed=options.seed,
        workers=options.workers,
        sequential=options.sequential,
        earlier=earlier,
        progress=shows_progress(options),
    )
    written = _written(options, problem, playable, folder, draft)
    text = "\n\n".join(table.text() for table in output.playable_tables(playable))
    text += "\n\nwritten: " + ", ".join(str(path) for path in written)
    record = output.playable_record(playable)
    return Answer(1 if playable.refusals else 0, text, record)


def _written(
    options: argparse.Namespace,
    problem: "Problem",
    playable: "PlayableDesign",
    folder: Path,
    draft: str | None,
) -> list[Path]:
    """Write a design, the problem file of a robot that had none, and a replay."""
    from consistent_id._support.files import write_atomically
    from consistent_id.excitation import output
    from consistent_id.excitation.playable import TRAINING

    written = []
    if draft is not None:
        written.append(write_atomically(folder / _FILE, draft))
    formats = output.checked_formats(options.format)
    written += output.write_design(playable, folder, formats, options.thin)
    if options.replay and TRAINING in playable.moves:
        written.append(output.replay_design(problem, playable, folder))
    return written


def _draft(options: argparse.Namespace, folder: Path) -> str | None:
    """Return the problem file of a robot that has none, if there is a place for it."""
    from consistent_id.excitation.sources import changed, is_robot
    from consistent_id.problems.excitation_tables import ExcitationTable
    from consistent_id.problems.robot_draft import robot_draft
    from consistent_id.robot.chains import Selection

    if not is_robot(options.problem):
        return None
    table = changed(ExcitationTable(), motion_changes(options))
    part = Selection(options.base, options.tip)
    draft = robot_draft(options.problem, table, part).text(folder)
    _require_place(folder, draft)
    return draft


def _require_place(folder: Path, draft: str) -> None:
    """Refuse, before the search, to replace a file that may have been edited."""
    from consistent_id._support.files import require_replaceable
    from consistent_id.errors import ProblemError

    try:
        require_replaceable(folder / _FILE, draft.encode())
    except ProblemError as cause:
        raise ProblemError(
            f"{cause}. To design another motion for that problem: consistent-id excite "
            f"{folder}, with the same options"
        ) from None

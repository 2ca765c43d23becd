"""``consistent-id excite PROBLEM | ROBOT``: its options, and what it prints."""

import argparse
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from consistent_id.cli.answers import (
    Answer,
    answered,
    show,
    shows_progress,
    tables_answer,
)
from consistent_id.cli.motion_options import (
    MOTION,
    MOTION_OPTIONS,
    SEARCH,
    estimates,
    motion_changes,
    parameters,
)
from consistent_id.cli.options import (
    RESULTS,
    Group,
    Option,
    add_command,
    positive,
    whole,
)
from consistent_id.cli.source import PROBLEM_OR_ROBOT, ROBOT, statement

if TYPE_CHECKING:
    from consistent_id.excitation.playable import PlayableDesign
    from consistent_id.problems.problem import Problem
    from consistent_id.standing.standing_design import StandingDesign


_MORE = """With a URDF or MJCF file in place of PROBLEM no problem file is needed; the
folder of results gets one. The time limit counts work: a busy machine does the same
search in more seconds. Exit code 1: a motion is refused."""
_EXAMPLES = """
consistent-id excite robot.urdf --acceleration 5 --duration 20
consistent-id excite problems/rx60 --time-limit 3 --output results/motion
consistent-id excite problems/rx60 --objective D --output results/least-errors
consistent-id excite problems/ur10e --sequential --starts 8 --seed 1
consistent-id excite problems/arm --earlier regression.json
consistent-id excite robot.urdf --for tool0 --others known --start-pose elbow=1.2
consistent-id excite go2.xml --standing --velocity 4 --effort 23
"""
_FILE = "problem.toml"
_FORMATS = "csv,yaml"


_RATE = 200.0  # Hz, of the files of samples


def _sides(text: str) -> tuple[float, float]:
    """Read two lengths with a comma between them."""
    try:
        length, width = map(float, text.split(","))
    except ValueError:
        raise argparse.ArgumentTypeError(
            f"{text}: expected LENGTH,WIDTH in metres, such as 0.2,0.1"
        ) from None
    return length, width


STANDING = Group(
    "a robot on its feet (ROBOT is a URDF or MJCF file)",
    (
        Option(
            "--standing FOOT [...]",
            "sway the trunk over these feet, which stay on the ground (default: all)",
        ),
        Option(
            "--stance JOINT=POSITION ...",
            "the pose (default: keyframe home, or bent knees)",
        ),
        Option("--link NAME", "the body to identify (default: the base)"),
        Option("--sole LENGTH,WIDTH", "size of flat feet, m", _sides),
        Option(
            "--friction NUMBER",
            "coefficient between feet and ground",
            positive,
            default=0.6,
        ),
        Option("--candidates N", "paths to try", whole, default=320),
    ),
)


def add_excite(command: argparse.ArgumentParser) -> None:
    """Give the command its options."""
    add_command(
        command,
        run_excite,
        PROBLEM_OR_ROBOT,
        *ROBOT,
        MOTION,
        Option("--seed N", "seed of the random starts", int, default=0),
        *SEARCH,
        Option(
            "--sequential",
            "also count the information of the problem's training recordings",
        ),
        Option(
            "--earlier REGRESSION ...",
            "also count the information of regressions that compress wrote, such as "
            "regression.json",
            Path,
        ),
        parameters(),
        STANDING,
        Option(
            "--format ENDINGS",
            "files of samples: csv, yaml (ROS), parquet, npz, script (Universal "
            "Robots), rsi (KUKA), franka, by commas",
            default=_FORMATS,
        ),
        Option(
            "--thin TOLERANCE",
            "write fewer points into the yaml file: a controller that joins them by "
            "quintics stays within this distance (rad or m), such as 1e-4",
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
    _require_standing(options)
    return answered(options, _excite)


def _excite(options: argparse.Namespace) -> Answer:
    from consistent_id.excitation import output
    from consistent_id.excitation.earlier_files import REPLAY, earlier_files
    from consistent_id.excitation.html_replay import require_viewer
    from consistent_id.excitation.playable import playable_design
    from consistent_id.excitation.sources import (
        earlier_recordings,
        estimated_parameters,
        problem_to_excite,
        with_open_parameters,
    )

    formats = output.checked_formats(options.format)
    output.require_thinned(formats, options.thin)
    changes, stated = motion_changes(options), statement(options, "robot")
    problem = problem_to_excite(options.problem, changes, stated)
    known = estimates(options)
    problem = with_open_parameters(problem, known)
    parameters = estimated_parameters(problem, known)
    earlier = earlier_recordings(problem, options.earlier)
    folder = options.output or Path("results") / problem.name
    if options.replay:
        require_viewer(folder / REPLAY)
    output.require_formats(formats, problem.moving)
    if options.dry_run:
        plan = output.planned(problem, parameters)
        return tables_answer(plan.tables, plan.record)
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
    others = earlier_files(playable.moves, folder, formats, replayed=options.replay)
    tables = (table.text() for table in output.playable_tables(playable))
    record = output.playable_record(playable)
    return Answer(
        1 if playable.refusals else 0,
        "\n\n".join([*others.sentences(), *tables]),
        record | ({"earlier_files": others.record()} if others.record() else {}),
        partial(_written, options, problem, playable, folder, draft),
    )


def _written(
    options: argparse.Namespace,
    problem: "Problem",
    playable: "PlayableDesign",
    folder: Path,
    draft: str | None,
) -> list[Path]:
    """Write a design, the problem file of a robot that had none, and a replay."""
    from consistent_id.excitation import output
    from consistent_id.excitation.playable import TRAINING
    from consistent_id.problems.kept_text import write_problem

    written = []
    if draft is not None:
        written.append(write_problem(draft, folder / _FILE))
    formats = output.checked_formats(options.format)
    written += output.write_design(playable, folder, formats, options.thin)
    if options.replay and TRAINING in playable.moves:
        written.append(output.replay_design(problem, playable, folder))
    return written


def _draft(options: argparse.Namespace, folder: Path) -> str | None:
    """Return a problem file for a robot without one, if a folder is named for it."""
    from consistent_id.excitation.sources import changed, is_robot
    from consistent_id.problems.robot_draft import robot_draft
    from consistent_id.problems.task_tables import ExcitationTable

    if not is_robot(options.problem):
        return None
    table = changed(ExcitationTable(), motion_changes(options))
    draft = robot_draft(options.problem, table, statement(options, "robot")).text(
        folder
    )
    _require_place(folder, draft)
    return draft


def _require_place(folder: Path, draft: str) -> None:
    """Refuse to replace a file that may have been edited, before the search begins."""
    from consistent_id._support.files import require_replaceable
    from consistent_id.errors import ProblemError

    try:
        require_replaceable(folder / _FILE, draft.encode())
    except ProblemError as cause:
        raise ProblemError(
            f"{cause}. To design another motion for that problem: consistent-id excite "
            f"{folder}, with the same options"
        ) from None


def standing_answer(options: argparse.Namespace) -> Answer:
    """Design a motion on feet, and write it."""
    from consistent_id._support.files import require_writable
    from consistent_id.standing.standing_files import (
        NAMES,
        standing_record,
        standing_tables,
        write_standing,
    )

    _refuse_others(options)
    folder = options.output or Path("results") / options.problem.stem
    if not options.dry_run:
        require_writable(folder, list(NAMES))
    design = _design(options)
    tables = standing_tables(design)

    def write() -> list[Path]:
        return write_standing(design, folder, _RATE)

    return tables_answer(tables, standing_record(design), write=write)


def _design(options: argparse.Namespace) -> "StandingDesign":
    from consistent_id._support.progress import counted
    from consistent_id.problems.stated_model import DEFAULT_DRIVE
    from consistent_id.problems.statement_words import read_position
    from consistent_id.regression.regressor import TorqueModel
    from consistent_id.robot.loaders import load_robot
    from consistent_id.standing.forces_and_limits import StandingLimits
    from consistent_id.standing.stance import (
        Stance,
        standing_feet,
        standing_pose,
    )
    from consistent_id.standing.standing_design import design_standing

    path = options.problem
    robot = load_robot(path, base="floating")
    feet = standing_feet(robot, path, options.standing, options.sole)
    pose = standing_pose(robot, path, feet, dict(map(read_position, options.stance)))

    with counted(options.candidates, "paths", shows_progress(options)) as count:

        def tell(done: int, error: float) -> None:
            count(done, f"(least relative error: {error:.3g} per N m)")

        return design_standing(
            Stance(robot, feet, pose),
            TorqueModel(robot, DEFAULT_DRIVE.terms),
            StandingLimits(
                friction=options.friction,
                velocity=options.velocity,
                effort=options.effort,
            ),
            link=options.link,
            duration=options.duration or 20.0,
            candidates=options.candidates,
            seed=options.seed,
            time_limit=options.time_limit,
            tell=tell,
        )


def _is_given(value: object) -> bool:
    """Return whether an option without a default has a value; zero is one."""
    return value is not None and value is not False and value not in ([], ())


_OF_FEET = ("duration", "velocity", "effort")  # of the options of motions
_USUAL = (("starts", 4), ("format", _FORMATS))  # options with a default


def _require_standing(options: argparse.Namespace) -> None:
    """Refuse options of robots on their feet without feet."""
    from consistent_id.errors import ProblemError

    for option in STANDING.options:
        value = getattr(options, option.name)
        if _is_given(value) and value != option.default:
            raise ProblemError(
                f"--{option.name} is of a robot on its feet: add --standing, or leave "
                "the option out"
            )


def _refuse_others(options: argparse.Namespace) -> None:
    """Refuse a problem file, and options that do not apply to motions on feet."""
    from consistent_id.errors import ProblemError
    from consistent_id.excitation.sources import is_robot

    if not is_robot(options.problem):
        raise ProblemError(
            f"--standing is of a robot's file; {options.problem} is none. Name the "
            "URDF or MJCF file"
        )
    motion = [one.name for one in MOTION_OPTIONS if one.name not in _OF_FEET]
    robot = ("base", "tip", "locked", "gravity", "package_dirs")
    others = ("sequential", "earlier", "parameters", "replay", "thin")
    names = (*motion, *robot, *others, "workers", "executor")
    given = [name for name in names if _is_given(getattr(options, name))]
    given += ["no-collisions"] * (options.collisions is False)
    given += [name for name, usual in _USUAL if getattr(options, name) != usual]
    given = ["for" if name == "interest" else name for name in given]
    if given:
        raise ProblemError(
            f"--{given[0].replace('_', '-')} is of arms; a motion on feet takes "
            "--duration, --velocity, --effort, --friction, --stance, --sole, --link, "
            "--candidates, --time-limit and --seed, and writes csv and yaml"
        )

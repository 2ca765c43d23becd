"""``consistent-id excite ROBOT --standing``: its options, and what it prints."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from consistent_id.cli.answers import Answer, shows_progress, tables_answer
from consistent_id.cli.option import Group, Option, positive

if TYPE_CHECKING:
    from consistent_id.excitation.standing.standing_design import StandingDesign

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
        Option("--link NAME", "the body that is not known (default: the base)"),
        Option("--sole LENGTH,WIDTH", "of feet that are flat, m", _sides),
        Option("--friction NUMBER", "of feet on the ground", positive, default=0.6),
        Option("--effort NUMBER", "limit of all joints, N m", positive),
        Option("--candidates N", "paths to try", int, default=320),
    ),
)


def standing_answer(options: argparse.Namespace) -> Answer:
    """Design a motion on feet, and write it."""
    from consistent_id._support.files import require_writable
    from consistent_id.excitation.standing import standing_output as output

    _refuse_others(options)
    folder = options.output or Path("results") / options.problem.stem
    if not options.dry_run:
        require_writable(folder, list(output.NAMES))
    design = _design(options)
    tables = output.standing_tables(design)

    def write() -> list[Path]:
        return output.write_standing(design, folder, _RATE)

    return tables_answer(tables, output.standing_record(design), write=write)


def _design(options: argparse.Namespace) -> "StandingDesign":
    import sys

    from consistent_id.cli.log_options import held_joint
    from consistent_id.excitation.standing.feet_and_pose import (
        standing_feet,
        standing_pose,
    )
    from consistent_id.excitation.standing.stance import Stance
    from consistent_id.excitation.standing.standing_design import design_standing
    from consistent_id.excitation.standing.standing_limits import StandingLimits
    from consistent_id.problems.model import DEFAULT_DRIVE
    from consistent_id.regression.regressor import TorqueModel
    from consistent_id.robot.loaders import load_robot

    path = options.problem
    robot = load_robot(path, base="floating")
    feet = standing_feet(robot, path, options.standing, options.sole)
    pose = standing_pose(robot, path, feet, dict(map(held_joint, options.stance)))

    def tell(done: int, error: float) -> None:
        print(f"{done}/{options.candidates} paths: {error:.3g}", file=sys.stderr)

    return design_standing(
        Stance(robot, feet, pose),
        TorqueModel(robot, DEFAULT_DRIVE.terms),
        StandingLimits(
            friction=options.friction, velocity=options.velocity, effort=options.effort
        ),
        link=options.link,
        duration=options.duration or 20.0,
        candidates=options.candidates,
        seed=options.seed,
        tell=tell if shows_progress(options) else None,
    )


def _refuse_others(options: argparse.Namespace) -> None:
    """Refuse a problem file, and options that a motion on feet does not heed."""
    from consistent_id.errors import ProblemError
    from consistent_id.excitation.sources import is_robot

    if not is_robot(options.problem):
        raise ProblemError(
            f"--standing is of a robot's file; {options.problem} is none. Name the "
            "URDF or MJCF file"
        )
    design = ("objective", "harmonics", "interest", "noise", "acceleration", "jerk")
    others = ("base", "tip", "sequential", "earlier", "parameters", "replay", "share")
    search = ("workers", "executor")
    given = [name for name in (*design, *others, *search) if getattr(options, name)]
    if given:
        raise ProblemError(
            f"--{given[0].replace('_', '-')} is of arms; a motion on feet takes "
            "--duration, --velocity, --effort, --friction, --stance, --sole, --link, "
            "--candidates and --seed"
        )

"""Options that say what motion to design, in place of keys of ``[excitation]``."""

import argparse
from pathlib import Path
from typing import Any

from consistent_id.cli.options import positive

_KEYS = (
    "objective",
    "interest",
    "duration",
    "harmonics",
    "smooth",
    "noise",
    "velocity",
    "acceleration",
    "jerk",
    "effort_rate",
    "effort_rms",
    "current",
    "torque_constant",
    "friction_share",
    "share",
    "ground",
    "clearance",
    "planning_scene",
    "collisions",
)


def add_motion_options(command: argparse.ArgumentParser) -> None:
    """Take keys of ``[excitation]``, its limits and its scene."""
    asked = command.add_argument_group(
        "what motion", "in place of what [excitation] of the problem file says"
    )
    asked.add_argument(
        "--objective",
        choices=("D", "condition", "A", "E"),
        help="D: least standard errors (default); condition: least condition number of "
        "the regressor, then D; A, E: of the errors, the root sum of squares, the "
        "largest",
    )
    asked.add_argument(
        "--harmonics", type=int, help="number (default: several are tried)"
    )
    asked.add_argument(
        "--for",
        "--interest",
        dest="interest",
        type=_words,
        metavar="NAMES",
        help="parameters that matter, by commas: of links, joints, or one by one, such "
        "as 'payload,*.viscous'; 'payload' or 'tool': the last link's ten; 'open': "
        "what the estimate of --parameters left open (default: all)",
    )
    for name, unit, text in (
        ("duration", "SECONDS", "of the motion (default: 10)"),
        ("noise", "NUMBER", "of each torque, in N m or N (default: 0.5 %% of effort)"),
        ("velocity", "NUMBER", "limit of all joints, in rad/s or m/s"),
        ("acceleration", "NUMBER", "limit of all joints, in rad/s^2 or m/s^2"),
        ("jerk", "NUMBER", "limit of all joints, in rad/s^3 or m/s^3"),
        ("effort-rate", "NUMBER", "limit of how fast torque changes, in N m/s or N/s"),
        (
            "effort-rms",
            "NUMBER",
            "limit of each torque's root mean square, in N m or N",
        ),
        ("current", "AMPERES", "limit of all motors; needs --torque-constant"),
        ("torque-constant", "NUMBER", "of all joints, gears included, in N m/A or N/A"),
        ("share", "SHARE", "of all limits that may be used, such as 0.9"),
        ("clearance", "METRES", "between bodies that must not touch"),
    ):
        asked.add_argument(f"--{name}", type=positive, metavar=unit, help=text)
    asked.add_argument(
        "--friction-share",
        type=float,
        metavar="SHARE",
        help="of the effort limits, left for friction without --parameters "
        "(default: 0.3)",
    )
    asked.add_argument(
        "--smooth",
        action="store_const",
        const=True,
        help="begin and end without jerk: it is continuous from rest to rest",
    )
    asked.add_argument(
        "--planning-scene",
        type=_absolute,
        metavar="FILE",
        help="objects around the robot: MoveIt's .scene, or a PlanningScene message as "
        ".yaml or .json",
    )
    asked.add_argument(
        "--no-collisions",
        dest="collisions",
        action="store_const",
        const=False,
        help="leave out the scene, and the shapes of the URDF",
    )
    asked.add_argument(
        "--ground", type=float, metavar="METRES", help="height of a floor to keep off"
    )


def _absolute(text: str) -> str:
    """Return a path that means the same in the folder of a problem file."""
    return Path(text).resolve().as_posix().replace("$", "$$")


def _words(text: str) -> list[str]:
    """Return what commas separate."""
    return [word.strip() for word in text.split(",")]


def add_parameters(command: argparse.ArgumentParser, more: str = "") -> None:
    """Take files of estimates."""
    command.add_argument(
        "--parameters",
        type=Path,
        nargs="+",
        default=(),
        metavar="ESTIMATE",
        help="estimates that identify wrote, such as delivered.json: torque limits are "
        "kept by the worst of them, in place of the robot's file without friction"
        + more,
    )


def add_part(command: argparse.ArgumentParser) -> None:
    """Take the part of a robot's file that moves."""
    command.add_argument(
        "--base", metavar="LINK", help="link that stands still (default: the root)"
    )
    command.add_argument(
        "--tip", metavar="LINK", help="last link that counts, such as the flange"
    )


def motion_changes(options: argparse.Namespace) -> dict[str, Any]:
    """Return the keys that were given."""
    return {key: getattr(options, key) for key in _KEYS}

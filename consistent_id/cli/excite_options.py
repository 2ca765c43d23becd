"""Options that say what motion to design, in place of keys of ``[excitation]``."""

import argparse
from pathlib import Path
from typing import Any

from consistent_id.cli.option import Group, Option, positive
from consistent_id.cli.options import SEARCH_EXECUTOR


def _absolute(text: str) -> str:
    """Return a path that means the same in the folder of a problem file."""
    return Path(text).resolve().as_posix().replace("$", "$$")


def _words(text: str) -> list[str]:
    """Return what commas separate."""
    return [word.strip() for word in text.split(",")]


_LIMITS = (
    Option("--duration SECONDS", "of the motion (default: 10)", positive),
    Option(
        "--noise NUMBER",
        "of each torque, in N m or N (default: 0.5 %% of effort)",
        positive,
    ),
    Option("--velocity NUMBER", "limit of all joints, in rad/s or m/s", positive),
    Option(
        "--acceleration NUMBER", "limit of all joints, in rad/s^2 or m/s^2", positive
    ),
    Option("--jerk NUMBER", "limit of all joints, in rad/s^3 or m/s^3", positive),
    Option(
        "--effort-rate NUMBER",
        "limit of how fast torque changes, in N m/s or N/s",
        positive,
    ),
    Option(
        "--effort-rms NUMBER",
        "limit of each torque's root mean square, in N m or N",
        positive,
    ),
    Option(
        "--current AMPERES", "limit of all motors; needs --torque-constant", positive
    ),
    Option(
        "--torque-constant NUMBER",
        "of all joints, gears included, in N m/A or N/A",
        positive,
    ),
    Option("--share SHARE", "of all limits that may be used, such as 0.9", positive),
    Option("--clearance METRES", "between bodies that must not touch", positive),
)
_MOTION = (
    Option(
        "--objective",
        "D: least standard errors (default); condition: least condition number of the "
        "regressor, then D; A, E: of the errors, the root sum of squares, the largest",
        choices=("D", "condition", "A", "E"),
    ),
    Option("--harmonics N", "number (default: several are tried)", int),
    Option(
        "--for, --interest NAMES",
        "parameters that matter, by commas: of links, joints, or one by one, such as "
        "'payload,*.viscous'; 'payload' or 'tool': the last link's ten, or those of "
        "what is on the wrench sensor; 'open': what the estimate of --parameters left "
        "open (default: all; on a wrench sensor the tool's ten)",
        _words,
        dest="interest",
    ),
    *_LIMITS,
    Option(
        "--friction-share SHARE",
        "of the effort limits, left for friction without --parameters (default: 0.3)",
        float,
    ),
    Option(
        "--smooth",
        "begin and end without jerk: it is continuous from rest to rest",
        const=True,
    ),
    Option(
        "--planning-scene FILE",
        "objects around the robot: MoveIt's .scene, or a PlanningScene message as "
        ".yaml or .json",
        _absolute,
    ),
    Option(
        "--no-collisions",
        "leave out the scene, and the shapes of the URDF",
        dest="collisions",
        const=False,
    ),
    Option("--ground METRES", "height of a floor to keep off", float),
)
MOTION = Group(
    "what motion", _MOTION, "in place of what [excitation] of the problem file says"
)
PART = (
    Option("--base LINK", "link that stands still (default: the root)"),
    Option("--tip LINK", "last link that counts, such as the flange"),
)
SEARCH = (
    Option("--starts N", "searches from random paths", int, default=4),
    Option(
        "--time-limit SECONDS",
        "of a design's search, on an idle machine and for each worker",
        positive,
        default=10.0,
    ),
    Option(
        "--workers N",
        "shares of the starts, searched side by side (default: one per processor of "
        "this computer)",
        int,
    ),
    SEARCH_EXECUTOR,
)


def parameters(more: str = "") -> Option:
    """Return the option of files of estimates."""
    return Option(
        "--parameters ESTIMATE ...",
        "estimates that identify wrote, such as delivered.json: torque limits are kept "
        f"by the worst of them, in place of the robot's file without friction{more}",
        Path,
    )


def motion_changes(options: argparse.Namespace) -> dict[str, Any]:
    """Return the keys of ``[excitation]`` that were given, None for the others."""
    keys = (option.name for option in _MOTION)
    return {key: getattr(options, key) for key in keys}

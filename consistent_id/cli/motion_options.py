"""The options of motions and of their search, which several commands have."""

import argparse
from pathlib import Path
from typing import Any

from consistent_id.cli.options import (
    SEARCH_EXECUTOR,
    Group,
    Option,
    finite,
    positive,
    whole,
)


def _absolute(text: str) -> str:
    """Return a path that is also right from the folder of a problem file."""
    return Path(text).resolve().as_posix().replace("$", "$$")


def _words(text: str) -> list[str]:
    """Return the words between commas."""
    return [word.strip() for word in text.split(",")]


def _position(text: str) -> tuple[str, float]:
    """Read a joint and its position."""
    joint, _, position = text.partition("=")
    try:
        return joint, float(position)
    except ValueError:
        raise argparse.ArgumentTypeError(
            f"{text}: expected JOINT=POSITION in rad or m, such as elbow=0.5"
        ) from None


def _pair(text: str) -> tuple[str, str]:
    """Read the names of two bodies."""
    names = _words(text)
    if len(names) != 2 or not all(names):
        raise argparse.ArgumentTypeError(
            f"{text}: expected two bodies or links with a comma between them, such as "
            "ground,base_link"
        )
    return names[0], names[1]


_LIMITS = (
    Option("--duration SECONDS", "duration of the motion (default: 10)", positive),
    Option(
        "--noise NUMBER",
        "noise of each torque, in N m or N (default: 0.5 %% of the effort limit)",
        positive,
    ),
    Option("--velocity NUMBER", "limit of all joints, in rad/s or m/s", positive),
    Option(
        "--acceleration NUMBER", "limit of all joints, in rad/s^2 or m/s^2", positive
    ),
    Option("--jerk NUMBER", "limit of all joints, in rad/s^3 or m/s^3", positive),
    Option(
        "--effort NUMBER",
        "limit of all joints, in N m or N, in place of the file's",
        positive,
    ),
    Option(
        "--effort-rate NUMBER",
        "limit of the rate of change of torque, in N m/s or N/s",
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
        "torque per current of all joints, gears included, in N m/A or N/A",
        positive,
    ),
    Option(
        "--share SHARE", "share of all limits that may be used, such as 0.9", positive
    ),
    Option(
        "--clearance METRES",
        "least distance between bodies, refused if no pose keeps it (default: 0.02, "
        "less for pairs that are always nearer)",
        positive,
    ),
)
MOTION_OPTIONS = (
    Option(
        "--objective",
        "D: least standard errors (default); condition: least condition number of the "
        "regressor, then D; A: root sum of squares of the errors; E: largest error",
        choices=("D", "condition", "A", "E"),
    ),
    Option(
        "--harmonics N",
        "number of harmonics, up to 50 (default: several are tried)",
        whole,
    ),
    Option(
        "--for, --interest NAMES",
        "parameters that matter, with commas: names of links, joints, parameters, such "
        "as 'payload,*.viscous'; 'payload' or 'tool': the ten of the last link, or of "
        "the body on the wrench sensor; 'open': those that the estimate of "
        "--parameters left open (default: all; on a wrench sensor the tool's ten)",
        _words,
        dest="interest",
    ),
    Option(
        "--others WHAT",
        "parameters that --for does not name: unknown, or known, as for a load that is "
        "weighed by the difference between two logs (default: unknown)",
        choices=("unknown", "known"),
    ),
    Option(
        "--start-pose JOINT=POSITION ...",
        "pose of the robot before and after, in rad or m; joints that are not "
        "named, in the middle of their range (default: where the path begins)",
        _position,
    ),
    *_LIMITS,
    Option(
        "--friction-share SHARE",
        "share of the effort limits left for friction without --parameters "
        "(default: 0.3)",
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
    Option(
        "--ground METRES",
        "height of a floor that the robot must not touch; as for all of the scene, its "
        "shapes must be those of a URDF, or bodies in [excitation.scene]",
        finite,
    ),
    Option(
        "--allowed BODY,BODY ...",
        "pairs of bodies or links that may touch, such as ground,base_link",
        _pair,
    ),
)
MOTION = Group(
    "the motion",
    MOTION_OPTIONS,
    "in place of the settings in [excitation] of the problem file",
)
SEARCH = (
    Option("--starts N", "searches from random paths", whole, default=4),
    Option(
        "--time-limit SECONDS",
        "seconds of random paths and searches for each worker, counted on an idle "
        "machine; meshes, proofs and the validation motion take more; for a robot on "
        "its feet, seconds of the processor",
        positive,
        default=10.0,
    ),
    Option(
        "--workers N",
        "parts of the starts, searched at the same time (default: one per processor of "
        "this computer)",
        whole,
    ),
    SEARCH_EXECUTOR,
)


def parameters(more: str = "") -> Option:
    """Return the option of files of estimates."""
    return Option(
        "--parameters ESTIMATE ...",
        "estimates that identify wrote, such as delivered.json: torque limits are kept "
        f"for each of them, instead of for the robot's file without friction{more} "
        "(default: that of a folder of results, if it may be used)",
        Path,
    )


def estimates(options: argparse.Namespace) -> list[Path]:
    """Return the files of estimates that are given, or that of a folder of results."""
    from consistent_id.problems.loading import is_results, results_or_file
    from consistent_id.report.results import DELIVERED, open_results

    folder = results_or_file(options.problem)
    if options.parameters or not is_results(folder):
        return list(options.parameters)
    results = open_results(folder)
    known = results.verdict.usable and not results.changes()
    return [folder / DELIVERED] if known else []


def motion_changes(options: argparse.Namespace) -> dict[str, Any]:
    """Return the keys of ``[excitation]`` that were given, None for the others."""
    changes = {option.name: getattr(options, option.name) for option in MOTION_OPTIONS}
    return changes | {
        "start_pose": dict(options.start_pose) or None,
        "allowed": list(options.allowed) or None,
    }

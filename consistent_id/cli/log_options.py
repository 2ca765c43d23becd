"""Options that describe a log without a problem file."""

import argparse
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from consistent_id.cli.answers import shows_progress
from consistent_id.cli.base_options import BASE_COLUMNS, base_hints
from consistent_id.cli.option import Group, Option, positive

if TYPE_CHECKING:
    from consistent_id.problems.draft import Draft
    from consistent_id.recordings.signals import PDGains


def _gain(text: str) -> tuple[float, float, float]:
    """Read two or three numbers with commas between them."""
    try:
        kp, kd, *limit = map(float, text.split(","))
        (most,) = limit or [float("inf")]
    except ValueError:
        raise argparse.ArgumentTypeError(
            f"{text} is no gain, expected KP,KD such as 60,1.5, or KP,KD,LIMIT"
        ) from None
    return kp, kd, most


COLUMNS = (
    *(
        Option(
            f"--{channel} NAME",
            "the log's column, with {joint} or {number} (default: guessed from the "
            "log)",
        )
        for channel in ("time", "position", "velocity", "torque")
    ),
    Option(
        "--units UNIT ...",
        "units that are not s, rad, m, N m or N: deg, mm, rpm, ms, %% of rated torque; "
        "or CHANNEL=UNIT, such as velocity=deg/s or, joint by joint, position=deg,mm "
        "(default: as names say)",
    ),
    Option(
        "--torque-joints JOINT ...", "joints whose torque the log has (default: all)"
    ),
    Option("--base LINK", "link that stands still (default: the root), or 'floating'"),
    Option("--tip LINK", "last link that counts, such as the flange"),
    Option(
        "--lock JOINT ...",
        "joints that stand still, at zero or where JOINT=POSITION says",
    ),
)
TORQUE_GAIN = Option(
    "--torque-gain NUMBER ...",
    "from the torque columns to N m or N: one for all joints, or one each",
    float,
)
# What makes torque of commands, where the log has no torque.
GAINS = (
    Option(
        "--gains KP,KD[,LIMIT] ...",
        "of PD-controlled joints, for all or one each: torque is computed from "
        "commands of position, and clipped at the drive's limit (N m, N) if given",
        _gain,
    ),
    Option(
        "--position-command NAME",
        "the log's column of commands, for --gains (default: guessed from the log)",
    ),
)
BAND = Option(
    "--band HZ",
    "up to which torque is to be predicted (default: 20 times the band of the "
    "velocity)",
    positive,
)
_MODEL = (
    Option(
        "--bodies",
        "identify bodies, or take those of the model and identify the drives",
        choices=("identified", "model"),
        default="identified",
    ),
    Option(
        "--masses",
        "whether the model's masses are the robot's",
        choices=("model", "free"),
    ),
    Option(
        "--drive TERM ...",
        "drive terms of all joints, such as viscous coulomb offset, and of one joint "
        "in their place: JOINT=viscous,coulomb",
    ),
    Option("--cutoff HZ", "cut-off of the motion", positive),
    BAND,
    Option(
        "--friction-velocity V",
        "width of friction's change of sign, rad/s or m/s",
        positive,
    ),
    Option(
        "--keep WHAT ...",
        "leave as in the plain model: drive terms, least_speed, delay, coupling",
    ),
    Option(
        "--no-select",
        "viscous and Coulomb friction, an offset; only a cut-off is chosen",
    ),
)
# What a draft of a problem file is made from.
DRAFT: tuple[Option | Group, ...] = (
    Option(
        "--validate LOG ...",
        "logs to judge by (default: the last 30 %% of each log's motion)",
        Path,
    ),
    *COLUMNS,
    TORQUE_GAIN,
    *GAINS,
    BASE_COLUMNS,
    Group("the model, chosen by the data unless given", _MODEL),
)


def known_of(options: argparse.Namespace) -> dict[str, Any]:
    """Return what the options say of a log, as `robot_logs` takes it."""
    from consistent_id.robot.chains import Selection

    channels = ("time", "position", "velocity", "torque", "position_command")
    named = {name: getattr(options, name) for name in channels}
    return {
        "columns": {name: column for name, column in named.items() if column},
        "units": units_of(options.units),
        "torque_joints": options.torque_joints,
        "selection": Selection(
            options.base,
            options.tip,
            locked=dict(map(held_joint, options.lock)) or None,
        ),
        "torque_gain": options.torque_gain,
        "gains": _gains(options.gains),
    }


def draft_of(options: argparse.Namespace, model: Path, logs: Sequence[Path]) -> "Draft":
    """Draft the problem that a robot and its logs make."""
    from consistent_id.problems.drafting import draft_problem

    return draft_problem(
        model,
        logs,
        validation=options.validate,
        bodies=options.bodies,
        masses="datasheet" if options.masses == "model" else options.masses,
        drive=options.drive or None,
        cutoff=options.cutoff,
        band=options.band,
        friction_velocity=options.friction_velocity,
        keep=options.keep,
        select=not options.no_select,
        progress=shows_progress(options),
        base=base_hints(options),
        **known_of(options),
    )


def units_of(words: Sequence[str]) -> dict[str, str | list[str]]:
    """Return units by channel; with commas between them, one for each joint.

    A unit without a channel is of the channel that has it; an angle or a length is of
    the position and, per second, of its derivatives.

    Raises
    ------
    RecordingError
        If a channel or a unit is unknown.

    Examples
    --------
    >>> units_of(["deg", "%"])["velocity"], units_of(["velocity=rpm"])
    ('deg/s', {'velocity': 'rpm'})
    """
    bare = [word for word in words if "=" not in word]
    named = (word.partition("=") for word in words if "=" in word)
    found: dict[str, str | list[str]] = {}
    for word in bare:
        found |= _fitting(word)
    for channel, _, unit in named:
        found[channel] = unit.split(",") if "," in unit else unit
    return found


def _fitting(unit: str) -> dict[str, str]:
    """Return the channels that have a unit."""
    from consistent_id.errors import RecordingError
    from consistent_id.recordings.readers.units import KNOWN, standard_unit

    fits = {}
    for channel in KNOWN:
        with suppress(RecordingError):
            fits[channel] = standard_unit(channel, unit)
    if not fits:
        known = ", ".join(dict.fromkeys(u for each in KNOWN.values() for u in each))
        raise RecordingError(f"--units: no unit {unit!r}; known: {known}")
    if moved := fits.get("position"):
        speed = f"{moved}/s"
        fits |= {"velocity": speed, "velocity_command": speed}
        fits |= {"acceleration": f"{moved}/s^2"}
    return fits


def held_joint(word: str) -> tuple[str, float]:
    """Read a joint and where it is held, by default at zero."""
    from consistent_id.errors import ProblemError

    joint, equals, position = word.partition("=")
    try:
        return joint, float(position) if equals else 0.0
    except ValueError:
        raise ProblemError(
            f"--lock {word}: {position!r} is no number, expected a position in rad or m"
        ) from None


def _gains(given: Sequence[tuple[float, float, float]]) -> "PDGains | None":
    import numpy as np

    from consistent_id.recordings.signals import PDGains

    if not given:
        return None
    kp, kd, limit = np.array(given).T
    one = (kp[0], kd[0], limit[0])
    return PDGains(*one) if len(given) == 1 else PDGains(kp, kd, limit)

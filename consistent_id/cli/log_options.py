"""Options that describe a log without a problem file."""

import argparse
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from consistent_id.cli.answers import shows_progress
from consistent_id.cli.base_options import add_base_columns, base_hints
from consistent_id.cli.options import positive

if TYPE_CHECKING:
    from consistent_id.problems.draft import Draft
    from consistent_id.recordings.signals import PDGains


def add_columns(command: argparse.ArgumentParser) -> None:
    """Take what is known of a log's columns, units and joints; the rest is guessed."""
    for channel in ("time", "position", "velocity", "torque"):
        command.add_argument(
            f"--{channel}",
            metavar="NAME",
            help="the log's column, with {joint} or {number} (default: guessed from "
            "the log)",
        )
    command.add_argument(
        "--units",
        nargs="+",
        default=(),
        metavar="UNIT",
        help="units that are not s, rad, m, N m or N: deg, mm, rpm, ms, %% of rated "
        "torque; or CHANNEL=UNIT, such as velocity=deg/s or, joint by joint, "
        "position=deg,mm (default: as names say)",
    )
    command.add_argument(
        "--torque-joints",
        nargs="+",
        default=(),
        metavar="JOINT",
        help="joints whose torque the log has (default: all)",
    )
    command.add_argument(
        "--base",
        metavar="LINK",
        help="link that stands still (default: the root), or 'floating'",
    )
    command.add_argument(
        "--tip", metavar="LINK", help="last link that counts, such as the flange"
    )
    command.add_argument(
        "--lock",
        nargs="+",
        default=(),
        metavar="JOINT",
        help="joints that stand still, at zero or where JOINT=POSITION says",
    )


def add_torque_gain(command: argparse.ArgumentParser) -> None:
    """Take what makes torque of the torque columns."""
    command.add_argument(
        "--torque-gain",
        nargs="+",
        type=float,
        default=(),
        metavar="NUMBER",
        help="from the torque columns to N m or N: one for all joints, or one each",
    )


def add_gains(command: argparse.ArgumentParser) -> None:
    """Take what makes torque of commands, where the log has no torque."""
    command.add_argument(
        "--gains",
        nargs="+",
        type=_pair,
        default=(),
        metavar="KP,KD",
        help="of PD-controlled joints, one pair for all or one each: torque is "
        "computed from commands of position",
    )
    command.add_argument(
        "--position-command",
        metavar="NAME",
        help="the log's column of commands, for --gains (default: guessed from the "
        "log)",
    )


def add_draft_options(command: argparse.ArgumentParser) -> None:
    """Take what a draft of a problem file is made from."""
    command.add_argument(
        "--validate",
        nargs="+",
        type=Path,
        default=(),
        metavar="LOG",
        help="logs to judge by (default: the last 30 %% of each log's motion)",
    )
    add_columns(command)
    add_torque_gain(command)
    add_gains(command)
    add_base_columns(command)
    chosen = command.add_argument_group("the model, chosen by the data unless given")
    chosen.add_argument(
        "--bodies",
        choices=("identified", "model"),
        default="identified",
        help="identify bodies, or take those of the model and identify the drives "
        "(default: identified)",
    )
    chosen.add_argument(
        "--masses",
        choices=("model", "free"),
        help="whether the model's masses are the robot's",
    )
    chosen.add_argument(
        "--drive",
        nargs="+",
        metavar="TERM",
        help="drive terms of all joints, such as viscous coulomb offset",
    )
    chosen.add_argument(
        "--cutoff", type=positive, metavar="HZ", help="cut-off of the motion"
    )
    add_band(chosen)
    chosen.add_argument(
        "--friction-velocity",
        type=positive,
        metavar="V",
        help="width of friction's change of sign, rad/s or m/s",
    )
    chosen.add_argument(
        "--keep",
        nargs="+",
        default=(),
        metavar="WHAT",
        help="leave as in the plain model: drive terms, least_speed, delay, coupling",
    )
    chosen.add_argument(
        "--no-select",
        action="store_true",
        help="viscous and Coulomb friction, an offset; only a cut-off is chosen",
    )


def add_band(command: argparse.ArgumentParser | argparse._ArgumentGroup) -> None:
    """Take the band in which torque is to be predicted."""
    command.add_argument(
        "--band",
        type=positive,
        metavar="HZ",
        help="up to which torque is to be predicted (default: 20 times the band of "
        "the velocity)",
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
        drive=options.drive,
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


def _gains(pairs: Sequence[tuple[float, float]]) -> "PDGains | None":
    import numpy as np

    from consistent_id.recordings.signals import PDGains

    if not pairs:
        return None
    kp, kd = (np.array(values) for values in zip(*pairs, strict=True))
    return PDGains(kp[0], kd[0]) if len(pairs) == 1 else PDGains(kp, kd)


def _pair(text: str) -> tuple[float, float]:
    """Read two numbers with a comma between them."""
    try:
        kp, kd = map(float, text.split(","))
    except ValueError:
        raise argparse.ArgumentTypeError(
            f"{text} is no pair of gains, expected KP,KD such as 60,1.5"
        ) from None
    return kp, kd

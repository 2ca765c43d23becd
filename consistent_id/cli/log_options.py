"""Options that describe a log without a problem file."""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from consistent_id.problems.draft import Draft
    from consistent_id.recordings.signals import PDGains


def add_columns(
    command: argparse.ArgumentParser,
    position: str | None = None,
    torque: str | None = None,
) -> None:
    """Take the names of a log's columns; None: guessed from the log's names."""
    guessed = "guessed from the log"
    for channel, pattern, default in (
        ("time", "time" if position else None, "time" if position else guessed),
        ("position", position, position or guessed),
        ("velocity", None, "none" if position else guessed),
        ("torque", torque, torque or guessed),
    ):
        command.add_argument(
            f"--{channel}",
            default=pattern,
            metavar="NAME",
            help=f"the log's column, with {{joint}} or {{number}} (default: {default})",
        )
    command.add_argument(
        "--torque-joints",
        nargs="+",
        default=(),
        metavar="JOINT",
        help="joints whose torque the log has (default: all)",
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


def add_draft_options(command: argparse.ArgumentParser) -> None:
    """Take what a draft of a problem file is made from."""
    add_columns(command)
    command.add_argument(
        "--base", metavar="LINK", help="link that stands still (default: the root)"
    )
    command.add_argument(
        "--tip", metavar="LINK", help="last link that counts, such as the flange"
    )
    add_torque_gain(command)
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
    command.add_argument(
        "--bodies",
        choices=("identified", "model"),
        default="identified",
        help="identify bodies, or take those of the model and identify the drives "
        "(default: identified)",
    )
    command.add_argument(
        "--masses",
        choices=("model", "free"),
        default="model",
        help="whether the model's masses are the robot's (default: model)",
    )


def draft_of(options: argparse.Namespace, model: Path, log: Path) -> "Draft":
    """Draft the problem that a robot and a log make."""
    from consistent_id.problems.drafting import draft_problem
    from consistent_id.robot.chains import Selection

    channels = ("time", "position", "velocity", "torque", "position_command")
    named = {name: getattr(options, name) for name in channels}
    return draft_problem(
        model,
        log,
        columns={name: column for name, column in named.items() if column is not None},
        torque_joints=options.torque_joints,
        selection=Selection(options.base, options.tip),
        torque_gain=options.torque_gain,
        masses="free" if options.masses == "free" else "datasheet",
        gains=_gains(options.gains),
        bodies="model" if options.bodies == "model" else "identified",
    )


def _gains(pairs: Sequence[tuple[float, float]]) -> "PDGains | None":
    import numpy as np

    from consistent_id.recordings.signals import PDGains

    if not pairs:
        return None
    kp, kd = (np.array(values) for values in zip(*pairs, strict=True))
    return PDGains(kp[0], kd[0]) if len(pairs) == 1 else PDGains(kp, kd)


def _pair(text: str) -> tuple[float, float]:
    """Read two numbers with a comma between them."""
    kp, _, kd = text.partition(",")
    return float(kp), float(kd)

"""Options that describe a log without a problem file."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from consistent_id.problems.draft import Draft


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
        "--base",
        metavar="LINK",
        help="link that stands still (default: the root), or 'floating'",
    )
    command.add_argument(
        "--tip", metavar="LINK", help="last link that counts, such as the flange"
    )
    add_torque_gain(command)
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

    channels = ("time", "position", "velocity", "torque")
    named = {name: getattr(options, name) for name in channels}
    return draft_problem(
        model,
        log,
        columns={name: column for name, column in named.items() if column is not None},
        torque_joints=options.torque_joints,
        selection=Selection(options.base, options.tip),
        torque_gain=options.torque_gain,
        masses="free" if options.masses == "free" else "datasheet",
    )

"""Options that say what a log without a problem file holds."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from consistent_id.problem_draft import Draft
    from consistent_id.readers import Columns


def add_columns(
    command: argparse.ArgumentParser,
    position: str | None = None,
    torque: str | None = None,
) -> None:
    """Take the names of a log's columns; None: told from the log."""
    guessed = "told from the log"
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


def add_draft_options(command: argparse.ArgumentParser) -> None:
    """Take what a draft of a problem file rests on."""
    add_columns(command)
    command.add_argument(
        "--torque-gain",
        nargs="+",
        type=float,
        default=(),
        metavar="NUMBER",
        help="from the torque columns to N m or N: one for all joints, or one each",
    )
    command.add_argument(
        "--masses",
        choices=("model", "free"),
        default="model",
        help="whether the model's masses are the robot's (default: model)",
    )


def columns_of(options: argparse.Namespace) -> "Columns":
    """Return a log's columns as far as the options name them."""
    from consistent_id.readers import Columns

    usual = Columns()
    return Columns(
        options.time or usual.time,
        options.position or usual.position,
        options.velocity,
        torque=options.torque,
        torque_joints=options.torque_joints,
    )


def draft_of(options: argparse.Namespace, model: Path, log: Path) -> "Draft":
    """Draft the problem that a robot and a log make."""
    from consistent_id.drafting import draft_problem

    channels = ("time", "position", "velocity", "torque")
    return draft_problem(
        model,
        log,
        columns_of(options),
        said=" ".join(name for name in channels if getattr(options, name) is not None),
        torque_gain=options.torque_gain,
        masses="free" if options.masses == "free" else "datasheet",
    )

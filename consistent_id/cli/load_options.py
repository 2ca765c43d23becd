"""What ``payload`` and ``gains`` share: a robot, and logs of it with a load."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from consistent_id.cli.options import Option, positive
from consistent_id.cli.source import PROBLEM, opened, statement

if TYPE_CHECKING:
    from consistent_id.problems.problem import Problem


def numbers(text: str) -> tuple[float, ...]:
    """Read numbers that commas separate."""
    return tuple(float(word) for word in text.split(","))


def _numbers_from_1(text: str) -> tuple[int, ...]:
    rows = tuple(int(word) for word in text.split(","))
    if min(rows) < 1:
        raise ValueError
    return rows


def _rows(text: str) -> tuple[int, ...]:
    rows = _numbers_from_1(text)
    if len(rows) != 2:
        raise ValueError
    return rows


def percentage(text: str) -> float:
    """Read a positive share in percent."""
    return 0.01 * positive(text)


ROBOT_AND_LOAD = (
    PROBLEM,
    Option("log [...]", "logs without the load, if PROBLEM is a URDF or MJCF", Path),
    Option("--loaded LOG ...", "logs with the load", Path, required=True),
    Option(
        "--loaded-rows FIRST,LAST",
        "rows of these logs to use, from 1 (default: all)",
        _rows,
    ),
    Option(
        "--loaded-omit ROW,ROW",
        "broken rows of these logs, from 1",
        _numbers_from_1,
    ),
    Option(
        "--link LINK",
        "link or fixed frame that carries the load, in whose frame controllers get "
        "it, such as tool0 (default: the last link)",
    ),
)
"""Arguments and options of commands on a robot and its load."""


def robot_without_load(options: argparse.Namespace) -> "Problem":
    """Return the robot without the load, as it was if its results are named."""
    from consistent_id.problems.folder import is_results
    from consistent_id.report.results import open_results

    stated = statement(options).given
    if not options.log and not stated and is_results(options.problem):
        return open_results(options.problem).problem
    return opened(options).problem

"""Units that a log's numbers show, as options; and options joined to one text.

A proposal to the user contains all that a log needs.  A clock in milliseconds or
positions in degrees would show only in the diagnosis, after the next command, and
gains of currents that they imply would be wrong.
"""

import shlex
from collections.abc import Sequence

import numpy as np

from consistent_id.diagnosis.clock import clock_unit
from consistent_id.diagnosis.findings import FoundUnit
from consistent_id.diagnosis.wrong_units import travel_unit
from consistent_id.problems.statement import Statement
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals import unwrapped
from consistent_id.robot.model import RobotModel

_WHOLE = 0.8  # of a turn: a jump by a whole one
_STEADY = 1.0  # rad, between samples that do not jump


def needed_unit(
    robot: RobotModel, log: Recording, stated: Statement
) -> FoundUnit | None:
    """Return the unit of the clock or of positions that is not the stated one.

    Parameters
    ----------
    robot : RobotModel
        With the log's joints, in their order.
    stated : Statement
        Channels whose units are stated are not examined.
    """
    units = stated.units or {}
    found = None if "time" in units else clock_unit(log)
    if found is None and "position" not in units:
        return travel_unit(robot, log)
    return found


def wraps(log: Recording) -> bool:
    """Return whether positions jump by whole turns, and by no other steps."""
    most, undone = (
        float(abs(np.diff(each.position, axis=0)).max(initial=0.0))
        for each in (log, unwrapped(log))
    )
    return most > _WHOLE * 2.0 * np.pi and undone < _STEADY


def joined_options(options: Sequence[str]) -> str:
    """Return options as one text, in which each has all its values.

    Examples
    --------
    >>> joined_options(["--units time=ms --lock a", "--units deg"])
    '--units time=ms deg --lock a'
    """
    values: dict[str, list[str]] = {}
    name = ""
    for word in shlex.split(" ".join(options)):
        if word.startswith("--"):
            name = word
            values.setdefault(name, [])
        else:
            values[name].append(word)
    return " ".join(
        " ".join([name, *map(shlex.quote, each)]).strip()
        for name, each in values.items()
    )

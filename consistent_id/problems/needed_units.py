"""Units that a log's numbers show, as options; and options joined to one text.

A proposal to the user contains all that a log needs.  A clock in milliseconds or
positions in degrees would show only in the diagnosis, after the next command, and
gains of currents that they imply would be wrong.
"""

import re
import shlex
from collections.abc import Sequence
from typing import NamedTuple

from consistent_id.diagnosis.clock import clock_findings
from consistent_id.diagnosis.wrong_units import travel_findings
from consistent_id.problems.statement import Statement
from consistent_id.recordings.readers.units import COUNTS
from consistent_id.recordings.recording import Recording
from consistent_id.robot.model import RobotModel

_UNITS = re.compile(r"\((--units [^()]+)\)")  # in the advice of a finding
_ZEROS = re.compile(r"--position-offset(?: [^\s=]+=[-+.\de]+)+")


class NeededUnit(NamedTuple):
    """A unit that a log's numbers show: the option that states it, and why."""

    option: str
    sentence: str


def needed_unit(
    robot: RobotModel, log: Recording, stated: Statement
) -> NeededUnit | None:
    """Return the unit of the clock or of positions that is not the stated one.

    Parameters
    ----------
    robot : RobotModel
        With the log's joints, in their order.
    stated : Statement
        Channels whose units are stated are not examined.
    """
    units = stated.units or {}
    found = [] if "time" in units else clock_findings(log)
    if not found and "position" not in units:
        found = [f for f in travel_findings(robot, log) if f.where == "all joints"]
    for finding in found:
        option, zeros = (p.search(finding.advice) for p in (_UNITS, _ZEROS))
        if option is not None and COUNTS not in option[1]:
            both = [option[1], *([zeros[0]] if zeros is not None else [])]
            return NeededUnit(" ".join(both), finding.statement)
    return None


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

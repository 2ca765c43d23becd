"""The order of joints that a comment above numbered columns states."""

import re
import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path

from consistent_id.errors import RecordingError
from consistent_id.recordings.column_names import NamePattern, columns_of_pattern
from consistent_id.recordings.log_formats import log_format
from consistent_id.recordings.readers.table_text import text_head


def require_commented_order(
    log: Path, found: Mapping[str, NamePattern], joints: Sequence[str]
) -> None:
    """Refuse numbered columns whose joints a comment names in another order.

    Parameters
    ----------
    found : mapping of str to NamePattern
        By channel; columns that have the joints' names are no question.
    joints : sequence of str
        The robot's joints, in its order.

    Raises
    ------
    RecordingError
        With the options that name the columns in the robot's order.
    """
    numbered = {c: p for c, p in found.items() if _counts(p, joints)}
    if not numbered or len(joints) < 2 or not log.is_file():
        return
    order = _order_above(log, joints) if log_format(log).is_text else ()
    if not order or order == tuple(joints):
        return
    options = []
    for channel, pattern in numbered.items():
        columns = columns_of_pattern(pattern)
        own = [columns[order.index(joint)] for joint in joints]
        option = f"--{channel.replace('_', '-')}"
        options.append(f"{option} {shlex.quote('{' + ','.join(own) + '}')}")
    said = " ".join(options)
    raise RecordingError(
        f"{log}: a comment names the joints in another order than the robot's, "
        f"{', '.join(order)}, and columns have numbers. If it is their order: {said}; "
        "if not, delete the comment",
        options=said,
    )


def _counts(pattern: NamePattern, joints: Sequence[str]) -> bool:
    """Return whether a pattern has a number in place of each joint."""
    counted = "{number" in pattern.text or bool(pattern.names)
    columns = columns_of_pattern(pattern) if counted else []
    usable = not any(set("{},") & set(name) for name in columns)
    return counted and usable and pattern.joints == tuple(joints)


def _order_above(log: Path, joints: Sequence[str]) -> tuple[str, ...]:
    """Return the joints as the only comment that names them all has them; or none."""
    orders = set[tuple[str, ...]]()
    for line in text_head(log).splitlines():
        if not line.startswith("#"):
            break
        places = {
            joint: found.start()
            for joint in joints
            if (found := re.search(rf"(?<!\w){re.escape(joint)}(?!\w)", line))
        }
        if len(places) == len(joints):
            orders.add(tuple(sorted(joints, key=places.__getitem__)))
    return orders.pop() if len(orders) == 1 else ()

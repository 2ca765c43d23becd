"""What to say of a log that has a wrench sensor's columns, which drafts do not use."""

from collections.abc import Sequence
from pathlib import Path

from consistent_id.problems.floating.mujoco_arrays import widths_of
from consistent_id.recordings.log_formats import log_format
from consistent_id.recordings.readers.recording_file import column_names, reader_of
from consistent_id.recordings.wrench_words import (
    WrenchNames,
    may_be_wrench,
    wrench_names,
)
from consistent_id.robot.model import RobotModel

_ARRAYS = ("NPZ", "Parquet", "Feather")  # formats whose columns may be arrays
_KINDS = ("geometry_msgs/msg/WrenchStamped", "geometry_msgs/msg/Wrench")


def wrenches_in_log(
    log: Path, names: Sequence[str] | None = None
) -> tuple[WrenchNames, ...]:
    """Return what a log has that may be of a wrench sensor.

    Parameters
    ----------
    log : Path
    names : sequence of str, optional
        Columns of a table in memory, which the path stands for.
    """
    if names is not None:
        return wrench_names(names)
    form = log_format(log)
    if form.holds == "joint states":
        kinds: dict[str, str] = reader_of(log).topic_kinds(log)
        fields = {_KINDS[0]: ".wrench", _KINDS[1]: ""}
        return tuple(
            WrenchNames((topic + fields[kind],))
            for topic, kind in kinds.items()
            if fields.get(kind)
        )
    if not form.lists_names:
        return ()
    known = column_names(log)
    widths = {}
    if form.name in _ARRAYS and (wanted := [n for n in known if may_be_wrench(n)]):
        widths = widths_of(reader_of(log).read_arrays(log, wanted))
    return wrench_names(known, widths)


def wrench_note(found: Sequence[WrenchNames], robot: RobotModel) -> str:
    """Say what columns look like a wrench sensor's, and how they are used; "" of none.

    The frame is the last that is fixed to the last link: a guess, and called so.
    """
    if not found:
        return ""
    last = robot.links[-1]
    frame = last.merged[-1].name if last.merged else last.name
    seen = "; ".join(map(str, found))
    values = ", ".join(f'"{name}"' for name in found[0].names)
    columns = f'[[data.wrenches]] frame = "{frame}", values = [{values}]'
    if robot.floating:
        return (
            f"{seen}: these look like a wrench sensor's and are not used; at a foot "
            f"whose frame is {frame}, say, write {columns}"
        )
    return (
        f"{seen}: these look like a wrench sensor's; they tell what hangs on it, not "
        f'the robot: [wrist_sensor] frame = "{frame}" (or where it is) and {columns} '
        "in a problem file (docs/wrist-sensor.md)"
    )

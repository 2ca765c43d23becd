"""The joints of a robot that a log with fewer columns may have: some in a row.

A robot's file often has more joints than the log: a gripper, a rail, a second arm, a
torso.  Of all rows of joints with the log's number, those come first whose nominal
torque, with the other joints at rest, explains most of the log's.
"""

import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np

from consistent_id.errors import ConsistentIdError
from consistent_id.problems.nominal_gains import torque_shares
from consistent_id.recordings.recording import Recording
from consistent_id.robot.model import RobotModel

_MOST = 12  # rows of joints that are compared
_ALIKE = 0.02  # share of the torque within which rows explain a log equally well

Row = tuple[str, ...]
"""Names of joints that follow one another from a link of the robot on."""


@contextmanager
def _without_notes() -> Iterator[None]:
    """Do not repeat notes on the robot's file for each robot that is tried."""
    logger = logging.getLogger("consistent_id")
    before = logger.level
    logger.setLevel(logging.ERROR)
    try:
        yield
    finally:
        logger.setLevel(before)


def joint_rows(robot: RobotModel, number: int) -> tuple[Row, ...]:
    """Return the rows of so many joints, those that begin near the base first.

    Examples
    --------
    >>> from consistent_id import DHRow, from_modified_dh
    >>> arm = from_modified_dh("arm", [DHRow(0, 0), DHRow(0, 1), DHRow(0, 1)])
    >>> joint_rows(arm, 2)
    (('joint1', 'joint2'), ('joint2', 'joint3'))
    """
    driven = set(robot.joint_names)
    paths = list[Row]()
    for joint in robot.joints:
        before = paths[joint.parent] if joint.parent >= 0 else ()
        paths.append((*before, joint.name) if joint.name in driven else before)
    ends = [path for path in dict.fromkeys(paths) if len(path) >= number > 0]
    found = [(len(path) - number, path[len(path) - number :]) for path in ends]
    return tuple(dict.fromkeys(row for _, row in sorted(found, key=lambda at: at[0])))


@dataclass(frozen=True)
class LogRowsOfJoints(Mapping[int, Sequence[Row]]):
    """By number of joints, the rows that may be a log's, the likeliest first.

    All others explain the log as well as the first.

    Parameters
    ----------
    robot : RobotModel
    read : callable
        From joints at rest to the robot without them and the log, as they are read.
    """

    robot: RobotModel
    read: Callable[[Sequence[str]], tuple[RobotModel, Recording]]
    _found: dict[int, tuple[Row, ...]] = field(default_factory=dict, repr=False)

    def __len__(self) -> int:
        return len(self.robot.joint_names) - 1

    def __iter__(self) -> Iterator[int]:
        return iter(range(1, len(self.robot.joint_names)))

    def __getitem__(self, number: int) -> tuple[Row, ...]:
        if number not in self._found:
            rows = joint_rows(self.robot, number)
            if not rows:
                raise KeyError(number)
            self._found[number] = rows[:1] if len(rows) == 1 else self._compared(rows)
        return self._found[number]

    def _compared(self, rows: Sequence[Row]) -> tuple[Row, ...]:
        shares = np.array([self._share(row) for row in rows[:_MOST]])
        if not (shares > 0.0).any():
            return tuple(rows[:1])
        order = np.argsort(-shares, kind="stable")
        alike = shares[order] >= shares[order[0]] - _ALIKE
        return tuple(rows[k] for k in order[alike])

    def _share(self, row: Row) -> float:
        """Return the share of the torque that the nominal robot explains."""
        rest = [name for name in self.robot.joint_names if name not in row]
        try:
            with _without_notes():
                shares = torque_shares(*self.read(rest))
        except ConsistentIdError:
            return 0.0
        return 0.0 if shares is None else float(np.mean(shares))

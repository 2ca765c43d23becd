"""Rows of a regressor: names of those that are no joint's torque, and room for them.

Rows without names of joints are those of a floating base.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TypeVar, final

import numpy as np

from consistent_id._support.arrays import Array, IntArray, Matrix
from consistent_id.robot.model import RobotModel
from consistent_id.robot.parameters import require_known

BASE_ROWS = ("base.fx", "base.fy", "base.fz", "base.nx", "base.ny", "base.nz")
"""Force [N] on a floating base, and moment [N m] about its frame's origin, in its axes.

What acts on the robot from outside, contact forces say: zero in free flight.
"""

BASE_UNITS = dict(zip(BASE_ROWS, ("N",) * 3 + ("N m",) * 3, strict=True))
"""Units of the base rows."""

CONTACT_FREE = "contact-free"
"""The rows that no contact force enters, all of them together."""


def row_names(robot: RobotModel) -> tuple[str, ...]:
    """Return the names of all rows: of a floating base, then of the joints."""
    return (*BASE_ROWS, *robot.joint_names) if robot.floating else robot.joint_names


def rows_in_order(names: Sequence[str], robot: RobotModel) -> tuple[str, ...]:
    """Return the named rows in the robot's order, all of them for none.

    Raises
    ------
    ProblemError
        If the robot has no such row.
    """
    if not robot.connected or tuple(names) == (CONTACT_FREE,):
        return tuple(names)
    known = row_names(robot)
    if names and not robot.joint_names and not set(names) & set(known):
        return tuple(names)  # of one body alone, whose rows somebody else gives
    require_known(names, known, "torque_joints: no joint")
    return tuple(j for j in known if j in names) or known


def in_newton(robot: RobotModel, name: str) -> bool:
    """Return whether a row is a force, in N; else it is a torque, in N m."""
    if name in BASE_UNITS:
        return BASE_UNITS[name] == "N"
    slides = {joint.name for joint in robot.driven if joint.kind == "prismatic"}
    return name in slides


@final
@dataclass(frozen=True, slots=True, eq=False)
class KeptColumns:
    """Some columns of each row, written to like an array (rows, parameters, samples).

    Values written to other columns are dropped.

    Parameters
    ----------
    places : ndarray, shape (rows, parameters)
        Where a column is in its row's block; -1 if it is dropped.
    blocks : sequence of ndarray, each shape (samples, columns kept + 1)
        In Fortran's order, the last column left for the torque.
    """

    places: IntArray
    blocks: Sequence[Matrix]

    @classmethod
    def empty(cls, kept: Sequence[IntArray], width: int, samples: int) -> "KeptColumns":
        """Return rows that are to be written to."""
        places = np.full((len(kept), width), -1)
        for row, columns in zip(places, kept, strict=True):
            row[columns] = range(len(columns))
        shapes = [(samples, len(columns) + 1) for columns in kept]
        return cls(places, [np.empty(shape, order="F") for shape in shapes])

    @property
    def shape(self) -> tuple[int, int, int]:
        """Rows, parameters and samples."""
        return (*self.places.shape, len(self.blocks[0]))

    def first(self, samples: int) -> "KeptColumns":
        """Return the first samples, as a view."""
        return KeptColumns(self.places, [block[:samples] for block in self.blocks])

    def __setitem__(self, entry: tuple[int, int], values: Any) -> None:
        place = self.places[entry]
        if place >= 0:
            self.blocks[entry[0]][:, place] = values


Room = TypeVar("Room", Array, KeptColumns)
"""Where a regressor is written to: all its columns, or some."""


def shorter(out: Room, samples: int) -> Room:
    """Return room for fewer samples; an array of its own, for a view has gaps."""
    if isinstance(out, KeptColumns):
        return out.first(samples)
    return np.zeros((*out.shape[:2], samples))

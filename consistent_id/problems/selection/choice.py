"""What is chosen of a problem: drive terms, masses, cut-offs, rows, a delay."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import msgspec

from consistent_id.errors import ProblemError
from consistent_id.problems.drive_tables import exceptions
from consistent_id.problems.file import (
    CouplingTable,
    DataTable,
    DriveTable,
    JointTable,
    LinkTable,
    ProblemTable,
)
from consistent_id.robot.model import RobotModel

Masses = Literal["datasheet", "bounds", "free"]

BOUNDS = (0.5, 2.0)
"""Bounds of a bounded mass, over the model's: a factor of two either way, within which
a designer's estimate of a casting, a motor and its cables lies."""


@dataclass(frozen=True, slots=True)
class Choice:
    """One model of a robot and its log.

    Parameters
    ----------
    drive : tuple of DriveTable
        Of each joint, in the robot's order; of joints without torque, none.
    masses : {"datasheet", "bounds", "free"}
    motion_cutoff, torque_cutoff : float, optional, [Hz]
    least_speed : float, optional
        Share of top speed below which rows are left out.
    delay : float, [s]
        By which the torque comes late.
    decimate : int
        Of so many samples one is kept.
    """

    drive: tuple[DriveTable, ...]
    couplings: tuple[CouplingTable, ...] = ()
    masses: Masses = "datasheet"
    motion_cutoff: float | None = None
    torque_cutoff: float | None = None
    least_speed: float | None = None
    delay: float = 0.0
    decimate: int = 1


def data_of(table: ProblemTable) -> DataTable:
    """Return a problem file's table of recordings.

    Raises
    ------
    ProblemError
        If it has none.
    """
    if table.data is None:
        raise ProblemError(
            f"problem {table.name!r} has no recordings; a model is chosen from those "
            "for training: add a [data] table"
        )
    return table.data


def applied(table: ProblemTable, choice: Choice, robot: RobotModel) -> ProblemTable:
    """Return a problem file's content with a choice in place of its own.

    Parameters
    ----------
    table : ProblemTable
        With recordings.
    robot : RobotModel
        The file's robot.
    """
    replace = msgspec.structs.replace
    data = data_of(table)
    common, joints = _joint_tables(table, choice, robot)
    preparation = data.preparation
    if preparation.method == "butterworth":
        preparation = replace(preparation, motion_cutoff=choice.motion_cutoff)
    delays = preparation.delays | {"torque": choice.delay}
    if not choice.delay:
        del delays["torque"]
    preparation = replace(
        preparation,
        torque_cutoff=choice.torque_cutoff,
        least_speed=choice.least_speed,
        delays=delays,
        decimate=choice.decimate,
    )
    return replace(
        table,
        drive=common,
        joints=joints,
        couplings=list(choice.couplings),
        links=_link_tables(table, choice, robot),
        constraints=replace(
            table.constraints,
            masses=choice.masses,
            shared_motors=bool(choice.couplings),
        ),
        data=replace(data, preparation=preparation),
    )


def _joint_tables(
    table: ProblemTable, choice: Choice, robot: RobotModel
) -> tuple[DriveTable, dict[str, JointTable]]:
    """Return the drive that most joints have, and tables of the others."""
    measured = data_of(table).torque_joints
    names = robot.joint_names
    by_joint = dict(zip(names, choice.drive, strict=True))
    counted = Counter(by_joint[name] for name in names if name in (measured or names))
    common = counted.most_common(1)[0][0]
    joints = {}
    for name in names:
        known = table.joints.get(name)
        motor = (
            {}
            if known is None
            else {"gear_ratio": known.gear_ratio, "motor_inertia": known.motor_inertia}
        )
        own = (
            {}
            if measured and name not in measured
            else exceptions(by_joint[name], common)
        )
        if own or any(v is not None for v in motor.values()):
            joints[name] = JointTable(**own, **motor)
    return common, joints


def _link_tables(
    table: ProblemTable, choice: Choice, robot: RobotModel
) -> Mapping[str, LinkTable]:
    """Return tables of links, with bounds of masses where they are asked for."""
    if choice.masses != "bounds":
        return table.links
    links = dict(table.links)
    for link in robot.links:
        sheet = link.datasheet
        if sheet.mass_bounds is None and sheet.mass is not None:
            low, high = (float(f"{ratio * sheet.mass:.4g}") for ratio in BOUNDS)
            links[link.name] = msgspec.structs.replace(
                links.get(link.name, LinkTable()), mass_bounds=(low, high)
            )
    return links

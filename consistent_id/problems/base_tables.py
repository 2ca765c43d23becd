"""Tables of measurements beside the joints: base, contacts, wrench sensors."""

from collections.abc import Sequence
from dataclasses import fields
from typing import Annotated, Any, Literal

import msgspec
import numpy as np
from msgspec import Meta

from consistent_id._support.arrays import Vector
from consistent_id.problems.parameter_tables import FileTable, NonNegative
from consistent_id.recordings.readers.beside_columns import (
    BaseColumns,
    BesideColumns,
    ContactColumns,
    WrenchColumns,
)

ALWAYS = "always"
"""In place of a contact's column: the robot stands on that foot all the time."""

Names = str | list[str]
Four = Annotated[list[float], Meta(min_length=4, max_length=4)]


class BaseTable(FileTable, frozen=True, kw_only=True):
    """Columns of a floating base: of an inertial measurement unit, or of its pose."""

    angular_velocity: Names | None = None
    acceleration: Names | None = None
    position: Names | None = None
    orientation: Names | None = None
    order: Literal["xyzw", "wxyz"] = "xyzw"
    imu_position: tuple[float, float, float] = (0.0, 0.0, 0.0)
    imu_orientation: Four | None = None


class ContactTable(FileTable, frozen=True, kw_only=True):
    """A contact of the robot, and the column of its flag.

    For a foot on which it stands all the time `closed` is true.  Samples closer than
    the guard [s] to a change are left out.
    """

    frame: str
    closed: str | bool
    threshold: float = 0.5
    guard: NonNegative = 0.05
    point: tuple[float, float, float] = (0.0, 0.0, 0.0)
    surface: bool = False
    radius: NonNegative = 0.0


class WrenchTable(FileTable, frozen=True, kw_only=True):
    """Columns of a measured force, or of a force and a moment."""

    frame: str
    values: Names
    on_robot: bool = True
    point: tuple[float, float, float] = (0.0, 0.0, 0.0)
    axes: Literal["frame", "base", "world"] = "frame"


class WristSensorTable(FileTable, frozen=True, kw_only=True):
    """A wrench sensor whose tool or payload is identified, with its bias."""

    frame: str
    tool: str = "tool"
    bias: bool = True
    drift: Literal["none", "recordings", "linear"] = "none"


def beside_columns(
    base: BaseTable | None,
    contacts: Sequence[ContactTable],
    wrenches: Sequence[WrenchTable],
) -> BesideColumns:
    """Return the columns that tables name."""
    return BesideColumns(
        None if base is None else _base_columns(base),
        tuple(ContactColumns(**_values(table)) for table in contacts),
        tuple(WrenchColumns(**_values(table)) for table in wrenches),
    )


def _base_columns(table: BaseTable) -> BaseColumns:
    turned = table.imu_orientation
    values = _values(table) | {
        "imu_orientation": None if turned is None else tuple(turned)
    }
    return BaseColumns(**values)


def _values(table: FileTable) -> dict[str, Any]:
    """Return the fields, points as arrays."""
    named = msgspec.structs.asdict(table)
    return {k: np.array(v) if isinstance(v, tuple) else v for k, v in named.items()}


def beside_tables(columns: BesideColumns) -> dict[str, Any]:
    """Return the tables of `[data]` that name columns: ``base``, ``contacts``, ..."""
    base = columns.base
    return {
        "base": None if base is None else BaseTable(**_plain(base)),
        "contacts": [ContactTable(**_plain(c)) for c in columns.contacts],
        "wrenches": [WrenchTable(**_plain(w)) for w in columns.wrenches],
    }


def _plain(value: BaseColumns | ContactColumns | WrenchColumns) -> dict[str, Any]:
    """Return the fields, arrays and tuples as a file has them."""
    named = {field.name: getattr(value, field.name) for field in fields(value)}
    return {
        name: _numbers(v) if isinstance(v, np.ndarray) else _listed(v)
        for name, v in named.items()
    }


def _numbers(values: Vector) -> tuple[float, ...]:
    """Return numbers rounded to what a file should show."""
    return tuple(float(f"{v:.9g}") for v in values)


def _listed(value: object) -> object:
    return list(value) if isinstance(value, tuple) else value

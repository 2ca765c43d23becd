"""How the recordings of a problem file name their columns."""

from dataclasses import replace
from pathlib import Path

import msgspec

from consistent_id.problems.base_tables import beside_columns
from consistent_id.problems.file import DataTable
from consistent_id.recordings.log_formats import log_format
from consistent_id.recordings.readers import JOINT_STATE, Columns


def columns_of(data: DataTable, file: Path) -> Columns:
    """Return how a recording names its columns; by default as its format does."""
    usual = JOINT_STATE if log_format(file).holds == "joint states" else Columns()
    named = {} if data.columns is None else msgspec.structs.asdict(data.columns)
    return replace(
        usual,
        **named,
        torque_joints=data.torque_joints,
        units=data.units,
        beside=beside_columns(data.base, data.contacts, data.wrenches),
    )

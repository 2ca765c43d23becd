from consistent_id.recordings.readers.beside_columns import (
    BaseColumns,
    BesideColumns,
    ContactColumns,
    WrenchColumns,
)
from consistent_id.recordings.readers.columns import JOINT_STATE, Columns
from consistent_id.recordings.readers.data_frames import recording_from
from consistent_id.recordings.readers.recording_file import read_recording, read_track

__all__ = [
    "JOINT_STATE",
    "BaseColumns",
    "BesideColumns",
    "Columns",
    "ContactColumns",
    "WrenchColumns",
    "read_recording",
    "read_track",
    "recording_from",
]

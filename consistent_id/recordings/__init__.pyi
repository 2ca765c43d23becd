from consistent_id.recordings.beside import BaseMotion, ContactFlags, Wrench
from consistent_id.recordings.joint_paths import FourierTrajectory, harmonics_of
from consistent_id.recordings.readers import (
    JOINT_STATE,
    BaseColumns,
    BesideColumns,
    Columns,
    ContactColumns,
    WrenchColumns,
    read_recording,
    read_track,
    recording_from,
)
from consistent_id.recordings.recording import Recording

__all__ = [
    "JOINT_STATE",
    "BaseColumns",
    "BaseMotion",
    "BesideColumns",
    "Columns",
    "ContactColumns",
    "ContactFlags",
    "FourierTrajectory",
    "Recording",
    "Wrench",
    "WrenchColumns",
    "harmonics_of",
    "read_recording",
    "read_track",
    "recording_from",
]

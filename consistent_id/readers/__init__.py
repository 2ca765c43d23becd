"""Recordings from the logs that exist: tables, arrays, joint states, data frames."""

from consistent_id.readers.columns import JOINT_STATE, Columns
from consistent_id.readers.files import read_recording
from consistent_id.readers.frames import recording_from
from consistent_id.readers.tracks import read_track

__all__ = ["JOINT_STATE", "Columns", "read_recording", "read_track", "recording_from"]

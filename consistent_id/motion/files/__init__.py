"""Trajectories as files: exact ones to read again, and ones that robots play."""

from consistent_id.motion.files.trajectory_file import (
    TRAJECTORY_COLUMNS,
    read_trajectory,
    write_trajectory,
)

__all__ = ["TRAJECTORY_COLUMNS", "read_trajectory", "write_trajectory"]

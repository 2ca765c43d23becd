"""Trajectories as files: exact ones to come back to, and ones that robots play."""

from consistent_id.motion.files.files import read_trajectory, write_trajectory
from consistent_id.motion.files.tables import TRAJECTORY_COLUMNS

__all__ = ["TRAJECTORY_COLUMNS", "read_trajectory", "write_trajectory"]

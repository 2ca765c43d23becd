"""What files of trajectories have in common: their size, and what robots require."""

from pathlib import Path

import numpy as np

from consistent_id._support.inputs import read_input, require_regular
from consistent_id.errors import ProblemError
from consistent_id.recordings.paths import JointPath

_LARGEST = 256 * 2**20  # bytes; an hour of seven joints at 500 Hz is larger
_STILL = 1e-6  # velocity at rest, over the largest


def content_of(path: Path) -> bytes:
    """Return what a file holds.

    Raises
    ------
    ProblemError
        If it cannot be read, or is too large to be a trajectory.
    """
    require_size(path, require_regular(path, ProblemError))
    return read_input(path, ProblemError, _LARGEST)


def require_size(path: Path, size: int) -> None:
    """Refuse more bytes than trajectories have."""
    if size > _LARGEST:
        raise ProblemError(
            f"{path}: {size / 2**20:.0f} MiB, expected a trajectory of at most "
            f"{_LARGEST // 2**20} MiB; use read_recording for a log"
        )


def require_names(joints: tuple[str, ...], where: Path) -> None:
    """Refuse names of joints that a text file would not give back."""
    for name in joints:
        if not name or not name.isprintable() or name != name.strip():
            raise ProblemError(
                f"{where}: joint {name!r}: expected a name of printable characters "
                "without space around it; rename the joint"
            )


def require_rest(path: JointPath, where: Path) -> None:
    """Refuse a path that does not begin and end at rest, as a robot does."""
    ends = [path.start, path.start + path.duration]
    velocity = path.evaluate(ends, derivatives=1)[1]
    moving = abs(velocity) > _STILL * path.derivative_bound(1)
    if moving.any():
        k, j = (int(i) for i in np.argwhere(moving)[0])
        raise ProblemError(
            f"{where}: joint {path.joints[j]!r} moves at {velocity[k, j]:.4g} per "
            f"second at its {('start', 'end')[k]}, expected a motion from rest to "
            "rest, which a robot can follow; write move_along(trajectory, limits)"
        )

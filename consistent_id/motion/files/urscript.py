"""Programs for Universal Robots: a target for every cycle of the controller."""

from pathlib import Path

import numpy as np

from consistent_id._support.arrays import Matrix
from consistent_id.errors import ProblemError
from consistent_id.motion.files.controller_tables import cycle_of, targets_of
from consistent_id.recordings.paths import JointPath

_JOINTS = 6
_TO_START = "a=0.5, v=0.25"  # rad/s^2, rad/s: slow, since this way is not checked
_TRACKING = "0.1, 300"  # lookahead time [s] and gain, the controller's own defaults


def urscript_of(path: JointPath, rate: float, where: Path) -> str:
    """Return a program that goes to the start, and then follows a path by ``servoj``.

    Each target holds for one cycle; the last one is the end of the path, at most a
    cycle after the one before.  Targets are rounded to 1e-9 rad.

    Raises
    ------
    ProblemError
        If the robot has not six joints, or the rate is not 125 or 500 Hz.
    """
    if len(path.joints) != _JOINTS:
        raise ProblemError(
            f"{where}: {len(path.joints)} joints, expected {_JOINTS}: URScript is the "
            "language of arms with six"
        )
    cycle = cycle_of("urscript", rate)
    if cycle is None:
        raise ProblemError(
            f"{where}: rate is {rate:g} Hz, expected the controller's cycle: 125 "
            "(CB series) or 500 (e-Series)"
        )
    rate = cycle
    since, targets = targets_of(path, rate)
    lines = [
        "def consistent_id_motion():",
        "  # consistent-id: motion",
        f"  # joints {', '.join(path.joints)}",
        f"  # {len(since)} targets, one every {1.0 / rate:g} s; time in seconds behind",
        f"  movej({_list(targets[0])}, {_TO_START})",
    ]
    for time, target in zip(since, targets, strict=True):
        command = f"servoj({_list(target)}, 0, 0, {1.0 / rate:g}, {_TRACKING})"
        lines.append(f"  {command}  # {time:.3f}")
    return "\n".join([*lines, "  stopj(1.0)", "end", ""])


def _list(target: Matrix) -> str:
    # Adding zero turns -0.0 into 0.0.
    return f"[{', '.join(f'{value:.9f}' for value in np.round(target, 9) + 0.0)}]"

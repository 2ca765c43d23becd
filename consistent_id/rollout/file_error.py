"""The rollout error of an exported file, which is read back to compute it.

A file lacks what its format cannot express, such as the delay of commands; so its error
is another one than that of the estimate in it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from consistent_id.errors import ConsistentIdError
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals import PDGains
from consistent_id.rollout.commanded_motion import replay, replayable
from consistent_id.rollout.replay_model import replay_model

FILES = ("mjcf", "urdf")
"""Formats that MuJoCo reads back."""


@dataclass(frozen=True, slots=True)
class FileError:
    """Root-mean-square error of a file's rollouts [rad or m].

    Parameters
    ----------
    plain : float
        As the file is.
    delayed : float
        With the delay of commands, which the file does not have.
    delay : float, [s]
    """

    plain: float
    delayed: float
    delay: float

    def lines(self) -> list[str]:
        """Return the error and how to add the delay, for people."""
        plain = (
            "rollout error of the file, read back, with the problem's gains: "
            f"{1e3 * self.plain:.2f} mrad (mm)"
        )
        if self.delay == 0.0:
            return [plain]
        ms = 1e3 * self.delay
        return [
            f"{plain}; {1e3 * self.delayed:.2f} with commands {ms:.2f} ms late",
            "the file has no delay of commands; in Python: "
            f"n = round({self.delay:g} / model.opt.timestep); "
            "late = collections.deque([command] * (n + 1), maxlen=n + 1); in each step "
            "late.append(command), and give late[0] to the drive",
        ]


def file_error(
    file: Path,
    joints: Sequence[str],
    logs: Sequence[Recording],
    gains: PDGains,
    *,
    delay: float = 0.0,
    locked: Mapping[str, float] | None = None,
) -> FileError:
    """Return the error of a file's rollouts, read back from where it was written.

    Parameters
    ----------
    file : Path
        MJCF or URDF, as MuJoCo reads it.
    logs : sequence of Recording
        With commands, as they were logged.
    delay : float, [s]
        Delay of commands.

    Raises
    ------
    ModelError
        If MuJoCo is not installed or refuses the file.
    RecordingError
        If a log has no commands, or the motion diverges.
    """
    known = [replayable(log.of(joints)) for log in logs]
    period = min(1.0 / log.rate for log in known)
    model = replay_model(file, joints, gains, locked=locked, period=period)

    def error(late: float) -> float:
        errors = [replay(model, log, delay=late).errors for log in known]
        return float(np.sqrt((np.vstack(errors) ** 2).mean()))

    plain = error(0.0)
    return FileError(plain, error(delay) if delay else plain, delay)


def error_lines(
    form: str,
    file: Path,
    joints: Sequence[str],
    logs: Sequence[Recording],
    gains: PDGains,
    *,
    delay: float,
    locked: Mapping[str, float],
) -> list[str]:
    """Return sentences on the error of a written file; a reason if there is none."""
    if form not in FILES:
        return []
    try:
        found = file_error(file, joints, logs, gains, delay=delay, locked=locked)
    except ConsistentIdError as cause:
        return [f"the rollout error of the file is not known: {cause}"]
    return found.lines()

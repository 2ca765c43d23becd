"""Motions that a problem file gives by formulas, sampled."""

from collections.abc import Sequence

import numpy as np

from consistent_id.problems.file import MotionTable
from consistent_id.recordings.joint_paths import Sinusoid, SinusoidalMotion
from consistent_id.recordings.recording import Recording


def sampled_motion(table: MotionTable, joints: Sequence[str], name: str) -> Recording:
    """Return the recording of a motion, without torque."""
    terms = tuple(
        tuple(
            Sinusoid(*_ends(term.amplitude), term.frequency, np.radians(term.phase_deg))
            for term in of_joint
        )
        for of_joint in table.joints
    )
    motion = SinusoidalMotion(table.duration, table.rate, terms)
    return motion.recording(tuple(joints), name=name)


def _ends(amplitude: float | Sequence[float]) -> tuple[float, float]:
    if isinstance(amplitude, Sequence):
        return amplitude[0], amplitude[1]
    return amplitude, amplitude

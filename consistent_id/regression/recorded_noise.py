"""Noise along one recording, from what least squares leaves of its torque."""

import numpy as np

from consistent_id.regression.correlated_noise import (
    CorrelatedNoise,
    spectral_noise,
    white_noise,
)
from consistent_id.regression.joint_fit import JointFit
from consistent_id.regression.motion_arrays import Motion
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.row_filter import RowFilter
from consistent_id.regression.row_structure import row_structure

_ROUNDING = 1e-9
"""Residual, relative to the torque, that is rounding and has no spectrum of its own."""


def recorded_noise(
    model: TorqueModel,
    fit: JointFit,
    motion: Motion,
    centres: range,
    row_filter: RowFilter,
) -> CorrelatedNoise:
    """Return the noise that a fit leaves along a motion, of the rows at `centres`."""
    structure = row_structure(model, mixed=motion.mixing is not None)
    columns = [kept for kept, _ in structure]
    n = len(motion.q)
    of_joints = [np.empty((n, len(kept) + 1), order="F") for kept in columns]
    for part, blocks in motion.rows(model, columns):
        for rows, block in zip(of_joints, blocks, strict=True):
            rows[part] = block
    counts, found = motion.counts(centres), []
    whole = motion.noise_lost(centres)
    for j, (_, expand) in enumerate(structure):
        rows = of_joints[j]
        pieces = [row_filter(rows[piece]) for piece in row_filter.pieces(centres)]
        rows = np.vstack(pieces) if len(pieces) > 1 else pieces[0]
        residual = rows[:, -1] - rows[:, :-1] @ (expand @ fit.x)
        steps = expand @ fit.steps / fit.weights[j]
        if np.linalg.norm(residual) <= _ROUNDING * np.linalg.norm(rows[:, -1]):
            noise = white_noise(rows[:, :-1], residual)
        else:
            noise = spectral_noise(rows[:, :-1], residual, steps)
        found.append((whole[j] * noise.scores @ expand, counts[j] / noise.length))
    return CorrelatedNoise(
        np.array([max(effective, 1e-3) for _, effective in found]),
        tuple(scores for scores, _ in found),
    )

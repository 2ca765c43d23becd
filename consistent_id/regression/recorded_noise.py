"""Noise along recordings, from what least squares leaves of their torque."""

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from consistent_id._support.threads import single_threaded
from consistent_id.regression.correlated_noise import (
    CorrelatedNoise,
    joined_noise,
    spectral_noise,
    white_noise,
)
from consistent_id.regression.joint_fit import JointFit, joint_fit
from consistent_id.regression.motion_arrays import Motion
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.row_filter import RowFilter
from consistent_id.regression.row_structure import row_structure

if TYPE_CHECKING:
    from consistent_id.regression.regression import Regression

SHOWN = 2**14
"""Rows of a recording whose residuals show how noise is correlated."""

_ROUNDING = 1e-9
"""Residual, relative to the torque, that is rounding and has no spectrum of its own."""


@single_threaded
def with_noise(
    model: TorqueModel,
    regression: "Regression",
    motions: Sequence[Motion],
    kept: Sequence[range],
    row_filter: RowFilter,
    samples: Sequence[int] | None = None,
) -> "Regression":
    """Return a regression with the noise that its recordings show.

    Parameters
    ----------
    motions : sequence of Motion
        Of its recordings, or of `SHOWN` samples in the middle of each.
    kept : sequence of range
        Samples of each motion whose rows are kept.
    samples : sequence of int, optional
        Of each whole recording, where of some the middle alone is left.
    """
    fit = joint_fit(regression.factors, regression.counts)
    parts = []
    for k, (motion, rows) in enumerate(zip(motions, kept, strict=True)):
        shown = _middle(motion, rows, row_filter)
        noise = _noise_along(model, fit, *shown, row_filter)
        total = len(rows) if samples is None else samples[k]
        parts.append(noise.share(total / len(shown[1])))
    return replace(regression, noise=joined_noise(parts))


def _middle(
    motion: Motion, centres: range, row_filter: RowFilter
) -> tuple[Motion, range]:
    """Return so much of a motion's middle as shows how noise is correlated."""
    surplus = len(centres) - SHOWN
    if surplus <= 0:
        return motion, centres
    rows = centres[surplus // 2 : surplus // 2 + SHOWN]
    start, stop = rows[0] - row_filter.reach, rows[-1] + row_filter.reach + 1
    return motion.samples(start, stop), range(
        row_filter.reach, stop - start - row_filter.reach, rows.step
    )


def _noise_along(
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

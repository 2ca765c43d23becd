"""A motion compressed once, with every torque channel as a right-hand side.

A reversed, exchanged or scaled torque channel is then a combination of columns of small
triangular factors: neither motion nor regressor are looked at again.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from consistent_id._support.arrays import Array, Matrix
from consistent_id.recordings.recording import Recording
from consistent_id.regression.base import BaseParameters
from consistent_id.regression.regression import Regression, motion_of, triangle
from consistent_id.regression.regressor import CHUNK, TorqueModel

_LEAST = 1e-12  # N m or N, instead of a torque of zero, by which one could not divide


@dataclass(frozen=True, slots=True, eq=False)
class ChannelFactors:
    """Triangular factors of one motion.

    Parameters
    ----------
    model : TorqueModel
    base : BaseParameters
    factors : tuple of ndarray, each shape (rows, base + torque joints)
        Of each torque joint: its base columns, then all torque channels.
    samples : int
        Behind each factor.
    """

    model: TorqueModel
    base: BaseParameters
    factors: tuple[Matrix, ...]
    samples: int

    def least_misfit(self, change: Matrix | None = None) -> float:
        """Return the misfit of least squares, below which no constraint leads.

        Root of the mean over joints of the squared residual over the squared torque.

        Parameters
        ----------
        change : ndarray, shape (torque joints, torque joints), optional
            By which torque is multiplied from the right.
        """
        scale = np.sqrt(self.samples)
        rows = [
            np.column_stack([A, z]) / max(float(np.linalg.norm(z)) / scale, _LEAST)
            for A, z in self._systems(change)
        ]
        R = triangle(np.asfortranarray(np.vstack(rows)))
        least = abs(R[-1, -1]) if len(R) == R.shape[1] else 0.0
        return float(least / (scale * np.sqrt(len(rows))))

    def regression(self, change: Matrix | None = None) -> Regression:
        """Return the regression, each joint relative to its own torque."""
        P = self.base.projection
        bare = Regression(
            layout=self.model.layout,
            joints=self.model.torque_joints,
            factors=tuple(
                np.column_stack([A @ P, z]) for A, z in self._systems(change)
            ),
            counts=(self.samples,) * len(self.factors),
            fingerprint=self.model.fingerprint,
        )
        return bare.weighted(np.maximum(bare.torque_rms, _LEAST))

    def _systems(self, change: Matrix | None) -> Iterator[tuple[Matrix, Array]]:
        b = len(self.base)
        change = np.eye(len(self.factors)) if change is None else change
        for F, combined in zip(self.factors, change.T, strict=True):
            yield F[:, :b], F[:, b:] @ combined


def channel_factors(
    model: TorqueModel, base: BaseParameters, recordings: Sequence[Recording]
) -> list[ChannelFactors]:
    """Compress motions with all torque channels.

    Short motions are put through the regressor together, which is faster.

    Parameters
    ----------
    model : TorqueModel
    base : BaseParameters
    recordings : sequence of Recording
        With velocity, acceleration and torque.
    """
    motions = [motion_of(model, recording, None) for recording in recordings]
    longest = max((len(m.q) for m in motions), default=1)
    together = max(CHUNK // longest, 1)
    found = []
    for start in range(0, len(motions), together):
        group = motions[start : start + together]
        states = (np.concatenate(x) for x in list(zip(*group, strict=True))[:3])
        Y = model.regressor(*states)[:, list(base.independent)]
        ends = np.cumsum([len(m.q) for m in group])
        for motion, rows in zip(group, np.split(Y, ends[:-1], axis=2), strict=True):
            factors = tuple(_factor(of_joint, motion.torque) for of_joint in rows)
            found.append(ChannelFactors(model, base, factors, len(motion.q)))
    return found


def _factor(Y: Array, torque: Array) -> Matrix:
    """Return a joint's factor; columns that are zero are left out of the work."""
    b, samples = Y.shape
    kept = [*np.flatnonzero(Y.any(axis=1)), *range(b, b + torque.shape[1])]
    rows = np.empty((samples, len(kept)), order="F")
    rows[:, : -torque.shape[1]] = Y[kept[: -torque.shape[1]]].T
    rows[:, -torque.shape[1] :] = torque
    R = triangle(rows)
    factor = np.zeros((len(R), b + torque.shape[1]))
    factor[:, kept] = R
    return factor

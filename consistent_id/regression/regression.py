"""A regression compressed to triangular factors, one per joint.

The regressor is never stacked and never squared: chunks stream through a QR, so memory
does not grow with the number of samples and no digits are lost.  Factors of several
recordings add; weights of joints scale factors.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from consistent_id._support.arrays import (
    Array,
    IntArray,
    Matrix,
    Vector,
    array_default,
    freeze,
    frozen,
)
from consistent_id._support.executors import single_threaded, worker_threads
from consistent_id._support.given_values import require_type
from consistent_id._support.tables import brief
from consistent_id.errors import NotExcitedError, ProblemError
from consistent_id.recordings.recording import Recording, several
from consistent_id.regression.correlated_noise import (
    CorrelatedNoise,
    joined_noise,
    recorded_noise,
)
from consistent_id.regression.linear import extended
from consistent_id.regression.linear import triangle as triangle
from consistent_id.regression.motion_arrays import Motion
from consistent_id.regression.recorded_motion import motion_of
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.row_structure import NoisyRows, row_structure
from consistent_id.regression.shape_errors import with_shape_errors
from consistent_id.robot.parameters import ParameterLayout

_WORKERS = 2


@brief
@dataclass(frozen=True, slots=True, eq=False)
class Regression:
    """All that least squares needs of any number of samples.

    Parameters
    ----------
    layout : ParameterLayout
    joints : tuple of str
    factors : tuple of ndarray, each shape (rows, parameters + 1)
        ``F_j`` with ``||F_j [x, -1]|| = ||Y_j x - tau_j||`` for every ``x``.
    counts : tuple of int
        Samples behind each factor.
    sigma : array_like, shape (joints,) or (), optional, [N m or N]
        Noise standard deviation by which each joint's rows are divided in `stacked`;
        by default ones.
    fingerprint : str
        Fingerprint of the torque model it was built with, if known.
    noise : CorrelatedNoise, optional
        How noise behind the factors is correlated, from the residuals of least squares.
        None where no residuals were at hand: noise is then taken to be white.
    peaks : array_like, shape (joints,) or (), optional, [N m or N]
        Largest torque of each joint; by default zero: not known.

    Examples
    --------
    >>> import consistent_id as ci
    >>> arm = ci.from_modified_dh("arm", [ci.DHRow(-np.pi / 2, 0.0)])
    >>> model = ci.TorqueModel(arm, ci.DriveTerms(viscous=True))
    >>> q, dq, ddq = np.random.default_rng(0).normal(size=(3, 200, 1))
    >>> motion = ci.Recording(("joint1",), np.arange(200) / 100, q, dq, ddq)
    >>> body = [2.0, 0.6, 0, 0, 0.05, 0, 0.3, 0, 0, 0.3]  # kg, kg m, kg m^2
    >>> log = ci.simulate_torque(model, [*body, 0.4], motion)
    >>> regression = ci.build_regression(model, log)
    >>> regression.counts, [factor.shape for factor in regression.factors]
    ((200,), [(5, 12)])
    """

    layout: ParameterLayout
    joints: tuple[str, ...]
    factors: tuple[Matrix, ...]
    counts: tuple[int, ...]
    sigma: Vector = array_default(1.0)
    fingerprint: str = ""
    noise: CorrelatedNoise | None = None
    peaks: Vector = array_default(0.0)

    def __post_init__(self) -> None:
        n, width = len(self.joints), len(self.layout) + 1
        if len(self.factors) != n or len(self.counts) != n:
            raise ProblemError(f"{n} joints need {n} factors and {n} counts")
        factors = tuple(
            frozen(factor, (None, width), f"factor of {joint}")
            for joint, factor in zip(self.joints, self.factors, strict=True)
        )
        if min(self.counts) < 1:
            raise ProblemError(f"counts are {self.counts}, expected 1 sample or more")
        sigma = self.sigma if np.ndim(self.sigma) else np.full(n, self.sigma)
        sigma = frozen(sigma, (n,), "sigma")
        if not (sigma > 0.0).all():
            raise ProblemError(f"sigma is {sigma}, expected positive values")
        peaks = self.peaks if np.ndim(self.peaks) else np.full(n, self.peaks)
        peaks = frozen(peaks, (n,), "peaks")
        freeze(self, factors=factors, sigma=sigma, peaks=peaks)

    def __add__(self, other: "Regression") -> Self:
        """Merge two regressions of one torque model."""
        return self.joined((other,))

    def joined(self, others: Sequence["Regression"]) -> Self:
        """Merge with other regressions of one torque model, all at once.

        Raises
        ------
        ProblemError
            If their models or weights differ.
        """
        mine = (self.layout, self.joints, self.fingerprint)
        for other in others:
            if mine != (other.layout, other.joints, other.fingerprint):
                raise ProblemError("regressions of different models cannot be added")
            if not np.array_equal(self.sigma, other.sigma):
                raise ProblemError("regressions with different weights cannot be added")
        together: tuple[Regression, ...] = (self, *others)
        of_joints = zip(*(one.factors for one in together), strict=True)
        counts = np.sum([one.counts for one in together], axis=0)
        noises = [one.noise for one in together if one.noise is not None]
        return replace(
            self,
            factors=tuple(triangle(np.vstack(factors)) for factors in of_joints),
            counts=tuple(counts.tolist()),
            noise=joined_noise(noises) if len(noises) == len(together) else None,
            peaks=np.stack([one.peaks for one in together]).max(axis=0),
        )

    @property
    def effective(self) -> Vector:
        """Samples of white noise that determine as much as those of each joint."""
        if self.noise is None:
            return np.array(self.counts, dtype=np.float64)
        return self.noise.effective

    @property
    def correlation(self) -> Vector:
        """Samples that determine as much as one with white noise, of each joint."""
        return np.asarray(np.array(self.counts, dtype=np.float64) / self.effective)

    def weighted(self, sigma: ArrayLike) -> Self:
        """Return the regression with each joint's rows divided by its noise level."""
        return replace(self, sigma=np.atleast_1d(sigma))

    def stacked(self) -> Matrix:
        """Return one triangular factor for all joints, weights applied.

        With fewer rows than columns it has as many rows as there are.
        """
        return _stacked(self)

    def residual_rms(self, x: ArrayLike) -> Vector:
        """Root-mean-square torque residual of each joint, [N m or N], unweighted."""
        z = np.append(frozen(x, (len(self.layout),), "parameters"), -1.0)
        norms = np.array([np.linalg.norm(factor @ z) for factor in self.factors])
        return np.asarray(norms / np.sqrt(self.counts))

    def predicted_rms(self, x: ArrayLike) -> Vector:
        """Root-mean-square torque of parameters along the motion, [N m or N]."""
        z = np.append(frozen(x, (len(self.layout),), "parameters"), 0.0)
        norms = np.array([np.linalg.norm(factor @ z) for factor in self.factors])
        return np.asarray(norms / np.sqrt(self.counts))

    @property
    def torque_rms(self) -> Vector:
        """Root-mean-square torque of each joint, [N m or N]."""
        return self.residual_rms(np.zeros(len(self.layout)))


@lru_cache(maxsize=8)
def _stacked(regression: Regression) -> Matrix:
    """Return all factors as one: what is said of an estimate is computed from it."""
    pairs = zip(regression.factors, regression.sigma, strict=True)
    R = triangle(np.vstack([factor / sigma for factor, sigma in pairs]))
    R.setflags(write=False)
    return R


@single_threaded
def build_regression(
    model: TorqueModel,
    recordings: Recording | Sequence[Recording],
    *,
    row_weights: Sequence[Array] | None = None,
    noise: bool = True,
) -> Regression:
    """Compress recordings into a `Regression`.

    Where the torque of a recording is low-passed, so are its rows, and five rows are
    kept in a period of the cut-off: the equations hold exactly, also where a joint
    turns back and friction jumps.

    Parameters
    ----------
    model : TorqueModel
    recordings : Recording or sequence of Recording
        With velocity, acceleration and torque; joints are matched by name.
    row_weights : sequence of ndarray, each shape (samples, torque joints), optional
        Factors by which each row and its torque are multiplied, one array for each
        recording, in the order of the model's torque joints.  Rows of weight 0 do not
        count as samples; they are set to zero before the filter.
    noise : bool
        Find how noise is correlated, which takes another pass over the recordings.
        Parameters do not depend on it, errors and constrained estimates do.

    Raises
    ------
    RecordingError
        If a channel or a joint is missing, or a recording was changed after its torque
        had been low-passed.
    NotExcitedError
        If there is no recording.

    Examples
    --------
    >>> import consistent_id as ci
    >>> arm = ci.from_modified_dh("arm", [ci.DHRow(-np.pi / 2, 0.0)])
    >>> model = ci.TorqueModel(arm, ci.DriveTerms(viscous=True))
    >>> q, dq, ddq = np.random.default_rng(0).normal(size=(3, 200, 1))
    >>> motion = ci.Recording(("joint1",), np.arange(200) / 100, q, dq, ddq)
    >>> body = [2.0, 0.6, 0, 0, 0.05, 0, 0.3, 0, 0, 0.3]  # kg, kg m, kg m^2
    >>> log = ci.simulate_torque(model, [*body, 0.4], motion)
    >>> regression = ci.build_regression(model, log)
    >>> regression.counts, regression.residual_rms(np.array([*body, 0.4])).round(9)
    ((200,), array([0.]))
    """
    require_type(model, TorqueModel, "model")
    recordings = several(recordings)
    if not recordings:
        raise NotExcitedError("there is no recording to learn from")
    weights = _row_weights(model, recordings, row_weights)
    motions = [
        motion_of(model, recording, w)
        for recording, w in zip(recordings, weights, strict=True)
    ]
    regression = _compressed(model, motions)
    return with_noise(model, regression, motions) if noise else regression


def _row_weights(
    model: TorqueModel,
    recordings: Sequence[Recording],
    given: Sequence[Array] | None,
) -> list[Array | None]:
    """Return the weights of each recording's rows, checked; None where all are one."""
    if given is None:
        return [None] * len(recordings)
    if len(given) != len(recordings):
        raise ProblemError(
            f"row_weights for {len(given)} recordings, but there are {len(recordings)}"
        )
    rows = len(model.torque_joints)
    return [
        frozen(weights, (len(log), rows), f"row_weights of {log.name}")
        for weights, log in zip(given, recordings, strict=True)
    ]


@single_threaded
def reweighted(
    model: TorqueModel,
    motions: Sequence[Motion],
    row_weights: Sequence[Array],
    *,
    noise: bool = False,
) -> Regression:
    """Compress motions whose rows are multiplied by factors.

    For work that takes many passes; see `build_regression`.

    Parameters
    ----------
    row_weights : sequence of ndarray, each shape (samples, torque joints)
        Positive.  Rows that do not count in a motion do not count here either.
    noise : bool
        Find how noise is correlated.
    """
    weighted = [
        motion._replace(weights=w if motion.weights is None else w * motion.weights)
        for motion, w in zip(motions, row_weights, strict=True)
    ]
    regression = _compressed(model, weighted)
    return with_noise(model, regression, weighted) if noise else regression


def compressed_pieces(
    model: TorqueModel, pieces: Sequence[Recording], whole: Sequence[Recording]
) -> tuple[Regression, ...]:
    """Compress each piece of recordings by itself.

    Noise is correlated alike in all pieces: as it is in the `whole` recordings.

    Raises
    ------
    RecordingError
        If a channel or a joint is missing.
    """
    motions = [motion_of(model, recording, None) for recording in whole]
    found = [_compressed(model, [motion_of(model, p, None)]) for p in pieces]
    together = found[0].joined(found[1:])
    noise = with_noise(model, together, motions).noise
    if noise is None:
        return tuple(found)
    total = sum(together.counts)
    return tuple(replace(r, noise=noise.share(sum(r.counts) / total)) for r in found)


def with_noise(
    model: TorqueModel,
    regression: Regression,
    motions: Sequence[NoisyRows],
    samples: Sequence[int] | None = None,
) -> Regression:
    """Return a regression with the noise that its recordings show: `recorded_noise`."""
    factors, counts = regression.factors, regression.counts
    noise = recorded_noise(model, factors, counts, motions, samples)
    noise = with_shape_errors(model, factors, counts, motions, noise, samples)
    return replace(regression, noise=noise)


def _compressed(model: TorqueModel, motions: Sequence[Motion]) -> Regression:
    """Compress the rows of motions."""
    structure = row_structure(model, mixed=any(m.mixed for m in motions))
    pieces = (piece for motion in motions for piece in motion.pieces())

    def compressed(piece: Motion) -> list[Matrix]:
        return _compress(model, structure, piece)

    # NumPy and LAPACK free the interpreter's lock, so pieces run side by side; threads
    # inside a factorisation of this size make it slower, and change its last bits.
    # Pieces are merged in order, whatever the number of workers.
    merged: list[Matrix] = []
    with worker_threads(_WORKERS) as pool:
        for factors in pool.map(compressed, pieces):
            merged = (
                [triangle(np.vstack(p)) for p in zip(merged, factors, strict=True)]
                if merged
                else factors
            )
    expanded = (
        np.hstack([R[:, :-1] @ expand, R[:, -1:]])
        for R, (_, expand) in zip(merged, structure, strict=True)
    )
    counts = np.sum([motion.counts() for motion in motions], axis=0)
    if not counts.all():
        unseen = model.torque_joints[int(np.argmin(counts))]
        raise NotExcitedError(f"every row of {unseen} has the weight 0")
    return Regression(
        layout=model.layout,
        joints=model.torque_joints,
        factors=tuple(expanded),
        counts=tuple(counts.tolist()),
        fingerprint=model.fingerprint,
        peaks=np.stack([_peaks(motion) for motion in motions]).max(axis=0),
    )


def _peaks(motion: Motion) -> Vector:
    """Return the largest torque of each joint, in rows that count, [N m or N]."""
    if motion.peaks is not None:
        return motion.peaks
    counted = True if motion.weights is None else motion.weights != 0.0
    # Not of abs(torque), which takes the memory of all torques.
    highest = motion.torque.max(axis=0, where=counted, initial=0.0)
    lowest = motion.torque.min(axis=0, where=counted, initial=0.0)
    return np.asarray(np.maximum(highest, -lowest))


def _compress(
    model: TorqueModel, structure: Sequence[tuple[IntArray, Matrix]], piece: Motion
) -> list[Matrix]:
    """Return, per joint, the triangular factor of the rows of a piece of a motion."""
    columns = [kept for kept, _ in structure]
    factors = [np.zeros((0, len(kept) + 1)) for kept in columns]
    for _, blocks in piece.rows(model, columns):
        for j, rows in enumerate(blocks):
            factors[j] = extended(factors[j], rows)
    return factors

"""Correlation of noise along recordings, and its effect on least squares.

Of noise ``e`` with the spectrum ``P(f)``, the scores ``Y^T e`` of a joint's rows have
the covariance ``sum_f P(f) y(f) y(f)^H``, ``y(f)`` being the transformed rows: only
noise in the motion's frequency band affects the parameters.  A fit takes the share
``h(f)``, the leverage, of the power at each frequency; so

``P = smoothed |r(f)|^2 / smoothed (1 - h(f))``

is right on average however many parameters were fitted to however few samples, if ``P``
hardly changes within a band.  White noise has the same ``P`` everywhere.  Noise that is
strongest at the lowest frequencies, where robots move and a fit leaves little of it,
changes within the first band.  So spectra are whitened before they are smoothed
[Andrews1992]_, with the shapes ``f^-a`` from white noise to pink noise.  ``P`` is the
mean over these shapes, each of which counts by Whittle's likelihood [Whittle1953]_ in
the first eight bands.  Steeper noise is a drift, which has findings of its own.

Errors of the model move parameters farther than noise does: `model_errors` measures
how much, and `CorrelatedNoise.beyond` is the ratio.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import accumulate
from typing import NamedTuple

import numpy as np

from consistent_id._support.arrays import IntArray, Matrix, Vector
from consistent_id._support.executors import single_threaded
from consistent_id._support.singular import svd
from consistent_id._support.tables import brief
from consistent_id.regression.linear import DATA_RANK_TOLERANCE, extended, triangle
from consistent_id.regression.model_errors import (
    BLOCKS,
    LEFT,
    BlockPart,
    JointFit,
    LackingTerms,
    block_part,
    block_ratio,
    joint_fit,
    lacking_factors,
    lacking_ratio,
    lacking_terms,
)
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.row_structure import NoisyRows, joint_rows

SHOWN = 2**14
"""Rows of a recording whose residuals show how noise is correlated."""

_NO_SPECTRUM = 1e-9
"""Residual, relative to the torque, that is rounding and has no spectrum of its own."""

_BAND = 0.5
"""Frequencies over which a spectrum is averaged, in cube roots of the samples: six of a
thousand.  Wider bands miss that noise is strongest where robots move, at the lowest
frequencies; narrower ones scatter.  `benchmarks/coverage.py` shows what comes of it."""

_EXPONENTS = np.array([0.0, 0.5, 1.0])
"""Exponents ``a`` of shapes ``f^-a``: 0 is white noise, 1 is pink noise."""

_LOWEST = 8
"""Bands in which the exponent is found, from the lowest frequency on."""

_TINY = np.finfo(np.float64).tiny


@brief
@dataclass(frozen=True, slots=True, eq=False)
class CorrelatedNoise:
    """Noise behind a regression's factors.

    Parameters
    ----------
    effective : ndarray, shape (joints,)
        Samples of white noise, of the same variance, that would determine the
        parameters as well, on average.
    scores : tuple of ndarray, each shape (rows, parameters)
        ``N_j`` with ``N_j^T N_j`` the covariance of the joint's scores ``Y_j^T e_j``.
    freedom : ndarray, shape (joints,)
        Degrees of freedom of the variance in `scores`, on average over parameters; see
        `JointNoise`.
    beyond : float
        Variance of parameters with errors of the model over that by noise of these
        scores, at least one; see `model_errors`.
    shapes : tuple of ndarray, each shape (shapes, parameters)
        Scores of errors that samples share, of each joint's rows; see `shape_errors`.
        One error is the same for all joints, so their scores add.
    """

    effective: Vector
    scores: tuple[Matrix, ...]
    freedom: Vector
    beyond: float = 1.0
    shapes: tuple[Matrix, ...] = ()

    def through(self, change: Callable[[int, Matrix], Matrix]) -> "CorrelatedNoise":
        """Return the noise of other parameters: `change` is of a joint's scores."""
        scores, shapes = (
            tuple(change(j, N) for j, N in enumerate(of_joints))
            for of_joints in (self.scores, self.shapes)
        )
        return replace(self, scores=scores, shapes=shapes)

    def share(self, part: float) -> "CorrelatedNoise":
        """Return the noise behind a part of the samples, the rest being like it."""
        root = np.sqrt(part)
        return replace(
            self,
            effective=self.effective * part,
            scores=tuple(N * root for N in self.scores),
            freedom=self.freedom * part,
            shapes=tuple(N * part for N in self.shapes),
        )


def joined_noise(parts: Sequence[CorrelatedNoise]) -> CorrelatedNoise:
    """Return the noise behind several recordings, or parts of them: it adds.

    The ratio `beyond` is the mean, but not less than one: single recordings may have
    less by chance.  Errors of shapes are the same in all parts, and their scores add.
    """
    of_joints = zip(*(part.scores for part in parts), strict=True)
    samples = [float(part.effective.sum()) for part in parts]
    beyond = float(np.average([part.beyond for part in parts], weights=samples))
    shapes = [part.shapes for part in parts if part.shapes]
    most = max((len(N) for own in shapes for N in own), default=0)
    of_shapes = zip(
        *([_with_rows(N, most) for N in own] for own in shapes), strict=True
    )
    return CorrelatedNoise(
        np.sum([part.effective for part in parts], axis=0),
        tuple(_compressed(np.vstack(scores)) for scores in of_joints),
        np.sum([part.freedom for part in parts], axis=0),
        max(beyond, 1.0),
        tuple(np.sum(of_joint, axis=0) for of_joint in of_shapes),
    )


def _with_rows(N: Matrix, rows: int) -> Matrix:
    """Return shapes with rows of zeros below: the last error is not in all parts.

    Those of a model's friction come first, and a delay has only what has commands.
    """
    return np.vstack([N, np.zeros((rows - len(N), N.shape[1]))])


@single_threaded
def recorded_noise(
    model: TorqueModel,
    factors: Sequence[Matrix],
    counts: Sequence[int],
    motions: Sequence[NoisyRows],
    samples: Sequence[int] | None = None,
) -> CorrelatedNoise:
    """Return the noise behind a regression, as its recordings show it.

    Parameters
    ----------
    factors : sequence of ndarray, each shape (rows, parameters + 1)
    counts : sequence of int
        The triangular factor of each joint, and the samples behind it.
    motions : sequence of NoisyRows
        Rows of the recordings, or of `SHOWN` samples in the middle of each.
    samples : sequence of int, optional
        Number of samples of each whole recording, if only the middle of some is given.
    """
    fit = joint_fit(factors, counts)
    lacking, parts, rows = lacking_terms(model, motions), [], []
    for k, motion in enumerate(motions):
        surplus = max(len(motion.q) - SHOWN, 0)
        last = len(motion.q) - (surplus - surplus // 2)
        shown = motion.samples(surplus // 2, last)
        total = len(motion.q) if samples is None else samples[k]
        noise, beside = _noise_along(model, fit, shown, lacking)
        parts.append(noise.share(total / len(shown.q)))
        rows.append([own * np.sqrt(total / len(shown.q)) for own in beside])
    joined = joined_noise(parts)
    if not lacking:
        return joined
    level = fit.noise * np.sqrt(np.maximum(np.array(counts) / joined.effective, 1.0))
    scaled = [own / s for each in rows for own, s in zip(each, level, strict=True)]
    ratio = lacking_ratio(fit, np.vstack(scaled))
    return replace(joined, beyond=max(joined.beyond, ratio))


def _noise_along(
    model: TorqueModel,
    fit: JointFit,
    motion: NoisyRows,
    lacking: Sequence[LackingTerms],
) -> tuple[CorrelatedNoise, list[Matrix]]:
    """Return the noise that a fit leaves along a motion.

    With it come each joint's rows beside terms that the model lacks, see
    `lacking_factors`.
    """
    counts, found, beside = motion.counts(), [], []
    whole = motion.noise_lost()
    size = len(fit.x)
    gradients, normals = np.zeros((BLOCKS, size)), np.zeros((BLOCKS, size, size))
    widths = [len(each.terms.names) for each in lacking]
    starts = list(accumulate(widths, initial=0))
    for j, (rows, expand) in enumerate(joint_rows(model, motion)):
        residual = rows[:, -1] - rows[:, :-1] @ (expand @ fit.x)
        steps = expand @ fit.steps / fit.weights[j]
        if np.linalg.norm(residual) <= _NO_SPECTRUM * np.linalg.norm(rows[:, -1]):
            noise = white_noise(rows[:, :-1], residual)
        else:
            noise = spectral_noise(rows[:, :-1], residual, steps)
        scores = whole[j] * noise.scores @ expand
        found.append((scores, max(counts[j] / noise.length, 1e-3), noise.freedom))
        used = np.flatnonzero(expand.any(axis=0))
        part, E = block_part(rows[:, :-1], residual), expand[:, used] / fit.weights[j]
        gradients[:, used] += part.gradients @ E / fit.weights[j]
        normals[:, used[:, None], used] += E.T @ part.normals @ E
        own = [k for k, each in enumerate(lacking) if each.row == j]
        terms = [motion.drive_columns(*lacking[k]) for k in own]
        place = starts[own[0]] if own else 0, starts[-1]
        if lacking:
            beside.append(lacking_factors(fit, rows, expand, terms, place))
    of_joints, effective, freedom = zip(*found, strict=True)
    # Where contact forces are taken out, rows share their noise: `whole` adds the other
    # rows' part of it to the scores of single rows.  Sums over rows contain it already.
    ratio = block_ratio(fit, BlockPart(gradients, normals), of_joints)
    along = CorrelatedNoise(np.array(effective), of_joints, np.array(freedom), ratio)
    return along, beside


def scores_along(
    model: TorqueModel,
    motions: Sequence[NoisyRows],
    residuals: Sequence[Matrix],
    columns: IntArray,
    steps: Sequence[Matrix],
) -> tuple[Matrix, ...]:
    """Return factors of the covariance of the scores of any residuals.

    They may be those of rows that are not the fit's own, such as instruments, or
    residuals cut at a bound.

    Parameters
    ----------
    motions : sequence of NoisyRows
    residuals : sequence of ndarray, each shape (rows, joints)
        One for each motion.
    columns : ndarray of int
        Columns of the regressor.
    steps : sequence of ndarray, each shape (columns, rank)
        Rows of each joint, times these, are the joint's rows of an orthonormal basis
        of the fit.

    Returns
    -------
    tuple of ndarray, each shape (rows, columns)
        ``N_j`` with ``N_j^T N_j`` the covariance of ``Y_j^T r_j``.
    """
    found: list[list[Matrix]] = [[] for _ in steps]
    for motion, residual in zip(motions, residuals, strict=True):
        total = len(motion.q)
        first = max(total - SHOWN, 0) // 2
        shown = motion.samples(first, min(first + SHOWN, total))
        n = len(shown.q)
        whole = shown.noise_lost() * np.sqrt(total / n)
        for j, (rows, expand) in enumerate(joint_rows(model, shown)):
            places = expand[:, columns]
            r = np.asarray(residual[first : first + n, j])
            noise = spectral_noise(rows[:, :-1], r, places @ steps[j])
            found[j].append(whole[j] * noise.scores @ places)
    return tuple(_compressed(np.vstack(scores)) for scores in found)


@dataclass(frozen=True, slots=True, eq=False)
class JointNoise:
    """One joint's noise along one recording.

    Parameters
    ----------
    scores : ndarray, shape (rows, columns)
        Factor of the covariance of the scores.
    length : float
        How many times as large as under white noise of the same variance the variance
        of parameters is, on average.
    freedom : float
        Degrees of freedom of that variance: ``2 mean^2 / variance`` of the estimate.
        They are few, because parameters depend on a few low frequencies.  That the
        spectrum's shape is uncertain there is part of the variance.
    """

    scores: Matrix
    length: float
    freedom: float


def spectral_noise(rows: Matrix, residual: Vector, steps: Matrix) -> JointNoise:
    """Find how noise that left a residual moves the scores of rows.

    Parameters
    ----------
    rows : ndarray, shape (samples, columns)
        At equal steps of time.
    residual : ndarray, shape (samples,), [N m or N]
    steps : ndarray, shape (columns, rank)
        ``rows @ steps`` are the joint's rows of an orthonormal basis of the fit.
    """
    n = len(rows)
    r = np.fft.rfft(residual) / np.sqrt(n)
    y = _spectra(rows) / np.sqrt(n)
    # All but the ends of half a spectrum stand for two frequencies.
    twice = np.full(len(r), 2.0)
    twice[0] = 1.0
    if n % 2 == 0:
        twice[-1] = 1.0
    # Only the norms of rows of `y @ steps` count: a triangle leaves them as they are.
    fitted = y @ triangle(np.array(steps.T, order="F")).T
    leverage = np.einsum("fr,fr->f", fitted, fitted).reshape(2, -1).sum(axis=0)
    width = int(_BAND * np.cbrt(n)) + 1
    spectrum = _spectrum(abs(r) ** 2, leverage, width)
    power = spectrum.chances @ spectrum.powers
    mean = float(np.average(power, weights=twice))
    spent = float(twice @ leverage)
    felt = float((twice * leverage) @ power)
    # The variance is a sum of |r|^2 with these weights, for each of all frequencies.
    weights = _spread(twice * leverage * spectrum.weights, width)
    shares = weights / twice * power
    gram = fitted.T @ (np.tile(twice * shares, 2)[:, None] * fitted)
    expected = float((twice * (1.0 - leverage)) @ shares)
    variance = 2.0 * float((twice * (1.0 - 2.0 * leverage)) @ shares**2)
    variance += 2.0 * float(np.sum(gram**2))
    uncertain = variance / expected**2 if expected > 0.0 else 0.0
    if felt > 0.0:
        of_shapes = spectrum.powers @ (twice * leverage) / felt
        uncertain += float(spectrum.chances @ (of_shapes - 1.0) ** 2)
    y *= np.tile(np.sqrt(twice * power), 2)[:, None]
    return JointNoise(
        scores=_compressed(y),
        length=felt / (spent * mean) if spent * mean > 0.0 else 1.0,
        freedom=max(2.0 / uncertain, 1.0) if uncertain > 0.0 else float(n),
    )


class _NoiseSpectrum(NamedTuple):
    """Spectra of noise by the shape that they may have.

    Parameters
    ----------
    powers : ndarray, shape (shapes, frequencies)
    chances : ndarray, shape (shapes,)
        Probabilities of the shapes.
    weights : ndarray, shape (frequencies,)
        Factors by which means of ``|r|^2`` over a band are multiplied, on average over
        shapes.
    """

    powers: Matrix
    chances: Vector
    weights: Vector


def _spectrum(squares: Vector, leverage: Vector, width: int) -> _NoiseSpectrum:
    """Estimate the spectrum of noise from ``|r|^2`` and the leverage.

    Parameters
    ----------
    squares, leverage : ndarray, shape (frequencies,)
    width : int
        Frequencies of a band.
    """
    left = 1.0 - leverage
    last = min(_LOWEST * width, len(squares))
    # The band of zero frequency, where a shape is infinite, ends at half of the next.
    places = np.maximum(np.arange(len(squares)), 0.5)
    shapes = np.minimum(places, max(last - 1, 1)) ** -_EXPONENTS[:, None]
    means = _smoothed(squares, width)
    lost = np.array(
        [
            np.maximum(_smoothed(s * left, width), LEFT * _smoothed(s, width)) / s
            for s in shapes
        ]
    )
    low = slice(1, last)
    expected = shapes[:, low] * np.maximum(left[low], LEFT)
    ratios = squares[low] / expected
    spare = np.maximum(left[low], 0.0)
    levels = np.maximum(ratios @ spare / max(spare.sum(), _TINY), _TINY)
    # Whittle's likelihood at each shape's best level.
    likelihood = -(np.log(levels[:, None] * expected) @ spare)
    chances = np.exp(likelihood - likelihood.max())
    chances /= chances.sum()
    return _NoiseSpectrum(means / lost, chances, chances @ (1.0 / lost))


def spectral_errors(parts: Sequence[Matrix], prior: Matrix | None = None) -> Vector:
    """Return standard errors of least squares, noise being as correlated as residuals.

    Parameters
    ----------
    parts : sequence of ndarray, each shape (samples, columns + 1)
        Rows of one joint along one recording, divided by its noise, torque last.
    prior : ndarray, shape (rows, columns + 1), optional
        Rows whose errors are independent, of unit variance.

    Returns
    -------
    ndarray, shape (columns,)
        Those of the smallest solution where the rows do not determine all columns.
    """
    width = parts[0].shape[1] - 1
    known = np.zeros((0, width + 1)) if prior is None else prior
    R = np.zeros((0, width + 1))
    for rows in (known, *parts):
        R = extended(R, np.array(rows, order="F"))
    sizes = np.linalg.norm(R[:, :-1], axis=0)
    sizes = np.where(sizes > 0.0, sizes, 1.0)
    U, s, Vt = svd(R[:, :-1] / sizes, full_matrices=False)
    kept = s > DATA_RANK_TOLERANCE * s.max(initial=0.0)
    steps = Vt[kept].T / s[kept] / sizes[:, None]
    x = steps @ (U[:, kept].T @ R[:, -1])
    found = [known[:, :-1] @ steps @ steps.T]
    for rows in parts:
        A, residual = rows[:, :-1], rows[:, -1] - rows[:, :-1] @ x
        found.append(spectral_noise(A, residual, steps).scores @ steps @ steps.T)
    return np.asarray(np.linalg.norm(np.vstack(found), axis=0))


def _spectra(rows: Matrix) -> Matrix:
    """Return real parts, and imaginary ones below, of each column's spectrum."""
    spectra = np.fft.rfft(rows.T, axis=1)
    return np.concatenate([spectra.real, spectra.imag], axis=1).T


def _smoothed(spectrum: Vector, width: int) -> Vector:
    """Return running means over `width` frequencies, reflected at both ends."""
    width = min(width, len(spectrum))
    padded = spectrum[_reflected(len(spectrum), width)]
    sums = np.cumsum(np.append(0.0, padded))
    return np.asarray((sums[width:] - sums[:-width]) / width)


def _spread(weights: Vector, width: int) -> Vector:
    """Return the weights of a spectrum, from those of its running means."""
    n = len(weights)
    width = min(width, n)
    each = np.convolve(weights, np.full(width, 1.0 / width))
    sums = np.bincount(_reflected(n, width), weights=each, minlength=n)
    return sums.astype(np.float64)


def _reflected(n: int, width: int) -> IntArray:
    """Return the places of a spectrum of `n`, reflected at both ends."""
    before = (width - 1) // 2
    return np.pad(np.arange(n), (before, width - 1 - before), mode="symmetric")


def white_noise(rows: Matrix, residual: Vector) -> JointNoise:
    """Return noise with the residual's variance that is not correlated."""
    rms = float(np.sqrt(np.mean(residual**2)))
    return JointNoise(_compressed(rows * rms), 1.0, float(len(residual)))


def _compressed(rows: Matrix) -> Matrix:
    """Return the triangular factor of rows, destroying them."""
    return extended(np.zeros((0, rows.shape[1])), np.asfortranarray(rows))

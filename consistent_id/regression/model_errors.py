"""The effect of the model's errors on parameters, relative to that of noise.

A fit absorbs much of the model's errors, so its residuals show less than their effect
on parameters.  Two measures of it are ratios of variances, that with errors of the
model over that by noise; the larger one counts, and each is about one under noise.

Shifts within a recording.  It is cut into `BLOCKS`, ``n``.  A block has the scores
``y_b`` and the share ``L_b`` of the information.  Without it, parameters change by
``(1 - L_b)^-1 y_b``; the sum of these squares times ``(n - 1) / n`` is the variance of
a jackknife [Efron1982]_, which contains shifts of the parameters from block to block.
Blocks of short recordings have unequal information, so that noise alone makes it
larger than its own variance [Bell2002]_: with the covariance of ``y_b`` under white
noise, ``L_b (1 - L_b)``, this is computed, and subtracted.  If a fit is to several
recordings, this one has the share ``A``, the sum of ``L_b``, of the information, and
the sum of ``y_b`` is not zero.  Their mean is subtracted, in the covariance as well,
since scatter between recordings is found otherwise.

Terms that the model lacks.  Friction and springs that any joint may have are added to
the model.  Their coefficients explain the squares ``W``, in units of noise; ``k`` of
them explain ``k`` by noise alone.  The parameters move by ``d`` with them
[Hausman1978]_, of which ``1 - k / W`` is not noise [James1961]_.  So the variance is
``1 + (1 - k / W) d^2 / s^2`` times that by noise, ``s^2``, the median over parameters.
Terms that resemble the model's own move parameters far by noise as well, so they count
only if noise alone explains ``W`` with a chance of at most 2 %.  They are not added to
the estimate: a term that helps it would have been selected.
"""

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from consistent_id._support.arrays import Array, Matrix, Vector
from consistent_id._support.singular import singular_values, svd
from consistent_id.regression.drive.drive_terms import DriveTerms
from consistent_id.regression.drive.laws import (
    Coulomb,
    Drag,
    FrictionSlope,
    Offset,
    RotorInertia,
    Spring,
    Stribeck,
    Viscous,
)
from consistent_id.regression.drive.term import DriveTerm
from consistent_id.regression.linear import DATA_RANK_TOLERANCE, triangle
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.row_structure import NoisyRows

BLOCKS = 10
"""Blocks of a recording whose scores show errors of the model: fewer scatter, more are
as short as the noise's correlation."""

LEFT = 0.05
"""Least share of its data that a fit is assumed to leave as residuals."""

_MEDIAN = 0.927
"""Median of ``chi^2 / n`` for the ``n = BLOCKS - 1`` freedoms of a variance."""

_MEDIAN_ONE = 0.455
"""Median of ``chi^2`` with one degree of freedom."""

_RANKED = 1e-20  # variance, over the largest, that counts as none
_ROUNDS = 3  # of weights and solution; joints' levels settle to a few per cent
_EXACT = 1e-6  # residual, relative to the torque, that counts as none
_FADING = 0.2  # of a joint's RMS speed, at which friction at rest fades
_SHARP = 0.05  # the same, at which dry friction changes its sign
_BY_CHANCE = 0.02  # chance that noise alone explains as much, below which terms count
_BEYOND = 1e-2  # least part of a term that the model's own columns must leave


class JointFit(NamedTuple):
    """A fit whose residuals show each joint's noise.

    Parameters
    ----------
    x : ndarray, shape (parameters,)
        The smallest solution.
    noise : ndarray, shape (joints,), [N m or N]
        RMS residual, or a millionth of the torque.
    weights : ndarray, shape (joints,), [N m or N]
        By which rows were divided.
    steps : ndarray, shape (parameters, rank)
        All rows so divided, times these, are orthonormal.
    """

    x: Vector
    noise: Vector
    weights: Vector
    steps: Matrix


def joint_fit(factors: Sequence[Matrix], counts: Sequence[int]) -> JointFit:
    """Fit parameters to the triangular factors of joints.

    Weights and solution alternate, from weights of one.  Rank is decided on unit
    columns.
    """
    width = factors[0].shape[1]
    size = np.sqrt(counts)
    torque = np.array([np.linalg.norm(F[:, -1]) for F in factors]) / size
    floor = _EXACT * np.maximum(torque, _EXACT * (torque.max() or 1.0))
    noise = np.ones(len(factors))
    for _ in range(_ROUNDS):
        weights = noise
        rows = np.vstack([F / s for F, s in zip(factors, weights, strict=True)])
        norms = np.linalg.norm(rows[:, :-1], axis=0)
        # LAPACK's fast SVD may not converge where columns are zero: they are left out.
        kept = np.flatnonzero(norms > DATA_RANK_TOLERANCE * norms.max())
        R = triangle(np.asfortranarray(rows[:, [*kept, -1]]))
        U, s, Vt = svd(R[:, :-1] / norms[kept], full_matrices=False)
        rank = int((s > DATA_RANK_TOLERANCE * s.max(initial=1e-300)).sum())
        steps = np.zeros((width - 1, rank))
        steps[kept] = (Vt[:rank].T / s[:rank]) / norms[kept, None]
        x = steps @ (U[:, :rank].T @ R[:, -1])
        z = np.append(x, -1.0).reshape(width)
        rest = np.array([np.linalg.norm(F @ z) for F in factors]) / size
        noise = np.maximum(rest, floor)
    return JointFit(x, noise, weights, steps)


class BlockPart(NamedTuple):
    """Scores and information in `BLOCKS` of a recording.

    Parameters
    ----------
    gradients : ndarray, shape (blocks, columns)
        Scores ``Y^T r`` of each block's residuals.
    normals : ndarray, shape (blocks, columns, columns)
        ``Y^T Y`` of each block.
    """

    gradients: Matrix
    normals: Array


def block_part(rows: Matrix, residual: Vector) -> BlockPart:
    """Return the scores of one joint's rows, block by block.

    Parameters
    ----------
    rows : ndarray, shape (samples, columns)
    residual : ndarray, shape (samples,), [N m or N]
    """
    ends = np.linspace(0, len(rows), BLOCKS + 1).astype(int)
    runs = [slice(first, last) for first, last in pairwise(ends)]
    return BlockPart(
        np.array([rows[run].T @ residual[run] for run in runs]),
        np.array([rows[run].T @ rows[run] for run in runs]),
    )


def block_ratio(fit: JointFit, sums: BlockPart, scores: Sequence[Matrix]) -> float:
    """Return the parameters' variance between blocks over that of noise.

    It is one on average where there is nothing but noise, and may be less by chance.

    Parameters
    ----------
    fit : JointFit
        To this recording, or to others besides.
    sums : BlockPart
        Of all joints, each divided by its weight.
    scores : sequence of ndarray, each shape (rows, parameters)
        See `CorrelatedNoise`.
    """
    steps = fit.steps
    y = (sums.gradients - sums.gradients.mean(axis=0)) @ steps
    shares = steps.T @ sums.normals @ steps
    one = np.eye(steps.shape[1])
    without = np.linalg.inv(one - (1.0 - LEFT) * shares)
    left = (without @ y[:, :, None])[:, :, 0]
    rows = [N @ steps / s**2 for N, s in zip(scores, fit.weights, strict=True)]
    by_noise, between = (
        np.sum(np.square(part @ steps.T), axis=0) for part in (np.vstack(rows), left)
    )
    known = by_noise > _RANKED * by_noise.max(initial=0.0)
    if not known.any():
        return 1.0
    share = (BLOCKS - 1) / BLOCKS
    # Of white noise of unit variance, of which this recording gives the parameters the
    # covariance S A S^T.
    S, A = steps[known], shares.sum(axis=0)
    elsewhere = shares @ (one - A) / BLOCKS
    covariances = shares - shares @ shares - elsewhere - np.swapaxes(elsewhere, 1, 2)
    covariances += A @ (one - A) / BLOCKS**2
    expected = np.sum(without @ covariances @ without, axis=0)
    of_white = np.einsum("pi,ij,pj->p", S, expected, S)
    by_white = of_white / np.einsum("pi,ij,pj->p", S, A, S)
    ratio = share * (between[known] / by_noise[known] - by_white) + 1.0
    return float(np.median(ratio)) / _MEDIAN


class LackingTerms(NamedTuple):
    """Terms that a joint's model lacks, the joint's place, and that of its row."""

    terms: DriveTerms
    joint: int
    row: int


def lacking_terms(
    model: TorqueModel, motions: Sequence[NoisyRows]
) -> tuple[LackingTerms, ...]:
    """Return the terms that each joint may have and the model lacks.

    Where contact forces are taken out, rows are mixed, and nothing is returned.
    """
    if any(motion.mixed for motion in motions):
        return ()
    squares = np.sum([np.sum(motion.dq**2, axis=0) for motion in motions], axis=0)
    speeds = np.sqrt(squares / sum(len(motion.q) for motion in motions))
    places = {name: row for row, name in enumerate(model.torque_joints)}
    found = []
    for joint, (name, own) in enumerate(
        zip(model.robot.joint_names, model.terms, strict=True)
    ):
        lacking = _lacking(own, float(speeds[joint]))
        if name in places and speeds[joint] > 0.0 and lacking:
            found.append(LackingTerms(DriveTerms(terms=lacking), joint, places[name]))
    return tuple(found)


def _lacking(own: DriveTerms, speed: float) -> list[DriveTerm]:
    """Return terms that a joint may have beside its own; it moves at a mean speed."""
    options, names = own.options, set(own.names)
    width = options["velocity_scale"]
    laws: list[DriveTerm] = [Viscous(), Drag(), Spring(), RotorInertia()]
    if not options["asymmetric"]:
        laws.append(Offset())
    if options["coulomb"] == "none":
        laws.append(Coulomb(_SHARP * speed))
    else:
        laws += [
            FrictionSlope(width),
            Stribeck(_FADING * speed, velocity_scale=width),
        ]
    return [law for law in laws if not names & set(law.names)]


def lacking_factors(
    fit: JointFit,
    rows: Matrix,
    expand: Matrix,
    terms: Sequence[Matrix],
    before: Sequence[int],
) -> Matrix:
    """Return the triangular factor of one joint's rows beside terms that it lacks.

    Parameters
    ----------
    fit : JointFit
    rows, expand
        See `joint_rows`.
    terms : sequence of ndarray, each shape (samples, columns)
        Columns of terms of this row.
    before : sequence of int
        Where these columns begin among those of all joints, and how many all are.

    Returns
    -------
    ndarray, shape (any, rank + columns of all joints + 1)
        Of the fit's steps, all terms and the torque.
    """
    start, total = before
    own = sum(Z.shape[1] for Z in terms)
    whole = triangle(
        np.asfortranarray(np.column_stack([rows[:, :-1], *terms, rows[:, -1]]))
    )
    width, rank = rows.shape[1] - 1, fit.steps.shape[1]
    found = np.zeros((len(whole), rank + total + 1))
    found[:, :rank] = whole[:, :width] @ (expand @ fit.steps)
    found[:, rank + start : rank + start + own] = whole[:, width:-1]
    found[:, -1] = whole[:, -1]
    return found


def lacking_ratio(fit: JointFit, rows: Matrix) -> float:
    """Return the variance of parameters with errors of the model over that by noise.

    Parameters
    ----------
    fit : JointFit
    rows : ndarray, shape (any, rank + columns + 1)
        See `lacking_factors`; all joints', each divided by its noise.
    """
    from scipy.special import chdtri

    rank = fit.steps.shape[1]
    sizes = np.linalg.norm(rows, axis=0)
    kept = rank + np.flatnonzero(sizes[rank:-1] > 0.0)
    if not kept.size or not rank:
        return 1.0
    R = triangle(
        np.asfortranarray(
            np.column_stack([rows[:, :rank], rows[:, kept] / sizes[kept], rows[:, -1]])
        )
    )
    # What the model's own columns leave of the terms, and of the torque.
    U, s, Vt = svd(R[rank:-1, rank:-1])
    beyond = s > _BEYOND
    explained = (U.T @ R[rank:-1, -1])[: len(s)][beyond]
    W, k = float(explained @ explained), int(beyond.sum())
    own = singular_values(R[:rank, :rank])
    by_noise_alone = chdtri(k, _BY_CHANCE) if k else np.inf
    if W <= by_noise_alone or own.min() <= DATA_RANK_TOLERANCE * own.max():
        return 1.0
    coefficients = Vt[: len(s)][beyond].T @ (explained / s[beyond])
    moved = fit.steps @ np.linalg.solve(
        R[:rank, :rank], R[:rank, rank:-1] @ coefficients
    )
    by_noise = np.sum(np.linalg.solve(R[:rank, :rank].T, fit.steps.T) ** 2, axis=0)
    known = by_noise > _RANKED * by_noise.max(initial=0.0)
    squares = float(np.median(moved[known] ** 2 / by_noise[known])) / _MEDIAN_ONE
    return 1.0 + (1.0 - k / W) * squares

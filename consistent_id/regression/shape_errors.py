"""Errors of parameters by what all samples share: Stribeck velocities, and a delay.

Stribeck friction fades at a speed that is stated, or chosen from a few values.  A speed
that is wrong by a factor ``exp(d)`` leaves the torque ``c d``, where ``c`` is the
change of the friction with the logarithm of the speed.  Least squares then moves by
``d (Y^T Y)^-1 Y^T c``.  As for noise, this is known from scores, ``d Y^T c``.

The rows themselves say how large ``d`` is.  In units of noise, other columns do not
explain the part ``M = |c - Y (Y^T Y)^-1 Y^T c|^2`` of ``c``, and least squares leaves
the residual ``r``.  Before the rows are seen, ``d`` is normal with the standard
deviation ``log(FACTOR)``.  Given them, its mean is ``m = c^T r s^2``, and its variance
is ``s^2 = 1 / (M + 1 / log(FACTOR)^2)``.  So ``d`` is taken to be of the size
``sqrt(m^2 + s^2)``.

A delay of commands shifts the torque likewise, see `Recording.torque_shift`.  Whoever
found the delay knows its error, so the rows are not asked again.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from consistent_id._support.arrays import Array, Matrix, Vector
from consistent_id._support.executors import single_threaded
from consistent_id.regression.correlated_noise import SHOWN, CorrelatedNoise
from consistent_id.regression.drive.drive_terms import DriveTerms
from consistent_id.regression.drive.laws import Stribeck
from consistent_id.regression.model_errors import JointFit, joint_fit
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.row_structure import NoisyRows, joint_rows

FACTOR = 2.0
"""Factor within which Stribeck velocities are known before rows are seen, as a standard
deviation: values that a selection tries are as far apart."""

_STEP = 1e-4  # of the logarithm of a speed, for differences


class _Fading(NamedTuple):
    """A joint's Stribeck friction: its row, its place in the layout, and the law."""

    joint: int
    row: int
    place: int
    law: Stribeck


@single_threaded
def with_shape_errors(
    model: TorqueModel,
    factors: Sequence[Matrix],
    counts: Sequence[int],
    motions: Sequence[NoisyRows],
    noise: CorrelatedNoise,
    samples: Sequence[int] | None = None,
) -> CorrelatedNoise:
    """Return noise with the scores of errors that all samples share.

    Those of Stribeck velocities, and of the delay of commands.  Where contact forces
    are taken out, rows are mixed, and there are none of velocities.

    Parameters
    ----------
    model, factors, counts, motions, samples
        See `recorded_noise`.
    noise : CorrelatedNoise
        Of these rows.
    """
    every = _fading(model)
    fading = [] if any(motion.mixed for motion in motions) else every
    late = any(motion.shifted(0) is not None for motion in motions)
    if not (fading or late):
        return noise
    fit = joint_fit(factors, counts)
    totals = [len(m.q) for m in motions] if samples is None else samples
    sums = [
        _moments(model, motion, total, fit, fading)
        for motion, total in zip(motions, totals, strict=True)
    ]
    scores, inner, rest, shifts = (
        np.sum(part, axis=0) for part in zip(*sums, strict=True)
    )
    longer = np.maximum(np.array(counts) / noise.effective, 1.0)
    rows = [each.row for each in fading]
    scores *= _sizes(fit, longer, rows, scores, inner, rest)[:, None]
    own = [
        np.where(np.equal(rows, j)[:, None], scores, 0.0) for j in range(len(counts))
    ]
    if late:  # the last of all, in mixed rows as well: `joined_noise`
        blank = np.zeros((len(every) - len(fading), len(fit.x)))
        own = [np.vstack([N, blank, s]) for N, s in zip(own, shifts, strict=True)]
    shapes = (N * weight for N, weight in zip(own, fit.weights, strict=True))
    return replace(noise, shapes=tuple(shapes))


def _sizes(
    fit: JointFit,
    longer: Vector,
    rows: Sequence[int],
    scores: Matrix,
    inner: Matrix,
    rest: Vector,
) -> Vector:
    """Return how large errors of logarithms of Stribeck velocities are.

    Parameters
    ----------
    longer : ndarray, shape (joints,)
        Samples over those of white noise.
    rows : sequence of int
        The row of each velocity.
    scores, inner, rest : ndarray
        See `_moments`.
    """
    steps = scores @ fit.steps / fit.weights[rows, None]
    left = inner - steps @ steps.T
    level = np.sqrt(longer[rows]) * fit.noise[rows] / fit.weights[rows]
    known = left / np.outer(level, level) + np.eye(len(rows)) / np.log(FACTOR) ** 2
    spread = np.linalg.inv(known)
    mean = spread @ (rest / level**2)
    return np.sqrt(np.diag(spread) + mean**2)


def _fading(model: TorqueModel) -> list[_Fading]:
    """Return the Stribeck friction of joints that have a row."""
    names, places = model.robot.joint_names, model.torque_joints
    return [
        _Fading(j, places.index(name), model.layout.index(f"{name}.stribeck"), law)
        for j, (name, terms) in enumerate(zip(names, model.terms, strict=True))
        if name in places
        for law in terms.terms
        if isinstance(law, Stribeck)
    ]


def _moments(
    model: TorqueModel,
    motion: NoisyRows,
    total: int,
    fit: JointFit,
    fading: Sequence[_Fading],
) -> tuple[Matrix, Matrix, Vector, Array]:
    """Return products of the changes of friction along a motion, in units of weights.

    With all columns, with each other, and with the residuals; and the products of each
    joint's shift of torque with all columns, shape (joints, 1, parameters).
    """
    surplus = max(len(motion.q) - SHOWN, 0)
    last = len(motion.q) - (surplus - surplus // 2)
    shown = motion.samples(surplus // 2, last)
    scores = np.zeros((len(fading), len(fit.x)))
    inner, rest = np.zeros((len(fading), len(fading))), np.zeros(len(fading))
    shifts = np.zeros((len(fit.weights), 1, len(fit.x)))
    for j, (rows, expand) in enumerate(joint_rows(model, shown)):
        own = [k for k, each in enumerate(fading) if each.row == j]
        weight = fit.weights[j]
        shift = shown.shifted(j)
        if shift is not None:
            shifts[j] = shift @ rows[:, :-1] @ expand / weight
        if not own:
            continue
        residual = rows[:, -1] - rows[:, :-1] @ (expand @ fit.x)
        changes = np.column_stack([_change(shown, fading[k], fit.x) for k in own])
        scores[own] = changes.T @ rows[:, :-1] @ expand / weight
        inner[np.ix_(own, own)] = changes.T @ changes / weight**2
        rest[own] = changes.T @ residual / weight**2
    part = total / len(shown.q)
    return scores * part, inner * part, rest * part, shifts * part


def _change(motion: NoisyRows, fading: _Fading, x: Vector) -> Vector:
    """Return a friction's change with the logarithm of its speed, [N m or N]."""
    law = fading.law
    more, less = (
        replace(law, stribeck_velocity=law.stribeck_velocity * np.exp(step))
        for step in (_STEP, -_STEP)
    )
    high, low = (
        motion.drive_columns(DriveTerms(terms=[each]), fading.joint, fading.row)[:, 0]
        for each in (more, less)
    )
    return np.asarray((high - low) * (x[fading.place] / (2.0 * _STEP)))

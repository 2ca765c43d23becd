"""Errors of parameters from Stribeck velocities that are not exactly known.

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
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from consistent_id._support.arrays import Matrix, Vector
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
    """Return noise with the scores of errors of Stribeck velocities.

    Where contact forces are taken out, rows are mixed, and there are none.

    Parameters
    ----------
    model, factors, counts, motions, samples
        See `recorded_noise`.
    noise : CorrelatedNoise
        Of these rows.
    """
    fading = _fading(model)
    if not fading or any(motion.mixed for motion in motions):
        return noise
    fit = joint_fit(factors, counts)
    totals = [len(m.q) for m in motions] if samples is None else samples
    sums = [
        _moments(model, motion, total, fit, fading)
        for motion, total in zip(motions, totals, strict=True)
    ]
    scores, inner, rest = (np.sum(part, axis=0) for part in zip(*sums, strict=True))
    rows = [each.row for each in fading]
    weights = fit.weights[rows, None]
    steps = scores @ fit.steps / weights
    left = inner - steps @ steps.T
    longer = np.maximum(np.array(counts) / noise.effective, 1.0)[rows]
    level = np.sqrt(longer) * fit.noise[rows] / fit.weights[rows]
    known = left / np.outer(level, level) + np.eye(len(rows)) / np.log(FACTOR) ** 2
    spread = np.linalg.inv(known)
    mean = spread @ (rest / level**2)
    size = np.sqrt(np.diag(spread) + mean**2)
    shapes = scores * weights * size[:, None]
    of_joints = (shapes[np.equal(rows, j)] for j in range(len(counts)))
    return replace(noise, shapes=tuple(of_joints))


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
) -> tuple[Matrix, Matrix, Vector]:
    """Return products of the changes of friction along a motion.

    With all columns, with each other, and with the residuals, in units of weights.
    """
    surplus = max(len(motion.q) - SHOWN, 0)
    last = len(motion.q) - (surplus - surplus // 2)
    shown = motion.samples(surplus // 2, last)
    scores = np.zeros((len(fading), len(fit.x)))
    inner, rest = np.zeros((len(fading), len(fading))), np.zeros(len(fading))
    for j, (rows, expand) in enumerate(joint_rows(model, shown)):
        own = [k for k, each in enumerate(fading) if each.row == j]
        if not own:
            continue
        weight = fit.weights[j]
        residual = rows[:, -1] - rows[:, :-1] @ (expand @ fit.x)
        changes = np.column_stack([_change(shown, fading[k], fit.x) for k in own])
        scores[own] = changes.T @ rows[:, :-1] @ expand / weight
        inner[np.ix_(own, own)] = changes.T @ changes / weight**2
        rest[own] = changes.T @ residual / weight**2
    part = total / len(shown.q)
    return scores * part, inner * part, rest * part


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

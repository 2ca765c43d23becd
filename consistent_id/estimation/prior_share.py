"""What the prior decides of the torque on other motions, and how wrong it may be.

Torque of parameters that the data do not determine is the prior's.  `guessed_share` is
that share, whatever the prior.  `prior_errors` is its error, if the prior's bodies are
those of a model whose bodies agree with the data.
"""

from dataclasses import replace
from functools import lru_cache

import numpy as np

from consistent_id._support.arrays import Matrix, Vector
from consistent_id.regression.linear import (
    DATA_RANK_TOLERANCE,
    null_space,
    pulled_solution,
)
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.residual_noise import UnconstrainedFit
from consistent_id.regression.row_structure import RandomRows, random_rows
from consistent_id.robot.scaling import (
    USUAL_WIDTHS,
    link_scales,
    placeholders,
    reference_bodies,
)

ROW_MATTERS = 0.05
"""Torque relative to the strongest row of its unit, below which a row is left out."""


AGREES = 1.5
"""Distance of nominal bodies from the data, in usual errors, up to which they agree."""

TOGETHER = 0.08
"""Error of all rows' torque over that torque, beyond which the prior is not good."""


def torque_shares(model: TorqueModel, torque: Vector) -> Vector:
    """Return each row's torque over the largest of its unit; zero if all are zero."""
    shares = np.zeros(len(torque))
    for kind in (model.forces, ~model.forces):
        largest = torque[kind].max(initial=0.0)
        if largest > 0.0:
            shares[kind] = torque[kind] / largest
    return shares


def guessed_share(
    model: TorqueModel, free: UnconstrainedFit, x: Vector, known: Matrix
) -> float:
    """Return the share of torque that the data do not determine, on random motions.

    The prior of each parameter has a standard deviation that causes as much torque as
    the typical parameter of `x`. The weight that this prior keeps beside data and
    equalities is the prior-dominated share of ``x``: one for unidentifiable parameters,
    zero for well determined ones.  The function returns the torque of this share over
    the whole torque, for the row with the largest ratio. If the base floats, its rows
    are included: all bodies move.

    Parameters
    ----------
    free : UnconstrainedFit
        Least squares on the data.
    x : ndarray, shape (parameters,)
    known : ndarray, shape (rows, parameters)
        Rows of the equalities that hold by assumption.

    Returns
    -------
    float
        NaN for a model that cannot move, because its rows were given.
    """
    if not model.robot.connected:
        return np.nan
    every = _with_all_rows(model) if model.robot.floating else model
    rows = random_rows(every)
    unit = 1.0 / np.where(rows.norms > 0.0, rows.norms, 1.0)
    u = x / unit  # torque of each parameter on other motions
    noise, open_steps = free.noise, null_space(known * unit, DATA_RANK_TOLERANCE)
    seen = noise.coordinates @ free.base.projection * unit @ open_steps
    scaled = np.linalg.solve(noise.root.T, seen)  # in standard errors
    prior = 1.0 / max(float(np.mean(u**2)), np.finfo(float).tiny)
    left = pulled_solution(np.asarray(scaled), open_steps.T @ u, prior)
    guess = unit * (open_steps @ left)
    torque, guessed = rows.rms(x), rows.rms(guess)
    matters = (torque > 0.0) & (torque_shares(every, torque) >= ROW_MATTERS)
    share = guessed[matters] / torque[matters]
    return float(min(share.max(initial=0.0), 1.0))


def prior_errors(
    model: TorqueModel, free: UnconstrainedFit, x: Vector, known: Matrix
) -> Vector:
    """Return the error of each row's torque on random motions that the prior causes.

    With ``w`` the standard deviation of the prior of each parameter, ``A`` the data and
    ``1`` the noise, the estimate keeps ``K = (w A^T A w + 1)^-1`` of the prior's error:
    the covariance of the parameters due to it is ``w K K^T w``.  Nominal bodies have
    their usual errors, `USUAL_WIDTHS`.  If they are farther from the data than that,
    all are multiplied by the root of the ratio of squares.  Drive terms have a prior as
    wide as in `guessed_share`.

    Parameters
    ----------
    free : UnconstrainedFit
        Least squares on the data.
    x : ndarray, shape (parameters,)
        The estimate, whose prior pulls bodies to nominal ones.
    known : ndarray, shape (rows, parameters)
        Rows of the equalities that hold by assumption.

    Returns
    -------
    ndarray, shape (torque joints,)
        Standard deviations over the torque of `x`; zero for rows that make little of
        it.  NaN where nominal bodies are not known, are placeholders or farther from
        the data than `AGREES`, the base floats, or all rows together exceed `TOGETHER`.
    """
    robot = model.robot
    unknown = np.full(len(model.torque_joints), np.nan)
    if robot.nominal is None or placeholders(robot):
        return unknown
    if robot.floating or not robot.connected:
        return unknown
    rows, size = random_rows(model), model.layout.inertial_size
    width = _typical_widths(rows, x)
    width[:size] = link_scales(robot).widths(USUAL_WIDTHS)
    distance = _distance(model, free, width)
    if not distance <= AGREES:
        return unknown
    width[:size] *= distance
    open_steps = null_space(known * width, DATA_RANK_TOLERANCE)
    seen = _in_errors(free, width[:, None] * open_steps)
    kept = np.linalg.inv(seen.T @ seen + np.eye(open_steps.shape[1]))
    wrong = width[:, None] * (open_steps @ kept)
    squares = np.sum([rows.rms(column) ** 2 for column in wrong.T], axis=0)
    torque = rows.rms(x)
    matters = (torque > 0.0) & (torque_shares(model, torque) >= ROW_MATTERS)
    if np.sqrt(squares.sum()) > TOGETHER * np.linalg.norm(torque):
        return unknown
    ratio = np.sqrt(squares) / np.where(matters, torque, 1.0)
    return np.asarray(np.where(matters, ratio, 0.0))


def _typical_widths(rows: RandomRows, x: Vector) -> Vector:
    """Return the sizes at which each parameter makes as much torque as the typical."""
    unit = 1.0 / np.where(rows.norms > 0.0, rows.norms, 1.0)
    return np.asarray(unit * max(float(np.sqrt(np.mean((x / unit) ** 2))), 1e-300))


def _in_errors(free: UnconstrainedFit, changes: Matrix) -> Matrix:
    """Return changes of the parameters in standard errors of the data."""
    noise = free.noise
    y = noise.coordinates @ free.base.projection @ changes
    return np.asarray(np.linalg.solve(noise.root.T, y))


def _distance(model: TorqueModel, free: UnconstrainedFit, width: Vector) -> float:
    """Return how far nominal bodies are from the data, in their widths; at least one.

    The root mean square over the base parameters of bodies, with all drive terms free.
    """
    noise, size = free.noise, model.layout.inertial_size
    nominal = np.zeros(len(width))
    nominal[:size] = reference_bodies(model.robot).ravel()
    y = noise.coordinates @ (free.solution.x - free.base.projection @ nominal)
    M = noise.coordinates @ free.base.projection * width
    L = np.linalg.cholesky(noise.scatter)
    y, M = np.linalg.solve(L, y), np.linalg.solve(L, M)
    others = null_space(M[:, size:].T, DATA_RANK_TOLERANCE)
    M, y = others.T @ M[:, :size], others.T @ y
    squares = float(y @ np.linalg.solve(M @ M.T + np.eye(len(y)), y))
    bodies = sum(k < size for k in free.base.independent)
    return float(np.sqrt(max(squares / bodies, 1.0)))


@lru_cache(maxsize=16)
def _with_all_rows(model: TorqueModel) -> TorqueModel:
    every = replace(model, torque_joints=())
    return model if model.torque_joints == every.torque_joints else every

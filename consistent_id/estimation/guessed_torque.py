"""How much of the torque on other motions the data leave to the prior.

On the motion that an estimate was fitted to, what the data do not determine makes no
torque.  On other motions it does, and a prior or a convention chose it.
"""

from dataclasses import replace
from functools import lru_cache

import numpy as np

from consistent_id._support.arrays import BoolArray, Matrix, Vector
from consistent_id.regression.base import BaseParameters
from consistent_id.regression.linear import DATA_RANK_TOLERANCE, null_space
from consistent_id.regression.random_rows import random_rows
from consistent_id.regression.regression import Regression
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.residual_noise import coordinates, residual_noise
from consistent_id.regression.row_names import rows_in_newton
from consistent_id.regression.triangles import triangle

ROW_MATTERS = 0.05
"""Torque over that of the strongest row of its unit, below which a row is left out."""


def guessed_share(
    model: TorqueModel,
    regression: Regression,
    base: BaseParameters,
    x: Vector,
    known: Matrix,
) -> float:
    """Return the share of torque that the data do not determine, on random motions.

    Each parameter is as good a guess as any other: before the data it has a spread that
    makes as much torque as the typical parameter of `x`.  What weight that guess would
    keep beside data and equalities is the share of ``x`` that is guessed: all of what
    they do not see, nothing of what they tell well.  Returned is the torque of it over
    the whole torque, of the row in which that is most.  If the base floats, rows are
    also those of the base: all bodies move.

    Parameters
    ----------
    x : ndarray, shape (parameters,)
    known : ndarray, shape (rows, parameters)
        Rows of the equalities that hold by assumption.

    Returns
    -------
    float
        NaN for a model that cannot move: rows that somebody else gave.
    """
    if not model.robot.connected:
        return np.nan
    every = _with_all_rows(model) if model.robot.floating else model
    rows = random_rows(every)
    unit = 1.0 / np.where(rows.norms > 0.0, rows.norms, 1.0)
    u = x / unit  # torque on other motions that each parameter makes
    noise = residual_noise(regression, base)
    free = null_space(known * unit, DATA_RANK_TOLERANCE)
    seen = coordinates(noise) @ base.projection * unit @ free
    scaled = np.linalg.solve(noise.root.T, seen)  # in standard errors
    prior = 1.0 / max(float(np.mean(u**2)), np.finfo(float).tiny)
    guess = unit * (free @ _left_of(free.T @ u, np.asarray(scaled), prior))
    torque, guessed = rows.rms(x), rows.rms(guess)
    matters = _matters(every, torque)
    share = guessed[matters] / torque[matters]
    return float(min(share.max(initial=0.0), 1.0))


@lru_cache(maxsize=16)
def _with_all_rows(model: TorqueModel) -> TorqueModel:
    every = replace(model, torque_joints=())
    return model if model.torque_joints == every.torque_joints else every


def _left_of(guess: Vector, scaled: Matrix, prior: float) -> Vector:
    """Return ``x`` of the least ``||scaled x||^2 + prior ||x - guess||^2``."""
    from scipy.linalg import solve_triangular

    size = len(guess)
    rows = np.zeros((len(scaled) + size, size + 1), order="F")
    rows[: len(scaled), :size], rows[: len(scaled), size] = scaled, -scaled @ guess
    np.fill_diagonal(rows[len(scaled) :, :size], np.sqrt(prior))
    R = triangle(rows)
    step = solve_triangular(R[:size, :size], R[:size, size], check_finite=False)
    return np.asarray(guess + step)


def _matters(model: TorqueModel, torque: Vector) -> BoolArray:
    """Return the rows whose torque is not small beside others of its unit."""
    forces = rows_in_newton(model.robot, model.torque_joints)
    matters = np.zeros(len(torque), dtype=bool)
    for kind in (forces, ~forces):
        largest = torque[kind].max(initial=0.0)
        matters[kind] = (torque[kind] > 0.0) & (torque[kind] >= ROW_MATTERS * largest)
    return matters

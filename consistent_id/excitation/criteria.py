"""Criteria of informative motion: functions of the information matrix ``M = W^T W``.

Each criterion is a number to be minimised, with its gradient.  All but one are
functions of the eigenvalues ``l_i`` of ``M``:

- condition number: ``sqrt(l_max / l_min)``, for which
  ``f_p = (1/2p) (log sum l^p + log sum l^-p)`` is smooth and tends to its logarithm;
- D: ``-(1/2) mean log l``, the mean logarithm of the standard errors' ellipsoid;
- A: ``(1/2) log sum 1/l``, the root sum of squares of the standard errors;
- E: ``(1/2p) log sum l^-p``, which tends to that of the largest standard error;
- predicted torque error on a task with regressor ``V``:
  ``(1/2) log trace(V^T V M^-1)``.

D, A and E of some parameters alone are those of their Schur complement in ``M``.
"""

from collections.abc import Callable, Sequence
from typing import Literal, NamedTuple, get_args

import numpy as np

from consistent_id._support.arrays import Matrix, Vector
from consistent_id.errors import ProblemError

Objective = Literal["condition", "D", "A", "E", "task"]
Scaling = Literal["none", "unit columns"]

_FLOOR = np.finfo(np.float64).eps  # share of the largest eigenvalue that is rounding


class Value(NamedTuple):
    """A criterion's value, and its gradient with respect to a symmetric matrix."""

    value: float
    gradient: Matrix


Criterion = Callable[[Matrix], Value]


def spread(power: float) -> Criterion:
    """Return the smooth logarithm of the condition number, ``f_p``.

    With an infinite power it is the logarithm itself, whose gradient has jumps.

    Examples
    --------
    >>> M = np.diag([1.0, 4.0, 100.0])  # of a regressor of condition number 10
    >>> [round(float(np.exp(spread(p)(M).value)), 2) for p in (2, 8, 32)]
    [10.16, 10.0, 10.0]
    """

    def criterion(M: Matrix) -> Value:
        logs, vectors = _spectrum(M)
        high, low = _soft_maximum(power, logs), _soft_maximum(power, -logs)
        value = (high.value + low.value) / 2.0
        return _spectral(value, (high.weights - low.weights) / 2.0, logs, vectors)

    return criterion


def d_optimality(M: Matrix) -> Value:
    """Return the mean logarithm of the standard errors, along principal axes."""
    logs, vectors = _spectrum(M)
    weights = np.full(len(logs), -0.5 / len(logs))
    return _spectral(-0.5 * float(logs.mean()), weights, logs, vectors)


def e_optimality(power: float) -> Criterion:
    """Return the smooth logarithm of the largest standard error."""

    def criterion(M: Matrix) -> Value:
        logs, vectors = _spectrum(M)
        low = _soft_maximum(power, -logs)
        return _spectral(low.value / 2.0, -low.weights / 2.0, logs, vectors)

    return criterion


def a_optimality(M: Matrix) -> Value:
    """Return the logarithm of the standard errors' root sum of squares."""
    return e_optimality(1.0)(M)


def task_error(gram: Matrix) -> Criterion:
    """Return the logarithm of the predicted torque error's size on a task.

    Parameters
    ----------
    gram : ndarray, shape (base parameters, base parameters)
        ``V^T V / rows`` of the task's regressor, in the columns of ``M``.
    """

    def criterion(M: Matrix) -> Value:
        logs, vectors = _spectrum(M)
        inverse = (vectors * np.exp(-logs)) @ vectors.T
        product = inverse @ gram
        total = float(np.trace(product))
        return Value(0.5 * np.log(total), -0.5 * (product @ inverse) / total)

    return criterion


def criterion_of(objective: Objective, power: float, gram: Matrix | None) -> Criterion:
    """Return the criterion of an objective, with a smoothing `power`.

    Raises
    ------
    ProblemError
        If the objective is unknown, or is a task's without a task.
    """
    if objective not in get_args(Objective):
        known = ", ".join(get_args(Objective))
        raise ProblemError(f"objective is {objective!r}, expected one of {known}")
    if objective == "task" and gram is None:
        raise ProblemError(
            "objective 'task' needs the task whose torque is to be predicted; give it, "
            "or choose another objective"
        )
    if objective == "condition":
        return spread(power)
    if objective == "E":
        return e_optimality(power)
    if objective == "task" and gram is not None:
        return task_error(gram)
    return a_optimality if objective == "A" else d_optimality


def scaled(criterion: Criterion, scaling: Scaling) -> Criterion:
    """Return the criterion of the matrix whose columns have been scaled.

    With unit columns it is that of ``C = S M S``, ``S = diag(M)^-1/2``, and
    ``df/dM = S G S - diag(sum_j (G * C)_ij / M_ii)`` where ``G = df/dC``.
    """
    if scaling == "none":
        return criterion
    if scaling != "unit columns":
        known = ", ".join(get_args(Scaling))
        raise ProblemError(f"scaling is {scaling!r}, expected one of {known}")

    def of_unit_columns(M: Matrix) -> Value:
        squares = np.diag(M)
        squares = np.maximum(squares, _FLOOR * squares.max())
        s = 1.0 / np.sqrt(squares)
        C = s[:, None] * M * s
        value, G = criterion(C)
        shrink = np.diag((G * C).sum(axis=1) / squares)
        return Value(value, s[:, None] * G * s - shrink)

    return of_unit_columns


def of_some(criterion: Criterion, places: Sequence[int]) -> Criterion:
    """Return the criterion of some parameters, with all others unknown (D_s, A_s, E_s).

    It is that of their remaining information, the Schur complement ``C = T M T^T`` with
    ``T = [1, -M_so M_oo^-1]``, in the order some, others; its inverse is their
    covariance, and ``df/dM = T^T G T`` where ``G = df/dC``.
    """
    some = np.array(places, dtype=int)

    def of_complement(M: Matrix) -> Value:
        others = np.setdiff1d(np.arange(len(M)), some)
        T = np.zeros((len(some), len(M)))
        T[range(len(some)), some] = 1.0
        if len(others):
            logs, vectors = _spectrum(M[np.ix_(others, others)])
            shared = M[np.ix_(some, others)] @ vectors
            T[:, others] = -(shared * np.exp(-logs)) @ vectors.T
        value, G = criterion(T @ M @ T.T)
        return Value(value, T.T @ G @ T)

    return of_complement


class _Soft(NamedTuple):
    value: float
    weights: Vector


def _soft_maximum(power: float, x: Vector) -> _Soft:
    """``(1/p) log sum exp(p x)`` and its gradient, without overflow."""
    top = x.max()
    if np.isinf(power):
        return _Soft(float(top), (np.arange(len(x)) == x.argmax()).astype(float))
    weights = np.exp(power * (x - top))
    total = weights.sum()
    return _Soft(float(top + np.log(total) / power), weights / total)


class _Spectrum(NamedTuple):
    logs: Vector
    vectors: Matrix


def _spectrum(M: Matrix) -> _Spectrum:
    values, vectors = np.linalg.eigh(M)
    return _Spectrum(np.log(np.maximum(values, _FLOOR * values[-1])), vectors)


def _spectral(value: float, slopes: Vector, logs: Vector, vectors: Matrix) -> Value:
    """Gradient of a function of log eigenvalues: ``V diag(df/dlog l / l) V^T``."""
    return Value(float(value), (vectors * (slopes * np.exp(-logs))) @ vectors.T)

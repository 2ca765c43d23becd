"""An estimate refined on the error of its own rollouts (output error).

Torque fits use accelerations, which were not measured; a rollout compares measured
positions.  A few Gauss-Newton steps begin at the certified torque fit.  Each step is a
cone programme of its own: the same constraints, so every step's bodies are consistent;
the linearised errors, each joint's over its level in the torque fit's rollouts; and the
torque fit as the ridge, so that directions without effect on rollouts keep their torque
fit.  Joints have equal weight: a joint that the model cannot follow does not bias the
others.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from time import perf_counter

import numpy as np

from consistent_id._support.arrays import IntArray, Matrix, Vector
from consistent_id._support.executors import single_threaded
from consistent_id._support.given_values import require_type, require_types
from consistent_id._support.singular import pinv, svd
from consistent_id._support.tables import brief
from consistent_id.constraints import Constraint, lowered
from consistent_id.constraints.cones.certificate import Certificate
from consistent_id.errors import RecordingError
from consistent_id.estimation.best_fit import best_fit
from consistent_id.estimation.estimate import Estimate
from consistent_id.estimation.fit import fit_of
from consistent_id.estimation.method import Method
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals import PDGains
from consistent_id.regression.regression import Regression, triangle
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.residual_noise import unconstrained_fit
from consistent_id.rollout.rollout_slopes import (
    Replays,
    RolloutErrors,
    finite_changes,
)

STEPS = 3
"""Gauss-Newton steps; the error decreases in the first two, a third confirms it."""

RIDGE = 0.1
"""Weight of the torque fit beside the rollouts; see `benchmarks/rollout.py`."""

_LEAST = 0.05  # of the largest joint's error: no joint's weight runs away
_HALVINGS = 3  # of a step that makes the error larger
_ENOUGH = 0.002  # relative gain of a step, below which there is no other
_SAME = 1e-9  # relative effect below which parameters have the same one


@brief
@dataclass(frozen=True, slots=True, eq=False)
class Refined:
    """An estimate refined by rollout.

    Parameters
    ----------
    before, after : float, [rad or m]
        Root-mean-square error of the rollouts that were learnt from.
    """

    estimate: Estimate
    before: float
    after: float


@single_threaded
def refined(
    estimate: Estimate,
    regression: Regression,
    logs: Sequence[Recording],
    gains: PDGains,
    *,
    constraints: Sequence[Constraint],
    delay: float = 0.0,
    ridge: float = RIDGE,
    steps: int = STEPS,
) -> Refined:
    """Refine an estimate on the closed-loop rollouts of training logs.

    Parameters
    ----------
    estimate : Estimate
        Where to begin: the constrained torque fit.
    regression : Regression
        Regression of the same training motion.
    logs : sequence of Recording
        With commands, as they were logged.
    constraints : sequence of Constraint
        Constraints that every step meets.
    delay : float, [s]
        Delay of commands.  It is fixed: on one motion it is correlated with damping and
        inertia, and a step would give a value that faster motion does not confirm.
    ridge : float
        Weight of the torque fit.

    Raises
    ------
    ModelError
        If MuJoCo is not installed.
    RecordingError
        If a log has no commands, or a motion of the torque fit diverges.  Steps to
        motions that diverge are shortened.
    """
    require_type(estimate, Estimate, "estimate")
    require_type(regression, Regression, "regression")
    require_types(logs, Recording, "logs")
    require_type(gains, PDGains, "gains")
    require_types(constraints, Constraint, "constraints")
    started = perf_counter()
    replays = Replays.of(estimate, logs, gains)
    begin = refinement_start(replays, regression, constraints, delay)
    x, size = begin.x, begin.size
    for k in range(steps):
        try:
            linear = begin.linear if k == 0 else begin.linearised(x)
        except RecordingError:  # beside `x` a motion diverges: no other step
            break
        goal = _goal(begin, linear, x, ridge)
        x, now = _descended(begin, (x, size), goal)
        gained, size = size - now, now
        if gained < _ENOUGH * size:
            break
    after = _size(begin.replays.errors(x, delay))
    seconds = perf_counter() - started
    done = _estimate(begin, x, after, seconds)
    return Refined(done, begin.before, after)


@dataclass(frozen=True, slots=True, eq=False)
class RefinementStart:
    """The start of a refinement: a torque fit, its rollouts and their derivatives.

    Parameters
    ----------
    x : ndarray, shape (parameters,)
    free : ndarray of int
        Parameters that the constraints leave free and rollouts depend on.
    changes : ndarray, shape (parameters,)
        Steps of finite differences.
    level : ndarray, shape (joints,), [rad or m]
        By which errors are divided.
    before : float, [rad or m]
        Root-mean-square error of the rollouts.
    linear : RolloutErrors
        At `x`.
    """

    estimate: Estimate
    regression: Regression
    constraints: tuple[Constraint, ...]
    replays: Replays
    delay: float
    x: Vector
    free: IntArray
    changes: Vector
    level: Vector
    before: float
    linear: RolloutErrors

    @property
    def size(self) -> float:
        """Root-mean-square error, each joint's over its level."""
        return _size(self.linear.errors, self.level)

    def linearised(self, x: Vector) -> RolloutErrors:
        """Return errors and derivatives elsewhere."""
        return self.replays.linearised(x, self.delay, self.free, self.changes)


@single_threaded
def refinement_start(
    replays: Replays,
    regression: Regression,
    constraints: Sequence[Constraint],
    delay: float,
) -> RefinementStart:
    """Return the start of `refined`; see there.

    Raises
    ------
    RecordingError
        If a motion diverges, of the torque fit or of one beside it.
    """
    estimate = replays.estimate
    free = free_parameters(estimate.model, constraints)
    changes = finite_changes(regression)
    free = free[np.isfinite(changes[free])]
    x = np.array(estimate.parameters)
    linear = replays.linearised(x, delay, free, changes)
    level = np.sqrt((linear.errors**2).mean(axis=1))
    level = np.maximum(level, _LEAST * level.max())
    return RefinementStart(
        estimate,
        regression,
        tuple(constraints),
        replays,
        delay,
        x,
        free,
        changes,
        level,
        _size(linear.errors),
        linear,
    )


@single_threaded
def full_step(
    start: RefinementStart,
    estimate: Estimate,
    regression: Regression,
    *,
    ridge: float,
) -> Vector:
    """Return the parameters after a whole step from another torque fit.

    Its rollouts have the derivatives of the start, which are nearly its own.

    Parameters
    ----------
    estimate : Estimate
        Of the start's model and logs, such as with another cut-off.
    regression : Regression
        Its rows.
    ridge : float
        Weight of the torque fit.

    Raises
    ------
    RecordingError
        If its motion diverges.
    """
    replays = replace(start.replays, estimate=estimate)
    x = np.array(estimate.parameters)
    errors = replays.errors(x, start.delay)
    begin = replace(start, estimate=estimate, regression=regression, replays=replays)
    return _goal(begin, start.linear, x, ridge, errors)


@single_threaded
def refined_once(start: RefinementStart, ridge: float) -> Vector:
    """Return the parameters after one step of `refined`, shape (parameters,)."""
    goal = _goal(start, start.linear, start.x, ridge)
    return _descended(start, (start.x, start.size), goal)[0]


def _goal(
    start: RefinementStart,
    linear: RolloutErrors,
    x: Vector,
    ridge: float,
    errors: Matrix | None = None,
) -> Vector:
    """Return the minimiser of the linearised errors and the torque fit.

    `errors` are those at `x`, if they are not those of `linear`.
    """
    estimate, free = start.estimate, start.free
    Q, R = _factored(linear, start.level.tobytes(), free.tobytes())
    r = ((linear.errors if errors is None else errors) / start.level[:, None]).ravel()
    along = Q.T @ r
    rows = np.zeros((len(R) + 1, len(x) + 1))
    rows[:-1, :-1] = _by_base(R, start)
    rows[:-1, -1] = rows[:-1, :-1] @ x - along
    rows[-1, -1] = np.sqrt(max(float(r @ r - along @ along), 0.0))
    combined = _with_rows(start.regression, rows, ridge)
    fit = best_fit(estimate.model, combined, start.constraints, base=estimate.base)
    return fit.parameters


@lru_cache(maxsize=2)
def _factored(
    linear: RolloutErrors, level: bytes, free: bytes
) -> tuple[Matrix, Matrix]:
    """Return the QR factors of the derivatives, of each joint over its level.

    All weights and cut-offs of a refinement share them.
    """
    own = np.frombuffer(free, dtype=np.intp)
    J = linear.by_parameter[:, :, own] / np.frombuffer(level)[:, None, None]
    Q, R = np.linalg.qr(J.reshape(-1, len(own)))
    return Q, R


def _by_base(R: Matrix, start: RefinementStart) -> Matrix:
    """Return derivatives by all parameters of which those by the free ones are `R`.

    Motion depends on base parameters alone, as torque does, and a fit takes the columns
    of those parameters that lead them.  Finite differences depend on the others by
    rounding, and fixed parameters have none: the derivatives by base parameters are
    those nearest to the free ones', each in units of its own step.
    """
    projection, step = start.estimate.base.projection, start.changes[start.free]
    by_step = pinv(projection[:, start.free] * step, rcond=_SAME)
    return np.asarray((R * step) @ by_step @ projection)


def _with_rows(regression: Regression, rows: Matrix, ridge: float) -> Regression:
    """Return the torque fit, by its weight, together with rows of other errors."""
    residual = regression.sigma
    factors = [
        factor * np.sqrt(ridge) / s
        for factor, s in zip(regression.factors, residual, strict=True)
    ]
    factors[0] = triangle(np.asfortranarray(np.vstack([factors[0], rows])))
    return replace(regression, factors=tuple(factors), sigma=np.array(1.0), noise=None)


def _descended(
    start: RefinementStart, here: tuple[Vector, float], goal: Vector
) -> tuple[Vector, float]:
    """Step towards the goal while the error decreases; all points are feasible."""
    x, size = here
    share = 1.0
    for _ in range(_HALVINGS):
        tried = x + share * (goal - x)
        now = _size_at(start, tried)
        if now < size:
            return tried, now
        share /= 2.0
    return here


def _size_at(start: RefinementStart, x: Vector) -> float:
    """Return the size of the errors at `x`; infinite where a motion diverges."""
    try:
        errors = start.replays.errors(x, start.delay)
    except RecordingError:
        return np.inf
    return _size(errors, start.level)


def _size(errors: Matrix, level: Vector | None = None) -> float:
    over = errors if level is None else errors / level[:, None]
    return float(np.sqrt((over**2).mean()))


def _estimate(
    start: RefinementStart, x: Vector, after: float, seconds: float
) -> Estimate:
    """Return the refined estimate; `after` is the error of its rollouts."""
    estimate, before, delay = start.estimate, start.before, start.delay
    reason = (
        "refined by rollout: every step met the constraints, but the error of rollouts "
        "is not convex, so no optimum is proven"
    )
    note = (
        f"refined on rollouts of the training motion: error {1e3 * before:.2f} to "
        f"{1e3 * after:.2f} mrad (mm), commands late by {1e3 * delay:.2f} ms"
    )
    figures = {
        "rollout error before": before,
        "rollout error after": after,
        "delay of commands": delay,
    }
    free = unconstrained_fit(start.regression, estimate.base)
    fit = fit_of(estimate.model, free, x)
    if estimate.fit is not None:
        # The torque's own optimum shows whether constraints contradict the torque.
        fit = replace(fit, excess=estimate.fit.excess)
    return replace(
        estimate,
        method=Method.REFINED_BY_ROLLOUT,
        parameters=x,
        base_covariance=None,
        parameter_errors=_errors_with_change(estimate, x),
        certificate=Certificate("uncertified", reason, figures),
        notes=(note, *estimate.notes),
        seconds=seconds,
        fit=fit,
        judged=None,
    )


def _errors_with_change(estimate: Estimate, x: Vector) -> Vector | None:
    """Return the standard errors of refined parameters.

    Torque and rollouts are two views of the same log.  What one says differs from what
    the other says by noise, and by what the model lacks, so the change counts as one
    standard error beside the torque fit's.
    """
    errors = estimate.parameter_errors
    return None if errors is None else np.hypot(errors, x - estimate.parameters)


def free_parameters(model: TorqueModel, constraints: Sequence[Constraint]) -> IntArray:
    """Return the parameters that the equalities do not fix."""
    known = lowered(constraints, model)
    if not len(known.A_eq):
        return np.arange(len(model.layout))
    A = known.A_eq / np.linalg.norm(known.A_eq, axis=1, keepdims=True)
    _, s, Vt = svd(A)
    rank = int((s > 1e-12 * s[0]).sum())
    return np.flatnonzero(np.linalg.norm(Vt[rank:], axis=0) > 1e-9)

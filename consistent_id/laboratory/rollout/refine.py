"""An estimate refined on the error of its own rollouts (output error).

Torque fits trust accelerations, which nobody measured; a rollout compares positions,
which were.  A few Gauss-Newton steps begin at the certified torque fit.  Each step is a
cone programme of its own: the same constraints, so every step's bodies are consistent;
the linearised errors, each joint's over its level in the torque fit's rollouts; and the
torque fit itself as the ridge, so that what rollouts do not show stays where torques
put it.  Joints count alike: one that no parameters make follow does not bend others.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np

from consistent_id._support.arrays import Matrix, Vector
from consistent_id._support.threads import single_threaded
from consistent_id.constraints import Constraint
from consistent_id.estimation.best_fit import best_fit
from consistent_id.estimation.estimate import Certificate, Estimate
from consistent_id.estimation.fit import fit_of
from consistent_id.estimation.method import Method
from consistent_id.laboratory.rollout.replay import replayable
from consistent_id.laboratory.rollout.sensitivities import (
    Replays,
    RolloutErrors,
    finite_changes,
    free_parameters,
)
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals import PDGains
from consistent_id.regression.regression import Regression, triangle

STEPS = 3
"""Gauss-Newton steps; the error falls in the first two, a third confirms it."""

RIDGE = 0.1
"""Weight of the torque fit beside the rollouts; see `benchmarks/rollout.py`."""

_LEAST = 0.05  # of the largest joint's error: no joint's weight runs away
_HALVINGS = 3  # of a step that makes the error larger
_ENOUGH = 0.002  # relative gain of a step, below which there is no other


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
        Of the same training motion.
    logs : sequence of Recording
        With commands, as they were logged.
    constraints : sequence of Constraint
        Which every step meets.
    delay : float, [s]
        Of commands.  It is held: on one motion it trades with damping and inertia, and
        a step would put it where faster motion does not confirm it.
    ridge : float
        Weight of the torque fit.

    Raises
    ------
    ModelError
        If MuJoCo is not installed.
    RecordingError
        If a log has no commands, or a motion diverges.
    """
    started = perf_counter()
    joints = estimate.model.robot.joint_names
    known = tuple(replayable(log.of(joints)) for log in logs)
    replays = Replays(estimate, known, gains)
    free = free_parameters(estimate.model, constraints)
    changes = finite_changes(regression)
    free = free[np.isfinite(changes[free])]
    x = np.array(estimate.parameters)
    errors = replays.errors(x, delay)
    level = np.sqrt((errors**2).mean(axis=1))
    level = np.maximum(level, _LEAST * level.max())
    before, size = _size(errors), _size(errors, level)
    for _ in range(steps):
        linear = replays.linearised(x, delay, free, changes)
        goal = _goal(estimate, regression, constraints, linear, level, x, ridge)
        x, now = _descended(replays, delay, (x, size), goal, level)
        gained, size = size - now, now
        if gained < _ENOUGH * size:
            break
    after = _size(replays.errors(x, delay))
    seconds = perf_counter() - started
    done = _estimate(estimate, regression, x, delay, seconds, before, after)
    return Refined(done, before, after)


def _goal(
    estimate: Estimate,
    regression: Regression,
    constraints: Sequence[Constraint],
    linear: RolloutErrors,
    level: Vector,
    x: Vector,
    ridge: float,
) -> Vector:
    """Return the parameters that the linearised errors and the torque fit ask for."""
    J = (linear.by_parameter / level[:, None, None]).reshape(-1, len(x))
    r = (linear.errors / level[:, None]).ravel()
    rows = np.column_stack([J, J @ x - r])
    combined = _with_rows(regression, triangle(np.asfortranarray(rows)), ridge)
    fit = best_fit(estimate.model, combined, constraints, base=estimate.base)
    return fit.parameters


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
    replays: Replays,
    delay: float,
    here: tuple[Vector, float],
    goal: Vector,
    level: Vector,
) -> tuple[Vector, float]:
    """Go towards the goal, as far as the error falls; all between is feasible."""
    x, size = here
    share = 1.0
    for _ in range(_HALVINGS):
        tried = x + share * (goal - x)
        now = _size(replays.errors(tried, delay), level)
        if now < size:
            return tried, now
        share /= 2.0
    return here


def _size(errors: Matrix, level: Vector | None = None) -> float:
    over = errors if level is None else errors / level[:, None]
    return float(np.sqrt((over**2).mean()))


def _estimate(
    estimate: Estimate,
    regression: Regression,
    x: Vector,
    delay: float,
    seconds: float,
    before: float,
    after: float,
) -> Estimate:
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
    fit = fit_of(estimate.model, regression, x, estimate.base)
    if estimate.fit is not None:
        # Whether constraints contradict the torque, its own optimum says.
        fit = replace(fit, excess=estimate.fit.excess)
    return replace(
        estimate,
        method=Method.REFINED_BY_ROLLOUT,
        parameters=x,
        base_covariance=None,
        certificate=Certificate("uncertified", reason, figures),
        notes=(note, *estimate.notes),
        seconds=seconds,
        fit=fit,
        judged=None,
    )

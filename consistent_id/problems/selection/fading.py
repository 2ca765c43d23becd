"""Stribeck velocities between those that the search tries.

The search tries velocities that are a factor of two apart, and the same for all joints.
A velocity that is 1.4 times the true one predicts torque hardly worse, but its joint's
viscous and Coulomb friction are wrong by many standard errors.  So when the search has
ended, each joint's velocity is found more closely: the joint's own squared error on
blocks left out, with fixed bodies, is computed at velocities around the present one.
The vertex of a parabola through the lowest is taken.  The velocities of all joints are
kept if the model that is fitted with them predicts left-out blocks better.

A wrong velocity also hides drag, or makes some up.  So terms of single joints are tried
again beside the closer velocities.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from consistent_id._support.arrays import Matrix, Vector
from consistent_id.errors import ConsistentIdError
from consistent_id.problems.selection.choice import (
    STRIBECK_PASSED,
    Choice,
    ModelMove,
    setter,
    with_drive,
)
from consistent_id.problems.selection.evaluation import Evaluated, Evaluator
from consistent_id.problems.selection.fits import gain
from consistent_id.problems.selection.forward_search import (
    Scope,
    State,
    Step,
    joint_by_joint,
)

AROUND = np.linspace(-0.75, 0.75, 7) * np.log(2.0)
"""Logarithms of velocities that are compared, over the present one."""

_EDGE = 0.6 * np.log(2.0)  # change from which the lowest may be beyond those compared
_ROUNDS = 3  # of comparing velocities around the last ones
_TURNS = 3  # of finding velocities, and then other terms beside them


def closer_models(
    evaluator: Evaluator, start: Evaluated, state: State, scope: Scope
) -> Iterator[tuple[Evaluator, State]]:
    """Yield states with closer Stribeck velocities, and evaluators that know them.

    Other terms of single joints, such as drag, are tried again beside them, with which
    the velocities may change again.

    Parameters
    ----------
    start : Evaluated
        The plain model.
    """
    for _ in range(0 if "stribeck_velocity" in scope.fixed else _TURNS):
        evaluator, after = with_closer_velocities(evaluator, state)
        if after is state:
            return
        yield evaluator, after
        state = after
        for better in joint_by_joint(evaluator, start, after, scope):
            state = better
            yield evaluator, state
        if state.current is after.current:
            return


def with_closer_velocities(
    evaluator: Evaluator, state: State
) -> tuple[Evaluator, State]:
    """Return the state with Stribeck velocities found more closely, if that is better.

    Returns
    -------
    evaluator : Evaluator
        Knows the velocities of the state.
    state : State
        With one more step, or as it was.
    """
    names = evaluator.setting.bodies.robot.joint_names
    first = found = state.current
    places = [j for j, velocity in enumerate(_velocities(first.choice)) if velocity]
    for _ in range(_ROUNDS if places else 0):
        closer, after = _closer(evaluator, found, places)
        if after is None or gain(found.errors, after.errors).share <= 0.0:
            break
        before, now = (_velocities(each.choice) for each in (found, after))
        evaluator, found = closer, after
        if max(abs(np.log(now[j] / before[j])) for j in places) < _EDGE:
            break
    if found is first:
        return evaluator, state
    now = _velocities(found.choice)
    label = ", ".join(f"{now[j]:g} of {names[j]}" for j in places)
    move = ModelMove(
        "stribeck_value", f"stribeck_velocity = {label}", first.choice, found.choice
    )
    made = Step(move, gain(first.errors, found.errors), found.error, {})
    return evaluator, replace(state, current=found, steps=(*state.steps, made))


def _velocities(choice: Choice) -> list[float]:
    """Return each joint's Stribeck velocity, zero without one."""
    return [drive.stribeck_velocity or 0.0 for drive in choice.drive]


def _closer(
    evaluator: Evaluator, current: Evaluated, places: Sequence[int]
) -> tuple[Evaluator, Evaluated | None]:
    """Return a choice with closer velocities, fitted; None if it cannot be."""
    bodies = evaluator.setting.bodies
    names = bodies.robot.joint_names
    rows = [bodies.torque_joints.index(names[j]) for j in places]
    before = np.array([_velocities(current.choice)[j] for j in places])
    top = evaluator.samples(current.choice.motion_cutoff).top_speeds[places]
    tried = np.minimum(before * np.exp(AROUND[:, None]), top / STRIBECK_PASSED)
    squares = _own_squares(evaluator, current, places, tried)[:, rows]
    best = [
        float(f"{np.exp(lowest(np.log(v), s)):.3g}")
        for v, s in zip(tried.T, squares.T, strict=True)
    ]
    closer = evaluator.with_fading(tuple(best))
    try:
        return closer, closer.evaluated(with_velocities(current.choice, places, best))
    except ConsistentIdError:
        return evaluator, None


def with_velocities(
    choice: Choice, places: Sequence[int], velocities: Sequence[float]
) -> Choice:
    """Return a choice with a Stribeck velocity of each of some joints."""
    for j, velocity in zip(places, velocities, strict=True):
        choice = with_drive(choice, [j], setter(stribeck_velocity=velocity))
    return choice


def lowest(x: Vector, y: Vector) -> float:
    """Return where a parabola through the least value and its neighbours is lowest.

    At an end of the range, or where neighbours are as low, the least value's place.

    Parameters
    ----------
    x, y : ndarray, shape (points,)
        Ascending places, and their values.
    """
    k = int(np.argmin(y))
    if k in (0, len(x) - 1):
        return float(x[k])
    left, right = x[k] - x[k - 1], x[k + 1] - x[k]
    down = (y[k] - y[k - 1]) / max(left, 1e-12)
    up = (y[k + 1] - y[k]) / max(right, 1e-12)
    bend = (up - down) / (left + right)
    if bend <= 0.0:
        return float(x[k])
    slope = (down * right + up * left) / (left + right)
    return float(np.clip(x[k] - 0.5 * slope / bend, x[k - 1], x[k + 1]))


def _own_squares(
    evaluator: Evaluator,
    current: Evaluated,
    places: Sequence[int],
    tried: Matrix,
) -> Matrix:
    """Return each joint's squared error on left-out blocks, by the velocities tried.

    Parameters
    ----------
    tried : ndarray, shape (trials, places), [rad/s or m/s]

    Returns
    -------
    ndarray, shape (trials, torque joints)
    """
    around = evaluator.with_fading(tuple(np.unique(tried).tolist()))
    return np.array(
        [
            around.screened(
                with_velocities(current.choice, places, own.tolist()), current
            ).squares.sum(axis=0)
            for own in tried
        ]
    )

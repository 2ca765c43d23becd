"""Shapes of friction between those that the search tries, joint by joint.

The search tries Stribeck velocities that are a factor of two apart, and the same for
all joints.  A velocity that is 1.4 times the true one predicts torque hardly worse, but
its joint's viscous and Coulomb friction are wrong by many standard errors.  So when the
search has ended, each joint's velocity is found more closely: the joint's own squared
error on blocks left out, with fixed bodies, is computed at velocities around the
present one.  The vertex of a parabola through the lowest is taken.  The velocities of
all joints are kept if the model that is fitted with them predicts left-out blocks
better.

A wrong velocity also hides drag, or makes some up.  So terms of single joints are tried
again beside the closer velocities.

Where some joints turn and others slide, widths of friction's change of sign are found
in the same way before: the search has one for each kind of joint, in a fixed ratio.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Literal, NamedTuple

import numpy as np

from consistent_id._support.arrays import Vector
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


class Shape(NamedTuple):
    """A shape of friction: its key, and the kind of its moves.

    Parameters
    ----------
    key : {"stribeck_velocity", "velocity_scale"}
    kind : str
    around : ndarray
        Logarithms of values that are compared, over the present one.
    passed : float
        Least top speed of a joint over its value.
    """

    key: Literal["stribeck_velocity", "velocity_scale"]
    kind: str
    around: Vector
    passed: float

    def of(self, choice: Choice) -> list[float]:
        """Return each joint's value, zero without one."""
        return [getattr(drive, self.key) or 0.0 for drive in choice.drive]


FADING = Shape(
    "stribeck_velocity",
    "stribeck_value",
    np.linspace(-0.75, 0.75, 7) * np.log(2.0),
    STRIBECK_PASSED,
)
WIDTH = Shape(
    "velocity_scale", "velocity_scale", np.linspace(-3.0, 3.0, 7) * np.log(2.0), 3.0
)

_EDGE = 0.8  # of the largest change, from which the lowest may be farther away
_ROUNDS = 3  # of comparing values, and of
_TURNS = 3  # other terms beside them


def closer_models(
    evaluator: Evaluator, start: Evaluated, state: State, scope: Scope
) -> Iterator[tuple[Evaluator, State]]:
    """Yield states with closer shapes of friction, and evaluators that know them.

    Other terms of single joints, such as drag, are tried again beside them, with which
    the shapes may change again.

    Parameters
    ----------
    start : Evaluated
        The plain model.
    """
    shapes = [WIDTH] if state.current.choice.ratios else []
    shapes += [] if "stribeck_velocity" in scope.fixed else [FADING]
    for _ in range(_TURNS):
        before = state
        for shape in shapes:
            evaluator, state = with_closer_values(evaluator, state, shape)
        if state is before:
            return
        yield evaluator, state
        closer = state
        for state in joint_by_joint(evaluator, start, closer, scope):
            yield evaluator, state
        if state.current is closer.current:
            return


def with_closer_values(
    evaluator: Evaluator, state: State, shape: Shape
) -> tuple[Evaluator, State]:
    """Return the state with values found more closely, if that is better.

    Returns
    -------
    evaluator : Evaluator
        Knows the values of the state.
    state : State
        With one more step, or as it was.
    """
    bodies = evaluator.setting.bodies
    names = bodies.robot.joint_names
    first = found = state.current
    values = zip(names, shape.of(first.choice), strict=True)
    places = [
        j for j, (name, v) in enumerate(values) if v and name in bodies.torque_joints
    ]
    for _ in range(_ROUNDS if places else 0):
        closer, after = _closer(evaluator, found, shape, places)
        if after is None or gain(found.errors, after.errors).share <= 0.0:
            break
        before, now = (shape.of(each.choice) for each in (found, after))
        evaluator, found = closer, after
        changes = [abs(np.log(now[j] / before[j])) for j in places]
        if max(changes) < _EDGE * shape.around[-1]:
            break
    if found is first:
        return evaluator, state
    now = shape.of(found.choice)
    label = ", ".join(f"{now[j]:g} of {names[j]}" for j in places)
    move = ModelMove(shape.kind, f"{shape.key} = {label}", first.choice, found.choice)
    made = Step(move, gain(first.errors, found.errors), found.error, {})
    return evaluator, replace(state, current=found, steps=(*state.steps, made))


def _closer(
    evaluator: Evaluator, current: Evaluated, shape: Shape, places: Sequence[int]
) -> tuple[Evaluator, Evaluated | None]:
    """Return a choice with closer values, fitted; None if it cannot be."""
    bodies = evaluator.setting.bodies
    names = bodies.robot.joint_names
    rows = [bodies.torque_joints.index(names[j]) for j in places]
    before = np.array([shape.of(current.choice)[j] for j in places])
    top = evaluator.samples(current.choice.motion_cutoff).top_speeds[places]
    tried = np.minimum(before * np.exp(shape.around[:, None]), top / shape.passed)
    choices = [with_values(current.choice, shape, places, own) for own in tried]
    around = _knowing(evaluator, choices)
    squares = np.array(
        [around.screened(choice, current).squares.sum(axis=0) for choice in choices]
    )[:, rows]
    best = [
        float(f"{np.exp(lowest(np.log(v), s)):.3g}")
        for v, s in zip(tried.T, squares.T, strict=True)
    ]
    choice = with_values(current.choice, shape, places, np.array(best))
    closer = _knowing(evaluator, [choice])
    try:
        return closer, closer.evaluated(choice)
    except ConsistentIdError:
        return evaluator, None


def _knowing(evaluator: Evaluator, choices: Sequence[Choice]) -> Evaluator:
    """Return an evaluator that knows the Stribeck velocities of choices."""
    values = {v for choice in choices for v in FADING.of(choice) if v}
    return evaluator.with_fading(tuple(sorted(values)))


def with_values(
    choice: Choice, shape: Shape, places: Sequence[int], values: Vector
) -> Choice:
    """Return a choice with a value of some joints."""
    for j, value in zip(places, values.tolist(), strict=True):
        choice = with_drive(choice, [j], setter(**{shape.key: value}))
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

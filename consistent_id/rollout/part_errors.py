"""How well estimates of one part of the training motion predict the other part.

Errors of rollouts are compared by blocks of the motion, and by joints, each over its
level in a rollout that they are compared with.  So a joint that the model cannot
follow, such as one that meets a stop, does not decide what is best for the others, and
joints that slide count as those that turn.
"""

from collections.abc import Sequence

import numpy as np

from consistent_id._support.arrays import Matrix, Vector
from consistent_id.errors import RecordingError
from consistent_id.estimation.estimate import Estimate
from consistent_id.problems.problem import Problem
from consistent_id.recordings.recording import Recording
from consistent_id.rollout.delay_search import student
from consistent_id.rollout.motion_parts import Spans, within
from consistent_id.rollout.replay_model import SEARCH_STEP
from consistent_id.rollout.settings import compared_fit, replay_errors

BLOCKS_OF_PART = 4  # whose scatter is the error of the delay

LEAST_LEVEL = 0.05
"""Least level of a joint, over the median one: no joint's weight runs away."""


def squares_of_part(problem: Problem, learnt: Spans, other: Spans) -> Matrix:
    """Return the squares of blocks of a part; infinite if its motion diverges.

    Returns
    -------
    ndarray, shape (blocks, joints)
    """
    estimate, _ = compared_fit(problem, within(problem.training, learnt))
    logs = within(problem.logs("training"), other)
    try:
        return block_squares(problem, estimate, logs)
    except RecordingError:  # it was built, and is bad
        return diverged(problem)


def diverged(problem: Problem) -> Matrix:
    """Return the squares of blocks of a part, of which the motion diverges."""
    return np.full((BLOCKS_OF_PART, len(problem.model.robot.joint_names)), np.inf)


def block_squares(
    problem: Problem,
    estimate: Estimate,
    logs: Sequence[Recording],
    offsets: Sequence[Matrix] | None = None,
) -> Matrix:
    """Return half of the mean squared error over blocks of rollouts, by joint.

    Their sum over blocks, joints and two parts is the mean of both.

    Parameters
    ----------
    offsets : sequence of ndarray, shape (samples, joints), optional, [N m or N]
        See `replay_errors`.

    Returns
    -------
    ndarray, shape (blocks, joints)

    Raises
    ------
    RecordingError
        If a motion diverges.
    """
    errors = np.vstack(replay_errors(problem, estimate, logs, SEARCH_STEP, offsets))
    blocks = np.array_split(errors, BLOCKS_OF_PART)
    return np.array([(b**2).sum(axis=0) for b in blocks]) / errors.size / 2.0


def joint_weights(squares: Matrix) -> Vector:
    """Return weights by which all joints have equal shares of a sum of squares.

    The sum itself stays as it is.  A joint that hardly moves has no more weight than
    one with `LEAST_LEVEL` of the median error.  Weights are 1 if a motion diverges.

    Parameters
    ----------
    squares : ndarray, shape (blocks, joints)

    Returns
    -------
    ndarray, shape (joints,)
    """
    of_joint = squares.sum(axis=0)
    if not np.isfinite(of_joint).all() or not of_joint.any():
        return np.ones(len(of_joint))
    moving = np.sort(of_joint[of_joint > 0.0])
    middle = moving[(len(moving) - 1) // 2]
    level = np.maximum(of_joint, LEAST_LEVEL**2 * middle)
    return np.asarray(of_joint.sum() / (of_joint / level).sum() / level)


def difference_error(squares: Vector) -> float:
    """Return the standard error of a sum over blocks."""
    return float(np.std(squares, ddof=1) * np.sqrt(len(squares)))


def is_larger(now: Matrix, before: Matrix, *, errors: float | None = None) -> bool:
    """Return whether squared errors of blocks are larger by more than chance (95 %).

    Each joint counts over its level before.  Infinite ones, of motions that diverge,
    are larger than others.

    Parameters
    ----------
    now, before : ndarray, shape (blocks, joints)
    errors : float, optional
        By how many standard errors; by default those of 95 %.
    """
    if not (np.isfinite(now).all() and np.isfinite(before).all()):
        return not np.isfinite(now).all()
    more = (now - before) @ joint_weights(before)
    times = student(len(more)) if errors is None else errors
    return bool(more.sum() > times * difference_error(more))

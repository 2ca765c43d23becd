"""How slow a joint must be for its torque to be left out, from training data alone.

Dry friction of a joint at rest is whatever balances the joint.  Rows that hold it pull
at the parameters; leaving out too many rows leaves noise.  So speeds are tried, each
half of the one before, and at last zero.  Blocks of the motion are left out of the fit
one after another and predicted, always the same rows of them: those that the highest
speed leaves.  Of the speeds whose squared error of these is near the least, the lowest
is chosen.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from consistent_id._support.arrays import Matrix, Vector, freeze_arrays
from consistent_id._support.threads import single_threaded
from consistent_id.constraints import Constraint
from consistent_id.errors import NotExcitedError, ProblemError
from consistent_id.estimation.equalities import FreeParameters, least_squares
from consistent_id.recordings.recording import Recording, several
from consistent_id.recordings.signals.masks import without_rests
from consistent_id.regression.noise import joint_noise
from consistent_id.regression.regression import Regression, build_regression
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.row_names import CONTACT_FREE
from consistent_id.regression.rows.contact_free import (
    base_of_recordings,
    contact_free_model,
    contact_free_regression,
)
from consistent_id.regression.segments import merged

BLOCKS = 6
"""Blocks of the motion, each left out once; as many as `block_scatter` has."""

LEFT = 0.2
"""Share of all rows that the highest speed leaves at the least.

Errors are those of rows in motion; of few they say little.  In the first four logs of
Go2 that `benchmarks/quadruped.py` simulates, of a twentieth of all rows the errors of
speeds differ by as much as their standard error.
"""

GAIN = 0.025
"""Part of the least squared error that leaving out more rows must gain.

As much as a term of a model must gain to be taken.
"""

_EXACT = 1e-6  # error, relative to the torque, below which there is none
_HALF = 0.5  # of all samples of joints that move, slower than the first speed tried
_HALVINGS = 7  # of the speed: the last but zero is a hundredth of the first


@dataclass(frozen=True, slots=True, eq=False)
class RestSpeed:
    """The speed below which a joint rests, and what was tried.

    Parameters
    ----------
    speed : float, [rad/s or m/s]
        Zero if no row needs to be left out.
    tried : ndarray, shape (speeds,)
        From the highest on.
    errors : ndarray, shape (speeds, blocks)
        Error of each block when it was left out, over the block's torque, both in rows
        that the highest speed leaves and weighted.
    """

    speed: float
    tried: Vector
    errors: Matrix

    def __post_init__(self) -> None:
        shapes = {"tried": (None,), "errors": (len(self.tried), None)}
        freeze_arrays(self, shapes, "rest speed")


@single_threaded
def rest_speed(
    model: TorqueModel,
    recordings: Recording | Sequence[Recording],
    *,
    constraints: Sequence[Constraint] = (),
    reach: float = 0.0,
) -> RestSpeed:
    """Choose the speed below which the torque of a joint is not used.

    Parameters
    ----------
    model : TorqueModel
        All rows, or those free of contact forces.
    recordings : Recording or sequence of Recording
        To train on, with velocity, acceleration and torque.
    constraints : sequence of Constraint
        Of these the equalities count, such as known bodies.
    reach : float, [s]
        See `without_rests`.

    Raises
    ------
    ProblemError
        If a recording has no velocity.
    NotExcitedError
        If nothing is left to compare: joints hardly move, or the motion is too short.

    Examples
    --------
    A pendulum, of which friction bears two thirds where it is slower than 0.1 rad/s:

    >>> from consistent_id import DHRow, TorqueModel, from_modified_dh
    >>> robot = from_modified_dh("pendulum", [DHRow(-np.pi / 2, 0)])
    >>> time = 0.01 * np.arange(2000)[:, None]
    >>> q, dq, ddq = np.sin(time), np.cos(time), -np.sin(time)
    >>> borne = np.where(abs(dq) < 0.1, 1 / 3, 1.0)
    >>> log = Recording(("joint1",), time[:, 0], q, dq, ddq, 9.81 * borne * np.cos(q))
    >>> found = rest_speed(TorqueModel(robot), log)
    >>> 0.1 <= found.speed <= 0.2
    True
    """
    logs = several(recordings)
    pieces = _pieces(logs)
    speeds = _median_speed(logs) * 0.5 ** np.arange(_HALVINGS + 1)
    if model.robot.floating and all(log.contacts and not log.wrenches for log in logs):
        model = contact_free_model(model)  # which holds as much, and is soon compressed
    alone = model.torque_joints == (CONTACT_FREE,)
    build = contact_free_regression if alone else _every_row

    def blocks(speed: float) -> list[Regression]:
        masked = [without_rests(p, speed, reach=reach) if speed else p for p in pieces]
        return [build(model, piece) for piece in masked]

    found = _tried(blocks, speeds.tolist())
    tested = merged(found[0].parts)
    sigma = (
        tested.sigma  # there is one row
        if alone
        else joint_noise(model, tested, base=base_of_recordings(model, logs))
    )
    free = FreeParameters.of(constraints, model).determined(tested.weighted(sigma))
    weighted = [[part.weighted(sigma) for part in one.parts] for one in found]
    errors = np.array([_errors(parts, weighted[0], free) for parts in weighted])
    squared = np.maximum(np.mean(errors**2, axis=1), _EXACT**2)
    near = np.flatnonzero(squared <= (1.0 + GAIN) * squared.min())
    tried = np.array([one.speed for one in found])
    return RestSpeed(float(tried[near[-1]]), tried, errors)


class _Tried(NamedTuple):
    """Blocks without the torque of joints slower than a speed."""

    speed: float
    parts: list[Regression]


def _tried(
    blocks: Callable[[float], list[Regression]], speeds: Sequence[float]
) -> list[_Tried]:
    """Return blocks at speeds that leave `LEFT` of all rows, and at zero."""
    every = _Tried(0.0, blocks(0.0))
    least = LEFT * sum(sum(part.counts) for part in every.parts)
    found = []
    for speed in speeds:
        try:
            parts = blocks(speed)
        except NotExcitedError:  # a joint is slower in all of a block
            continue
        if sum(sum(part.counts) for part in parts) >= least:
            found.append(_Tried(speed, parts))
    return [*found, every]


def _errors(
    parts: Sequence[Regression], yardstick: Sequence[Regression], free: FreeParameters
) -> Vector:
    """Return how badly all other parts predict each part's rows of the yardstick."""
    found = []
    for k, tested in enumerate(yardstick):
        R = merged([*parts[:k], *parts[k + 1 :]]).stacked()
        y = least_squares(*free.reduced(R[:, :-1], R[:, -1]))
        R = tested.stacked()
        rest = R @ np.append(free.start + free.directions @ y, -1.0)
        found.append(np.linalg.norm(rest) / np.linalg.norm(R[:, -1]))
    return np.array(found)


def _every_row(model: TorqueModel, recording: Recording) -> Regression:
    return build_regression(model, recording, noise=False)


def _median_speed(logs: Sequence[Recording]) -> float:
    """Return the speed below which half of the samples of joints that move are."""
    known = [log.velocity for log in logs if log.velocity is not None]
    if len(known) < len(logs):
        raise ProblemError("rests show in velocity; call signals.differentiated first")
    speeds = np.concatenate([np.ravel(velocity) for velocity in known])
    moving = abs(speeds[speeds != 0.0])
    if not len(moving):
        raise NotExcitedError("no joint moves, so that rests cannot be told")
    return float(np.quantile(moving, _HALF))


def _pieces(logs: Sequence[Recording]) -> list[Recording]:
    """Cut recordings into about `BLOCKS` pieces of like length."""
    total = sum(map(len, logs))
    found = []
    for log in logs:
        ends = np.linspace(0, len(log), max(round(BLOCKS * len(log) / total), 1) + 1)
        found += [log.samples(slice(*ab)) for ab in pairwise(ends.astype(int).tolist())]
    if len(found) < 2:
        raise NotExcitedError("the motion is too short to be cut into blocks")
    return found

"""The speed below which a joint's torque is left out, from training data alone.

Dry friction of a joint at rest has any value that balances the joint. Rows that contain
it bias the parameters; leaving out too many rows increases the noise. So speeds are
tried, each half of the one before, and at last zero.  Blocks of the motion are left out
of the fit one after another and predicted, always in the same rows: those that the
highest speed leaves.  Among the speeds whose squared error is near the least, the
lowest is chosen.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from consistent_id._support.arrays import Matrix, Vector, freeze_arrays
from consistent_id._support.executors import single_threaded
from consistent_id._support.tables import brief
from consistent_id.constraints import Constraint
from consistent_id.errors import NotExcitedError, ProblemError
from consistent_id.estimation.determination import FreeParameters, least_squares
from consistent_id.recordings.recording import Recording, several
from consistent_id.recordings.signals.masks import without_rests
from consistent_id.recordings.signals.parts import blocks_of
from consistent_id.regression.base import BaseParameters
from consistent_id.regression.regression import Regression, build_regression
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.residual_noise import joint_noise
from consistent_id.regression.row_names import CONTACT_FREE
from consistent_id.regression.rows.contact_free import (
    base_of_recordings,
    contact_free_model,
    masked_factors,
)
from consistent_id.regression.segments import known_torque, merged

BLOCKS = 6
"""Blocks of the motion, each left out once; as many as `block_scatter` has."""

LEFT = 0.1
"""Least share of all rows that the highest speed leaves.

Errors are those of rows in motion; few rows give inaccurate errors.  In the first four
logs of Go2 that `benchmarks/quadruped.py` simulates, with a twentieth of all rows the
errors of speeds differ by as much as their standard error.
"""

_REACHES = (1.0, 2 / 3, 1 / 3)
"""Shares of the reach; the next one is tried if no speed leaves enough rows."""

GAIN = 0.025
"""Least gain of leaving out more rows, as a share of the squared error.

It equals the gain that selects a term of a model.
"""

_EXACT = 1e-6  # error, relative to the torque, that counts as zero
_HALF = 0.5  # of all samples of joints that move, slower than the first speed tried
_HALVINGS = 7  # of the speed: the last but zero is a hundredth of the first


@brief
@dataclass(frozen=True, slots=True, eq=False)
class RestSpeed:
    """The speed below which a joint rests, and the speeds tried.

    Parameters
    ----------
    speed : float, [rad/s or m/s]
        Zero if no row needs to be left out.
    tried : ndarray, shape (speeds,)
        From the highest on.
    errors : ndarray, shape (speeds, blocks)
        Error of each block when it was left out, over the block's torque, both weighted
        and in the rows that the highest speed leaves.
    reach : float, [s]
        Before and after a rest, for which torque is not known, either: the given reach,
        or the part of it that leaves enough rows.
    """

    speed: float
    tried: Vector
    errors: Matrix
    reach: float

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
        Only their equalities are used, such as known bodies.
    reach : float, [s]
        See `without_rests`, and `rest_guard` for filtered recordings.

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
    pieces = blocks_of(logs, BLOCKS)
    speeds = _median_speed(logs) * 0.5 ** np.arange(_HALVINGS + 1)
    if model.robot.floating and all(log.contacts and not log.wrenches for log in logs):
        # Which has the same information, and is compressed fast
        model = contact_free_model(model)
    alone = model.torque_joints == (CONTACT_FREE,)
    free = FreeParameters.of(constraints, model)
    combinations = np.column_stack([free.directions, free.start])
    base = None if alone else base_of_recordings(model, logs)
    for part in _REACHES:
        masked = [_masked(pieces, v, part * reach) for v in (*speeds.tolist(), 0.0)]
        found = (
            _contact_free(model, masked, combinations)
            if base is None
            else _every_row(model, masked, combinations, base)
        )
        if len(found) > 1 or reach == 0.0:
            break
    yardstick = found[0].parts
    turn = _independent(np.vstack(yardstick)[:, :-2])
    errors = np.array([_errors(one.parts, yardstick, turn) for one in found])
    squared = np.maximum(np.mean(errors**2, axis=1), _EXACT**2)
    near = np.flatnonzero(squared <= (1.0 + GAIN) * squared.min())
    tried = np.array([one.speed for one in found])
    return RestSpeed(float(tried[near[-1]]), tried, errors, part * reach)


def _independent(A: Matrix) -> Matrix:
    """Return independent combinations of columns that span the row space."""
    size = A.shape[1]
    return FreeParameters(np.zeros(size), np.eye(size)).spanned(A).directions


class _Masked(NamedTuple):
    """Blocks without the torque of joints slower than a speed."""

    speed: float
    blocks: list[Recording]


class _TriedSpeed(NamedTuple):
    """Each block's weighted rows at a speed.

    Columns: the free directions, the known part, and last the torque.
    """

    speed: float
    parts: list[Matrix]


def _masked(pieces: Sequence[Recording], speed: float, reach: float) -> _Masked:
    left = [without_rests(p, speed, reach=reach) if speed else p for p in pieces]
    return _Masked(speed, left)


def _contact_free(
    model: TorqueModel, masked: Sequence[_Masked], combinations: Matrix
) -> list[_TriedSpeed]:
    """Return rows that no contact force enters, at speeds that leave enough of them."""
    parts = [
        masked_factors(model, block, combinations)
        for block in zip(*(one.blocks for one in masked), strict=True)
    ]
    of_speeds = list(zip(*parts, strict=True))
    least = LEFT * sum(part.rows for part in of_speeds[-1])
    return [
        _TriedSpeed(one.speed, [part.factor for part in parts])
        for one, parts in zip(masked, of_speeds, strict=True)
        if all(part.rows for part in parts)
        and sum(part.rows for part in parts) >= least
        and _tells_of_each_joint(one.blocks, masked[-1].blocks)
    ]


def _tells_of_each_joint(
    blocks: Sequence[Recording], whole: Sequence[Recording]
) -> bool:
    """Return whether each joint that had torque still has some."""
    left, had = (
        np.any([known_torque(block).any(axis=0) for block in some], axis=0)
        for some in (blocks, whole)
    )
    return bool((left | ~had).all())


def _every_row(
    model: TorqueModel,
    masked: Sequence[_Masked],
    combinations: Matrix,
    base: BaseParameters,
) -> list[_TriedSpeed]:
    """Return all rows, weighted, at speeds that leave enough of them."""
    found = []
    for one in masked:
        try:
            built = [build_regression(model, b, noise=False) for b in one.blocks]
        except NotExcitedError:  # a joint is slower in all of a block
            continue
        found.append((one.speed, built))
    least = LEFT * _rows(found[-1][1])
    enough = [(speed, built) for speed, built in found if _rows(built) >= least]
    sigma = joint_noise(model, merged(enough[0][1]), base=base)
    tried = []
    for speed, built in enough:
        stacked = [part.weighted(sigma).stacked() for part in built]
        parts = [np.column_stack([R[:, :-1] @ combinations, R[:, -1]]) for R in stacked]
        tried.append(_TriedSpeed(speed, parts))
    return tried


def _rows(parts: Sequence[Regression]) -> int:
    return sum(sum(part.counts) for part in parts)


def _errors(
    parts: Sequence[Matrix], yardstick: Sequence[Matrix], turn: Matrix
) -> Vector:
    """Return the error of each part's test rows, predicted from all other parts."""
    found = []
    for k, tested in enumerate(yardstick):
        R = np.vstack([*parts[:k], *parts[k + 1 :]])
        y = turn @ least_squares(R[:, :-2] @ turn, R[:, -1] - R[:, -2])
        rest = tested @ np.concatenate([y, [1.0, -1.0]])
        found.append(np.linalg.norm(rest) / np.linalg.norm(tested[:, -1]))
    return np.array(found)


def _median_speed(logs: Sequence[Recording]) -> float:
    """Return the speed below which half of the samples of joints that move are."""
    known = [log.velocity for log in logs if log.velocity is not None]
    if len(known) < len(logs):
        raise ProblemError("rests show in velocity; call signals.differentiated first")
    speeds = np.concatenate([np.ravel(velocity) for velocity in known])
    moving = abs(speeds[speeds != 0.0])
    if not len(moving):
        raise NotExcitedError("no joint moves, so rests cannot be distinguished")
    return float(np.quantile(moving, _HALF))

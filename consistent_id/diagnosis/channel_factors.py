"""A motion compressed once, with every torque channel as a right-hand side.

A reversed, exchanged or scaled torque channel is then a combination of columns of small
triangular factors: neither the motion nor the regressor is needed again.

The best constrained fit of one log also bounds the misfits of others
(`half_spaces_at`).  Its squared misfit rises from its base parameters ``b`` towards
every possible robot ``v``: ``slope.(v - b) >= 0``, with ``slope`` its gradient.  This
follows from the constraints alone, so the misfit to another log is at least that of
least squares in this half-space, which takes one triangular solve.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from consistent_id._support.arrays import Array, BoolArray, IntArray, Matrix, Vector
from consistent_id._support.executors import all_but_each
from consistent_id.constraints.cones.certificate import GAP_TOLERANCE
from consistent_id.estimation.best_fit import BestFit
from consistent_id.recordings.recording import Recording
from consistent_id.regression.base import BaseParameters
from consistent_id.regression.linear import DATA_RANK_TOLERANCE
from consistent_id.regression.motion_arrays import Motion
from consistent_id.regression.recorded_motion import motion_of
from consistent_id.regression.regression import Regression, triangle
from consistent_id.regression.regressor import CHUNK, TorqueModel

_LEAST = 1e-12  # N m or N: least divisor in place of a torque of zero


@dataclass(frozen=True, slots=True, eq=False)
class ChannelFactors:
    """Triangular factors of one motion.

    Parameters
    ----------
    factors : tuple of ndarray, each shape (rows, base + torque joints)
        One for each torque joint: its base columns, then all torque channels.
    samples : int
        Number of samples in each factor.
    """

    model: TorqueModel
    base: BaseParameters
    factors: tuple[Matrix, ...]
    samples: int

    def changed(self, matrix: Matrix) -> "ChannelFactors":
        """Return the factors with torque multiplied by a matrix from the right.

        Parameters
        ----------
        matrix : ndarray, shape (joints, joints)
        """
        b, names = len(self.base), self.model.robot.joint_names
        places = [names.index(name) for name in self.model.torque_joints]
        among = matrix[np.ix_(places, places)]
        changed = (np.column_stack([F[:, :b], F[:, b:] @ among]) for F in self.factors)
        return replace(self, factors=tuple(changed))

    def relative(self, misfit: float) -> float:
        """Return a norm of weighted rows as a root of their mean square."""
        return misfit / float(np.sqrt(self.samples * len(self.factors)))

    def least_misfit(self) -> float:
        """Return the misfit of least squares, a lower bound under any constraint.

        Root of the mean over joints of the squared residual over the squared torque.
        """
        return _misfit([row.T for row in self._relative()])

    def least_misfits(self, scales: Sequence[float]) -> Matrix:
        """Return `least_misfit` with one joint's torque at a time times each scale.

        Returns
        -------
        ndarray, shape (joints, scales)
        """
        # A scale of the torque divides the joint's columns, relative to that torque.
        own = [_stacked(rows) for rows in self._relative()]
        others = all_but_each(own, _stacked)
        divided = np.ones((len(scales), own[0].shape[1]))
        divided[:, :-1] = np.reshape(scales, (-1, 1))
        return np.array(
            [
                [_last(_stacked(rest, row / by)) for by in divided]
                for row, rest in zip(own, others, strict=True)
            ]
        )

    def joined(self) -> Matrix:
        """Return the triangular factor of all joints' base columns and own torque.

        Its norms are misfits relative to the torque, as `relative` returns them.
        """
        return _stacked(*self._relative())

    def _relative(self) -> list[Matrix]:
        b, root = len(self.base), np.sqrt(len(self.factors))
        return [
            F[:, [*range(b), b + j]]
            / (root * max(float(np.linalg.norm(F[:, b + j])), _LEAST))
            for j, F in enumerate(self.factors)
        ]

    def regression(self) -> Regression:
        """Return the regression, each joint relative to its own torque."""
        b, P = len(self.base), self.base.projection
        bare = Regression(
            layout=self.model.layout,
            joints=self.model.torque_joints,
            factors=tuple(
                np.column_stack([F[:, :b] @ P, F[:, b + j]])
                for j, F in enumerate(self.factors)
            ),
            counts=(self.samples,) * len(self.factors),
            fingerprint=self.model.fingerprint,
        )
        return bare.weighted(np.maximum(bare.torque_rms, _LEAST))


def _misfit(columns: Sequence[Matrix]) -> float:
    """Return the least norm of joints' rows; the last of their columns is the torque.

    Parameters
    ----------
    columns : sequence of ndarray, each shape (columns, rows)
    """
    squares = 0.0
    for joints, places in _limbs(columns):
        own = np.concatenate([columns[j][[*places, -1]] for j in joints], axis=1)
        squares += _last(triangle(own.T)) ** 2
    return float(np.sqrt(squares))


def _limbs(columns: Sequence[Matrix]) -> list[tuple[list[int], IntArray]]:
    """Return joints that share columns, and these columns, such as those of a leg."""
    groups: list[tuple[list[int], BoolArray]] = []
    for j, row in enumerate(columns):
        own = row[:-1].any(axis=1)
        joined = [g for g in groups if (g[1] & own).any()]
        groups = [g for g in groups if not (g[1] & own).any()]
        joints = [k for g in joined for k in g[0]] + [j]
        groups.append((joints, np.any([own, *(g[1] for g in joined)], axis=0)))
    return [(joints, np.flatnonzero(columns)) for joints, columns in groups]


def _stacked(*rows: Matrix) -> Matrix:
    return triangle(np.asfortranarray(np.vstack(rows)))


def _last(R: Matrix) -> float:
    """Return the norm of the last column orthogonal to the others."""
    return float(abs(R[-1, -1])) if len(R) == R.shape[1] else 0.0


def channel_factors(
    model: TorqueModel,
    base: BaseParameters,
    recordings: Sequence[Recording],
    *,
    drives: Sequence[Recording | None] | None = None,
) -> list[ChannelFactors]:
    """Compress motions with all torque channels.

    The regressor is computed for several short motions at once, which is faster.

    Parameters
    ----------
    recordings : sequence of Recording
        With velocity, acceleration and torque.
    drives : sequence of Recording or None, optional
        Motions from which the drives' columns are taken, if not from `recordings`.
    """
    found = []
    for motion, rows in _rows_of(model, base, recordings, drives):
        factors = tuple(joint_factor(of_joint, motion.torque) for of_joint in rows)
        found.append(ChannelFactors(model, base, factors, len(motion.q)))
    return found


def least_misfits(
    model: TorqueModel,
    base: BaseParameters,
    recordings: Sequence[Recording],
    *,
    drives: Sequence[Recording | None] | None = None,
) -> list[float]:
    """Return `ChannelFactors.least_misfit` of recordings, whose factors nobody needs.

    For the parameters see `channel_factors`.
    """
    found = []
    for motion, rows in _rows_of(model, base, recordings, drives):
        joints = zip(rows, motion.torque.T, strict=True)
        root = np.sqrt(len(rows))
        found.append(
            _misfit(
                [
                    np.concatenate([own, torque[None]])
                    / (root * max(float(np.linalg.norm(torque)), _LEAST))
                    for own, torque in joints
                ]
            )
        )
    return found


def _rows_of(
    model: TorqueModel,
    base: BaseParameters,
    recordings: Sequence[Recording],
    drives: Sequence[Recording | None] | None,
) -> Iterator[tuple[Motion, Array]]:
    """Yield motions, and the base columns along each, as `_columns`."""
    others = [None] * len(recordings) if drives is None else drives
    each = {id(log): log for log in others if log is not None}
    read = {key: _drive_rows(model, base, log) for key, log in each.items()}
    placed = _of_drives(model, base)
    motions = [motion_of(model, recording, None) for recording in recordings]
    columns = _columns(model, base, motions)
    for motion, rows, other in zip(motions, columns, others, strict=True):
        if other is not None:
            rows[:, placed] = read[id(other)]
        yield motion, rows


def _columns(
    model: TorqueModel, base: BaseParameters, motions: Sequence[Motion]
) -> Iterator[Array]:
    """Yield the base columns along each motion, (joints, columns, samples).

    Where the torque is filtered, they are filtered alike.
    """
    kept = list(base.independent)
    if any(motion.filtered is not None for motion in motions):
        for motion in motions:
            yield motion.regressor(model)[:, kept]
        return
    longest = max((len(m.q) for m in motions), default=1)
    together = max(CHUNK // longest, 1)
    for start in range(0, len(motions), together):
        group = motions[start : start + together]
        states = (np.concatenate(x) for x in list(zip(*group, strict=True))[:3])
        ends = np.cumsum([len(m.q) for m in group])
        yield from np.split(model.regressor(*states)[:, kept], ends[:-1], axis=2)


def _of_drives(model: TorqueModel, base: BaseParameters) -> BoolArray:
    """Return the base columns that belong to drives."""
    return np.asarray(np.array(base.independent) >= 10 * len(model.robot))


def _drive_rows(model: TorqueModel, base: BaseParameters, log: Recording) -> Array:
    """Return the drives' base columns along a motion, (joints, columns, samples)."""
    (columns,) = _columns(model, base, [motion_of(model, log, None)])
    return columns[:, _of_drives(model, base)]


def joint_factor(Y: Array, torque: Array) -> Matrix:
    """Return a joint's factor; zero columns are skipped."""
    kept = Y.any(axis=1)
    R = triangle(np.concatenate([Y[kept], torque.T]).T)
    factor = np.zeros((len(R), len(Y) + torque.shape[1]))
    factor[:, [*np.flatnonzero(kept), *range(len(Y), factor.shape[1])]] = R
    return factor


@dataclass(frozen=True, slots=True, eq=False)
class TangentHalfSpace:
    """``slope.(v - point) >= 0`` for the base parameters ``v`` of possible robots.

    Parameters
    ----------
    slope, point : ndarray, shape (base,)
    """

    slope: Vector
    point: Vector


def half_spaces_at(factors: ChannelFactors, fit: BestFit) -> list[TangentHalfSpace]:
    """Return the half-space at a log's best constrained fit, if the fit is certified.

    The list is empty if constraints do not raise the misfit, because the slope is
    rounding.

    Parameters
    ----------
    factors : ChannelFactors
    fit : BestFit
        Constrained fit to the factors.
    """
    if fit.optimality.verdict != "certified":
        return []
    R = factors.joined()
    point = factors.base.projection @ fit.parameters
    rest = R @ np.append(point, -1.0)
    cost = float(np.sum(rest[:-1] ** 2))
    if cost <= GAP_TOLERANCE * float(np.sum(rest**2)):
        return []
    return [TangentHalfSpace(R[:, :-1].T @ rest, point)]


def least_within(R: Matrix, half_spaces: Sequence[TangentHalfSpace]) -> float:
    """Return the largest of the half-spaces' least norms of ``R [v, -1]``.

    Parameters
    ----------
    R : ndarray, shape (base + 1, base + 1)
        Triangular; see `ChannelFactors.joined`.  If it does not determine all base
        parameters, the half-spaces are ignored.
    half_spaces : sequence of TangentHalfSpace
    """
    from scipy.linalg import solve_triangular

    n = R.shape[1] - 1
    A, least = R[:n, :n], float(np.linalg.norm(R[n:, n]))
    norms = np.linalg.norm(A, axis=0)
    if len(A) < n or (abs(np.diag(A)) <= DATA_RANK_TOLERANCE * norms).any():
        return least
    free = solve_triangular(A, R[:n, n])
    beyond = [0.0]
    for each in half_spaces:
        outside = float(each.slope @ (each.point - free))
        turned = solve_triangular(A, each.slope, trans="T")
        if outside > 0.0:
            beyond.append(outside / float(np.linalg.norm(turned)))
    return float(np.hypot(least, max(beyond)))

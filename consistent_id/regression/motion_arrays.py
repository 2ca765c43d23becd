"""A recording's arrays in a torque model's order of joints, and rows along them.

Rows may be filtered and thinned out.  A filter on motion and torque leaves the
equations only nearly true: the regressor is not linear in the motion, least of all
where a joint turns back and friction jumps.  A filter on the rows themselves and on the
torque (`RowFilter`) leaves them exactly true, ``sum_k h_k Y_k x = sum_k h_k tau_k``,
whatever the weights of the rows.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from consistent_id._support.arrays import (
    Array,
    BoolArray,
    IntArray,
    Matrix,
    Vector,
    frozen,
)
from consistent_id.errors import ProblemError, RecordingError
from consistent_id.recordings.beside import BaseMotion
from consistent_id.recordings.recording import Recording, states
from consistent_id.regression.regressor import CHUNK, TorqueModel
from consistent_id.regression.rows.contact_maps import ContactMixing, contact_mixing
from consistent_id.regression.rows.generalised_forces import measured_forces

_REACH = 8  # kept samples on either side that one is mixed from
_PIECE = 4 * CHUNK  # samples that one worker compresses before factors are merged
_PASSED = 0.8  # cut-off over the new Nyquist frequency


class Motion(NamedTuple):
    """A recording's arrays in the model's order of joints, all of one length.

    Torque and weights are those of the model's torque joints.  Where forces of contacts
    are not measured, `mixing` takes them out: the torque is what is left, `peaks` are
    those of the torque before, and `shares` are what is left of each row's squared
    noise.
    """

    q: Array
    dq: Array
    ddq: Array
    torque: Array
    weights: Array | None
    base: BaseMotion | None = None
    mixing: ContactMixing | None = None
    peaks: Vector | None = None
    shares: Array | None = None

    def samples(self, start: int, stop: int) -> "Motion":
        """Return consecutive samples."""
        part = slice(start, stop)
        weights = None if self.weights is None else self.weights[part]
        state = self.q[part], self.dq[part], self.ddq[part]
        base = None if self.base is None else self.base.samples(part)
        mixing = None if self.mixing is None else self.mixing.samples(part)
        shares = None if self.shares is None else self.shares[part]
        return Motion(
            *state, self.torque[part], weights, base, mixing, self.peaks, shares
        )

    def counts(self, rows: range) -> IntArray:
        """Return how many of the rows count as samples of each joint's torque."""
        whole = np.full(self.torque.shape[1], len(rows))
        if self.weights is not None:
            whole = np.count_nonzero(self.weights[rows], axis=0)
        if self.shares is None:
            return whole
        # A row of which contacts take almost all still is a row.
        counted = True if self.weights is None else self.weights[rows] != 0.0
        left = np.rint(self.shares[rows].sum(axis=0, where=counted))
        return np.asarray(np.clip(left, np.minimum(whole, 1), None).astype(np.intp))

    @property
    def counted(self) -> BoolArray:
        """Whether each row counts, shape (samples, rows)."""
        there = np.ones(self.torque.shape, dtype=bool)
        if self.weights is not None:
            there &= self.weights != 0.0
        if self.shares is not None:
            there &= self.shares > 0.0
        return there

    def noise_lost(self, rows: range) -> Vector:
        """Return the noise of each row before it was mixed, over what is left of it.

        The rest is in the other rows, whose noise is like this one's.
        """
        if self.shares is None:
            return np.ones(self.torque.shape[1])
        left = np.maximum(self.shares[rows].mean(axis=0), 1.0 / len(rows))
        return np.asarray(1.0 / np.sqrt(left))

    def predicted(self, model: TorqueModel, x: Vector) -> Array:
        """Return the torque of parameters along the motion, as `torque` is given."""
        whole = model.predict(x, self.q, self.dq, self.ddq, base=self.base)
        return whole if self.mixing is None else self.mixing.mixed(whole)

    def rows(
        self, model: TorqueModel, kept: Sequence[IntArray], size: int = CHUNK
    ) -> Iterator[tuple[slice, Sequence[Matrix]]]:
        """Yield ``(samples, rows)`` with torque in the last column, weights applied.

        Parameters
        ----------
        kept : sequence of ndarray
            Of each torque joint the columns wanted.
        size : int
            Samples in a piece.

        Yields
        ------
        samples : slice
        rows : sequence of ndarray, each shape (samples, columns wanted + 1)
            In Fortran's order.  The arrays are reused, and may be destroyed.
        """
        for part, blocks in self._blocks(model, kept, size):
            for j, block in enumerate(blocks):
                block[:, -1] = self.torque[part, j]
                if self.weights is not None:
                    block *= self.weights[part, j, None]
            yield part, blocks

    def _blocks(
        self, model: TorqueModel, kept: Sequence[IntArray], size: int
    ) -> Iterator[tuple[slice, Sequence[Matrix]]]:
        state = self.q, self.dq, self.ddq
        if self.mixing is None:
            yield from model.kept_chunks(kept, *state, size=size, base=self.base)
            return
        wanted = np.unique(np.concatenate(kept))
        places = [np.searchsorted(wanted, columns) for columns in kept]
        for part, Y in model.chunks(*state, size=size, base=self.base):
            blocks = [np.empty((Y.shape[2], len(c) + 1), order="F") for c in kept]
            for few, maps in self.mixing.samples(part).chunks():
                rows = np.moveaxis(Y[:, wanted, few], 2, 0)
                mixed = maps @ np.ascontiguousarray(rows)
                for j, (block, columns) in enumerate(zip(blocks, places, strict=True)):
                    block[few, :-1] = mixed[:, j, columns]
            yield part, blocks


def motion_of(
    model: TorqueModel, recording: Recording, weights: Array | None
) -> Motion:
    """Return a recording's arrays as a model wants them.

    Raises
    ------
    RecordingError
        If a channel or a joint is missing, or the motion of a base that floats.
    """
    if model.robot.floating:
        tau, base = measured_forces(model, recording), recording.base
    else:
        tau, base = recording.of(model.torque_joints).torque, None
    q, dq, ddq = _state(model, recording)
    if dq is None or ddq is None or tau is None:
        given = {"velocity": dq, "acceleration": ddq, "torque": tau}
        missing = [name for name, values in given.items() if values is None]
        raise RecordingError(
            f"{recording.name} has no {' and no '.join(missing)}; velocity and "
            "acceleration come from signals.differentiated(recording)"
        )
    if weights is not None:
        weights = frozen(weights, tau.shape, f"row_weights of {recording.name}")
    unknown = _unknown_rows(model, recording)
    if unknown is not None:
        weights = np.where(unknown, 0.0, 1.0 if weights is None else weights)
    motion = Motion(q, dq, ddq, tau, weights, base)
    mixing = _mixing(model, recording)
    if mixing is None:
        return motion
    if weights is not None and not weights.all():
        left_out = weights == 0.0
        if unknown is None or (left_out != unknown).any():
            mixing = replace(mixing, unknown=left_out, held=None)
    return _without_contacts(motion, mixing)


@lru_cache(maxsize=4)
def _mixing(model: TorqueModel, recording: Recording) -> ContactMixing | None:
    """Return how a recording's rows are mixed, with its maps held.

    A study goes along the same few recordings again and again, and finding maps takes
    longer than all else that is done with them.
    """
    unknown = _unknown_rows(model, recording)
    found = contact_mixing(model.robot, model.torque_joints, recording, unknown)
    return None if found is None else found.holding()


def _unknown_rows(model: TorqueModel, recording: Recording) -> BoolArray | None:
    """Return where a row holds what the model does not say, shape (samples, rows)."""
    known, joints = recording.torque_known, recording.joints
    if known is None or known.all():
        return None
    rows = [
        ~known[:, joints.index(name)] if name in joints else np.zeros(len(known), bool)
        for name in model.torque_joints
    ]
    return np.column_stack(rows)


def _state(
    model: TorqueModel, recording: Recording
) -> tuple[Array, Array | None, Array | None]:
    """Return position, velocity and acceleration in the robot's order of joints."""
    if not len(model.robot):  # one body, all of whose motion is the base's
        still = np.zeros((len(recording), 0))
        return still, still, still
    log = recording.of(model.robot.joint_names)
    return log.position, log.velocity, log.acceleration


def _without_contacts(motion: Motion, mixing: ContactMixing) -> Motion:
    """Return a motion whose torque holds no force of unmeasured contacts."""
    torque, shares = np.empty((2, *motion.torque.shape))
    for part, maps in mixing.chunks():
        torque[part] = (maps @ motion.torque[part, :, None])[:, :, 0]
        shares[part] = np.diagonal(maps, axis1=1, axis2=2)
    peaks = abs(motion.torque).max(axis=0)
    return motion._replace(torque=torque, mixing=mixing, peaks=peaks, shares=shares)


def predicted_torque(model: TorqueModel, x: Vector, recording: Recording) -> Array:
    """Return the torque of parameters along a recording, whether it has torque or not.

    Without forces of unmeasured contacts, as in `Motion`.

    Raises
    ------
    ProblemError
        If the recording has no velocity or acceleration.
    """
    q, dq, ddq = _state(model, recording)
    if dq is None or ddq is None:
        raise ProblemError(
            f"{recording.name}: torques need velocity and acceleration; call "
            "signals.differentiated(recording) first"
        )
    whole = model.predict(x, q, dq, ddq, base=recording.base)
    mixing = _mixing(model, recording)
    return whole if mixing is None else mixing.mixed(whole)


def simulate_torque(
    model: TorqueModel,
    parameters: ArrayLike,
    motion: Recording,
    *,
    noise: ArrayLike = 0.0,
    rng: np.random.Generator | None = None,
) -> Recording:
    """Return a motion with the torques of known parameters, and white noise on them.

    All joints get their torque, also those whose torque the model does without.

    Parameters
    ----------
    model : TorqueModel
    parameters : array_like, shape (parameters,)
    motion : Recording
        With velocity and acceleration.
    noise : array_like, shape () or (joints,), [N m or N]
        Standard deviation.
    rng : numpy.random.Generator, optional
        Needed for noise.
    """
    motion = motion.of(model.robot.joint_names)
    torque = replace(model, torque_joints=()).predict(parameters, *states(motion))
    shape = torque.shape[1:] if np.ndim(noise) else ()
    sigma = frozen(noise, shape, "noise")
    if sigma.any():
        if rng is None:
            raise ProblemError("noise needs a random generator; pass rng=")
        torque = torque + rng.normal(size=torque.shape) * sigma
    return replace(motion, torque=torque, name=f"{motion.name} (simulated)")


@dataclass(frozen=True)
class RowFilter:
    """Keeps every `factor`-th row, each mixed from those around it, without lag.

    Parameters
    ----------
    factor : int
        1 keeps the rows as they are.
    """

    factor: int = 1

    def __post_init__(self) -> None:
        if not isinstance(self.factor, int) or self.factor < 1:
            raise ProblemError(
                f"decimation factor is {self.factor!r}, expected 1, 2, 3, ..."
            )

    @property
    def reach(self) -> int:
        """Samples on either side of a row that have a part in it."""
        return 0 if self.factor == 1 else _REACH * self.factor

    @cached_property
    def kernel(self) -> Vector:
        """Symmetric, of sum 1: a windowed sinc at 0.8 of the new Nyquist frequency."""
        from scipy.signal import firwin

        return np.asarray(firwin(2 * self.reach + 1, _PASSED / self.factor))

    def centres(self, samples: int, name: str) -> range:
        """Return the samples whose rows are kept, all with their full reach.

        Raises
        ------
        RecordingError
            If there is none.
        """
        kept = range(self.reach, samples - self.reach, self.factor)
        if len(kept) == 0:
            raise RecordingError(
                f"{name}: {samples} samples, of which the filter for a decimation by "
                f"{self.factor} takes {2 * self.reach + 1} for one row"
            )
        return kept

    def pieces(self, centres: range) -> Iterator[slice]:
        """Yield samples that are compressed in one go, with a reach on either side."""
        if self.factor == 1:
            size = _PIECE
        else:
            size = max((CHUNK - 2 * self.reach) // self.factor, 4 * _REACH)
        for first in range(0, len(centres), size):
            some = centres[first : first + size]
            yield slice(some[0] - self.reach, some[-1] + self.reach + 1)

    def __call__(self, rows: Matrix) -> Array:
        """Return the kept rows of a piece that begins and ends a reach beyond them."""
        if self.factor == 1:
            return rows
        from scipy.signal import upfirdn

        mixed = upfirdn(self.kernel, rows, down=self.factor, axis=0)
        first = 2 * _REACH
        last = (len(rows) - 1) // self.factor
        return np.asarray(mixed[first : last + 1])

"""Rows free of contact forces, with other unknown torques or contacts, for one price.

The regressor of a motion is the same whatever torque is known, and wherever contacts
are.  It is computed once, for some combinations of parameters: of a robot whose bodies
are known those that are free are few, and compression is that much cheaper.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from consistent_id._support.arrays import Array, BoolArray, IntArray, Matrix
from consistent_id._support.threads import worker_threads
from consistent_id.recordings.recording import Recording
from consistent_id.regression.motion_arrays import Motion, motion_of
from consistent_id.regression.regression import triangle
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.rows.contact_free import (
    CHUNK,
    WORKERS,
    MappedRows,
    every_row,
    mapped_rows,
)
from consistent_id.regression.rows.contact_maps import contact_maps

_NONE = 1e-12  # part of a parameter in a combination that is rounding


def masked_factors(
    model: TorqueModel,
    recordings: Sequence[Recording],
    combinations: Matrix,
) -> list[MappedRows]:
    """Return a triangular factor for each recording, of combinations of parameters.

    Parameters
    ----------
    model : TorqueModel
        With the rows `CONTACT_FREE`, see `contact_free_model`.
    recordings : sequence of Recording
        Of the same motion; other torques are known, or contacts are elsewhere.
    combinations : ndarray, shape (parameters, k)

    Returns
    -------
    list of MappedRows
        Of the columns ``Y combinations``, and last the torque.
    """
    whole = every_row(model)
    motions = [motion_of(whole, replace(log, contacts=()), None) for log in recordings]
    used = np.flatnonzero((abs(combinations) > _NONE).any(axis=1))
    levels = np.ones(len(whole.torque_joints))

    def compressed(begin: int) -> list[MappedRows]:
        parts = [motion.samples(begin, begin + CHUNK) for motion in motions]
        rows = _combined(whole, parts[0], used, combinations[used])
        span = slice(begin, begin + len(rows))
        turned = None if parts[0].base is None else parts[0].base.rotation
        found = []
        for log, part in zip(recordings, parts, strict=True):
            flags = [contact.samples(span) for contact in log.contacts]
            unknown = None if part.weights is None else part.weights == 0.0
            known = rows if unknown is None else _without(rows, unknown)
            where = whole.robot, part.q, flags, levels, turned
            maps = contact_maps(*where, unknown=unknown)
            found.append(mapped_rows(known, maps, unknown))
        return found

    with worker_threads(WORKERS) as pool:
        chunks = list(pool.map(compressed, range(0, len(recordings[0]), CHUNK)))
    return [_joined(parts) for parts in zip(*chunks, strict=True)]


def _combined(
    whole: TorqueModel, motion: Motion, used: IntArray, combinations: Matrix
) -> Array:
    """Return rows of combinations of the columns in use, and the torque."""
    n = len(motion.q)
    state = motion.q, motion.dq, motion.ddq
    ((_, Y),) = whole.chunks(*state, size=n, base=motion.base)
    rows = np.empty((n, Y.shape[0], combinations.shape[1] + 1))
    np.matmul(np.moveaxis(Y[:, used], 2, 0), combinations, out=rows[:, :, :-1])
    rows[:, :, -1] = motion.torque
    return rows


def _without(rows: Array, unknown: BoolArray) -> Array:
    left = rows.copy()
    left[unknown] = 0.0
    return left


def _joined(parts: Sequence[MappedRows]) -> MappedRows:
    factor = triangle(np.asfortranarray(np.vstack([part.factor for part in parts])))
    peak = max(part.peak for part in parts)
    return MappedRows(factor, sum(part.rows for part in parts), peak)

"""The regression of a robot that stands or walks, without force sensors in its feet.

The regressor of a motion is the same whatever torque is known, and wherever contacts
are.  `masked_factors` computes it once for several of these, for some combinations of
parameters: of a robot whose bodies are known those that are free are few, and
compression is that much cheaper.
"""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from consistent_id._support.arrays import (
    Array,
    BoolArray,
    IntArray,
    Matrix,
    Vector,
    checked,
    chunks,
)
from consistent_id._support.executors import single_threaded, worker_threads
from consistent_id.errors import NotExcitedError, ProblemError
from consistent_id.recordings.beside import ContactFlags
from consistent_id.recordings.recording import Recording, several
from consistent_id.recordings.signals.filtered_rows import places_of_rows, row_filter
from consistent_id.regression.base import BaseParameters, base_parameters
from consistent_id.regression.linear import split_at_gap
from consistent_id.regression.motion_arrays import Motion
from consistent_id.regression.recorded_motion import motion_of
from consistent_id.regression.regression import Regression, triangle
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.row_names import CONTACT_FREE, row_names
from consistent_id.regression.row_structure import (
    random_regressor,
    random_states,
    row_structure,
)
from consistent_id.regression.rows.contact_maps import (
    CHUNK,
    ContactMixing,
    RowMap,
    row_numbers,
    unmeasured_contacts,
)

WORKERS = 2
_EVERY = np.ones(0, dtype=bool)  # no flags: every sample is certain
_NONE = 1e-12  # part of a parameter in a combination that is rounding


@single_threaded
def contact_free_regression(
    model: TorqueModel,
    recordings: Recording | Sequence[Recording],
    *,
    sigma: ArrayLike | None = None,
) -> Regression:
    """Compress recordings into the rows that no unmeasured contact force enters.

    Parameters
    ----------
    model : TorqueModel
        With the rows `CONTACT_FREE`, see `contact_free_model`.
    recordings : Recording or sequence of Recording
        With velocity, acceleration, torque, base motion and contacts.
    sigma : array_like, shape (6 + joints,), optional
        Noise levels of the rows before they are mixed, see `row_levels`; by default
        ones.

    Returns
    -------
    Regression
        Regression of one factor; its counts are rows, in units of `sigma`.

    Raises
    ------
    RecordingError
        If a channel, a joint or the motion of the base is missing.
    NotExcitedError
        If no sample has a row.
    """
    whole = every_row(model)
    rows = len(whole.torque_joints)
    levels = _levels(sigma, rows)
    kept, expand = row_structure(whole, mixed=True)[0]
    pieces = [
        (
            tuple(flags.samples(part) for flags in recording.contacts),
            motion.samples(part.start, part.stop),
        )
        for recording in several(recordings)
        for bare in [replace(_at_samples(recording), contacts=())]
        for motion in [motion_of(whole, bare, None)]
        for part in chunks(len(motion.q), CHUNK)
    ]

    def compressed(piece: tuple[tuple[ContactFlags, ...], Motion]) -> MappedRows:
        return _compress(whole, kept, *piece, levels)

    R: Matrix = np.zeros((0, len(kept) + 1))
    count, peak = 0, 0.0
    with worker_threads(WORKERS) as pool:
        for part in pool.map(compressed, pieces):
            R = triangle(np.asfortranarray(np.vstack([R, part.factor])))
            count, peak = count + part.rows, max(peak, part.peak)
    if not count:
        raise NotExcitedError(
            "no sample has a row that is free of contact forces: every one has an "
            "uncertain contact, or as many contacts as leave no row"
        )
    return Regression(
        layout=model.layout,
        joints=model.torque_joints,
        factors=(np.hstack([R[:, :-1] @ expand, R[:, -1:]]),),
        counts=(count,),
        fingerprint=model.fingerprint,
        peaks=np.array([peak]),
    )


def _at_samples(recording: Recording, kept: IntArray | None = None) -> Recording:
    """Return a recording whose rows are those of its samples, or of some of them.

    The number of rows that no contact force enters changes with the contacts, so that
    they cannot be filtered along time: torque stays filtered, rows are not.
    """
    recording = replace(recording, torque_filter=None)
    return recording if kept is None else recording.samples(kept)


def _worth_keeping(recording: Recording) -> IntArray:
    """Return the samples of a recording that its filter leaves independent."""
    behind = recording.torque_filter
    if behind is None:
        return np.arange(len(recording))
    return places_of_rows(behind, row_filter(recording).step)


def contact_free_model(model: TorqueModel) -> TorqueModel:
    """Return a floating robot's model whose rows no contact force enters.

    Raises
    ------
    ProblemError
        If the base is fixed.
    """
    if not model.robot.floating:
        raise ProblemError(
            f"robot {model.robot.name!r} has a fixed base, which bears its contact "
            "forces; load it with base='floating'"
        )
    return replace(model, torque_joints=(CONTACT_FREE,), wrench_bias=False)


class MappedRows(NamedTuple):
    """The result of one chunk: a triangular factor, its rows, the largest torque."""

    factor: Matrix
    rows: int
    peak: float


def _compress(
    whole: TorqueModel,
    kept: IntArray,
    contacts: tuple[ContactFlags, ...],
    motion: Motion,
    levels: Vector,
) -> MappedRows:
    """Return the triangular factor of the kept columns, free of contact forces."""
    n = len(motion.q)
    state = motion.q, motion.dq, motion.ddq
    ((_, Y),) = whole.chunks(*state, size=n, base=motion.base)
    rows = np.empty((n, Y.shape[0], len(kept) + 1))
    rows[:, :, :-1] = np.moveaxis(Y[:, kept], 2, 0)
    rows[:, :, -1] = motion.torque
    turned = None if motion.base is None else motion.base.rotation
    unknown = None if motion.weights is None else motion.weights == 0.0
    if unknown is not None:
        rows[unknown] = 0.0
    every = row_numbers(whole.robot)
    mixing = ContactMixing(whole.robot, every, motion.q, contacts, turned, unknown)
    return mapped_rows(rows, mixing.row_maps(levels), unknown)


def mapped_rows(
    rows: Array, maps: Iterable[RowMap], unknown: BoolArray | None
) -> MappedRows:
    """Compress samples' rows, mapped to those that no contact force enters.

    Parameters
    ----------
    rows : ndarray, shape (samples, rows, columns)
        Zero where they are unknown; the last column is the torque.
    maps : iterable of RowMap
    unknown : ndarray of bool, shape (samples, rows), optional
    """
    mapped, count = [np.zeros((0, rows.shape[2]))], 0
    for found in maps:
        mapped.append((found.maps @ rows[found.samples]).reshape(-1, rows.shape[2]))
        lost = 0 if unknown is None else int(unknown[found.samples].sum())
        count += len(mapped[-1]) - lost
    stacked = np.vstack(mapped)
    peak = float(abs(stacked[:, -1]).max(initial=0.0))
    return MappedRows(triangle(np.asfortranarray(stacked)), count, peak)


@lru_cache(maxsize=16)
def every_row(model: TorqueModel) -> TorqueModel:
    """Return the model with all rows, before they are mixed.

    It is the same model every time: what its structure is, is kept for each model.
    """
    if model.torque_joints != (CONTACT_FREE,):
        raise ProblemError(
            f"the model has rows of {', '.join(model.torque_joints)}; expected those "
            "free of contact forces: contact_free_model(model)"
        )
    return replace(model, torque_joints=())


def _levels(sigma: ArrayLike | None, rows: int) -> Vector:
    levels = np.ones(rows) if sigma is None else checked(sigma, (rows,), "sigma")
    if not (levels > 0.0).all():
        raise ProblemError(f"sigma is {levels}, expected positive values")
    return levels


def base_of_recordings(
    model: TorqueModel, recordings: Recording | Sequence[Recording]
) -> BaseParameters:
    """Return the base parameters that recordings like these show in any motion.

    `base_parameters`, or `contact_free_base` if forces of contacts are not measured.
    """
    logs = several(recordings)
    unknown = [unmeasured_contacts(log) for log in logs] if model.robot.floating else []
    if not any(unknown):
        return base_parameters(model)
    every = [
        replace(first, closed=np.concatenate([f.closed for f in rest]), certain=_EVERY)
        for first, *rest in ((flags[0], *flags) for flags in zip(*unknown, strict=True))
    ]
    return contact_free_base(model, every)


@single_threaded
def contact_free_base(
    model: TorqueModel, contacts: Sequence[ContactFlags], *, seed: int = 0
) -> BaseParameters:
    """Find the base parameters of rows without contact forces, for given contacts.

    They are those of random motions, each with one of the combinations of contacts.

    Parameters
    ----------
    model : TorqueModel
    contacts : sequence of ContactFlags
        Those of the recordings, see `contact_free_regression`.
    """
    whole = model if CONTACT_FREE not in model.torque_joints else every_row(model)
    Y = np.ascontiguousarray(np.moveaxis(random_regressor(whole, seed=seed), 2, 0))
    states = random_states(whole, seed=seed)
    q, turned = states.q, None if states.base is None else states.base.rotation
    patterns = np.unique(np.array([c.closed for c in contacts]).T, axis=0)
    drawn = patterns[np.arange(len(q)) % len(patterns)]
    flags = [
        ContactFlags(c.frame, drawn[:, i], c.point, c.surface, radius=c.radius)
        for i, c in enumerate(contacts)
    ]
    there = np.array(list(map(row_names(whole.robot).index, whole.torque_joints)))
    mixing = ContactMixing(whole.robot, there, q, tuple(flags), turned)
    rows = [
        (found.maps @ Y[found.samples]).reshape(-1, Y.shape[2])
        for found in mixing.row_maps(np.ones(len(there)))
    ]
    split, _ = split_at_gap(np.vstack(rows), model.layout.kinds)
    return BaseParameters(model.layout, *split, fingerprint=model.fingerprint)


def masked_factors(
    model: TorqueModel,
    recordings: Sequence[Recording],
    combinations: Matrix,
    *,
    torques: Sequence[Recording] = (),
) -> list[MappedRows]:
    """Return a triangular factor for each recording, of combinations of parameters.

    From filtered recordings the samples are taken whose rows are worth keeping, see
    `places_of_rows`.

    Parameters
    ----------
    model : TorqueModel
        With the rows `CONTACT_FREE`, see `contact_free_model`.
    recordings : sequence of Recording
        Recordings of the same motion; other torques are known, or contacts are
        elsewhere.
    combinations : ndarray, shape (parameters, k)
    torques : sequence of Recording
        Recordings of the same motion, with the torques of the last columns; by default
        the first recording.

    Returns
    -------
    list of MappedRows
        Rows of the columns ``Y combinations``, and last the torques.
    """
    whole = every_row(model)
    kept = _worth_keeping(recordings[0])
    recordings = [_at_samples(log, kept) for log in recordings]
    motions = [motion_of(whole, replace(log, contacts=()), None) for log in recordings]
    others = [_at_samples(replace(log, contacts=()), kept) for log in torques]
    tau = [motion_of(whole, log, None).torque for log in others] or [motions[0].torque]
    forces = np.stack(tau, axis=2)
    used = np.flatnonzero((abs(combinations) > _NONE).any(axis=1))
    levels = np.ones(len(whole.torque_joints))
    every = row_numbers(whole.robot)

    def compressed(span: slice) -> list[MappedRows]:
        parts = [motion.samples(span.start, span.stop) for motion in motions]
        rows = _combined(whole, parts[0], used, combinations[used], forces[span])
        turned = None if parts[0].base is None else parts[0].base.rotation
        found = []
        for log, part in zip(recordings, parts, strict=True):
            flags = tuple(contact.samples(span) for contact in log.contacts)
            unknown = None if part.weights is None else part.weights == 0.0
            known = rows if unknown is None else _without(rows, unknown)
            mixing = ContactMixing(whole.robot, every, part.q, flags, turned, unknown)
            found.append(mapped_rows(known, mixing.row_maps(levels), unknown))
        return found

    with worker_threads(WORKERS) as pool:
        spans = chunks(len(recordings[0]), CHUNK)
        found = list(pool.map(compressed, spans))
    return [_joined(parts) for parts in zip(*found, strict=True)]


def _combined(
    whole: TorqueModel,
    motion: Motion,
    used: IntArray,
    combinations: Matrix,
    forces: Array,
) -> Array:
    """Return rows of combinations of the columns in use, and the torques."""
    n = len(motion.q)
    state = motion.q, motion.dq, motion.ddq
    ((_, Y),) = whole.chunks(*state, size=n, base=motion.base)
    count = combinations.shape[1]
    rows = np.empty((n, Y.shape[0], count + forces.shape[2]))
    np.matmul(np.moveaxis(Y[:, used], 2, 0), combinations, out=rows[:, :, :count])
    rows[:, :, count:] = forces
    return rows


def _without(rows: Array, unknown: BoolArray) -> Array:
    left = rows.copy()
    left[unknown] = 0.0
    return left


def _joined(parts: Sequence[MappedRows]) -> MappedRows:
    factor = triangle(np.asfortranarray(np.vstack([part.factor for part in parts])))
    peak = max(part.peak for part in parts)
    return MappedRows(factor, sum(part.rows for part in parts), peak)

"""A recording's motion as a torque model wants it: its order of joints, its filter.

See `motion_arrays` for the rows along it.
"""

from dataclasses import replace

import numpy as np

from consistent_id._support.arrays import Array, IntArray
from consistent_id._support.caches import kept_with
from consistent_id.errors import RecordingError
from consistent_id.recordings.recording import Recording, TorqueFilter
from consistent_id.recordings.signals.filtered_rows import (
    around,
    places_of_rows,
    require_filter,
    require_unchanged,
    row_filter,
)
from consistent_id.regression.motion_arrays import FilteredRows, Motion
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.rows.contact_maps import mixing_of, unknown_rows
from consistent_id.regression.rows.generalised_forces import (
    measured_forces,
    shifted_forces,
    state_of,
)


def motion_of(
    model: TorqueModel, recording: Recording, weights: Array | None
) -> Motion:
    """Return a recording's rows as a model wants them.

    Where its torque is filtered, the rows are filtered alike, and `RowFilter.step`
    says how many of them are kept.

    Parameters
    ----------
    weights : ndarray, shape (samples, torque joints), optional
        Factors of rows; what has the weight 0 is set to zero before the filter.

    Raises
    ------
    RecordingError
        If a channel or a joint is missing, or the motion of a base that floats; or if
        the recording was changed after its torque had been filtered.
    """
    if recording.torque_filter is None:
        return every_sample(model, recording, weights)
    if weights is None:
        return _filtered_motion(model, recording)
    return _with_filter(model, recording, weights)


@kept_with(1, most=8)
def _filtered_motion(model: TorqueModel, recording: Recording) -> Motion:
    """Return the same rows each time: a study takes many passes over few recordings."""
    return _with_filter(model, recording, None)


def _with_filter(
    model: TorqueModel, recording: Recording, weights: Array | None
) -> Motion:
    require_unchanged(recording)
    behind, by = require_filter(recording), row_filter(recording)
    places = places_of_rows(behind, by.step)
    if not len(places):
        places = np.array([len(behind.kept) // 2])
    kept = behind.kept[places]
    along = every_sample(model, behind.source, _marks(behind, weights, model))
    rows = FilteredRows(along, by, kept)
    marks = along.weights
    return Motion(
        along.q[kept],
        along.dq[kept],
        along.ddq[kept],
        torque=rows.through(along.torque),
        weights=_of_rows(weights, places),
        base=None if along.base is None else along.base.samples(kept),
        peaks=along.peaks,
        shares=None if along.shares is None else by.shares(along.shares, kept),
        known=None if marks is None else by.shares(marks, kept),
        places=places,
        filtered=rows,
        shift=None if along.shift is None else rows.through(along.shift),
    )


def _of_rows(weights: Array | None, places: IntArray) -> Array | None:
    """Return weights after the filter: what had none is in rows of zero already."""
    if weights is None or np.isin(weights, (0.0, 1.0)).all():
        return None
    rows: Array = weights[places]
    return np.where(rows == 0.0, 1.0, rows)


def _marks(
    behind: TorqueFilter, weights: Array | None, model: TorqueModel
) -> Array | None:
    """Return 0 where samples before the filter do not count, 1 elsewhere."""
    if behind.left_out is None and (weights is None or weights.all()):
        return None
    marks = np.ones((len(behind.source), len(model.torque_joints)))
    if behind.left_out is not None:
        marks[behind.left_out] = 0.0
    if weights is not None:
        for column, own in zip(marks.T, weights.T, strict=True):
            column[around(behind, own == 0.0)] = 0.0
    return marks


def every_sample(
    model: TorqueModel, recording: Recording, weights: Array | None
) -> Motion:
    """Return the rows of a recording whose torque is as it was recorded."""
    base = recording.base if model.robot.floating else None
    if model.robot.floating:
        tau = measured_forces(model, recording)
        shift = shifted_forces(model, recording)
    else:
        own = recording.of(model.torque_joints)
        tau, shift = own.torque, own.torque_shift
    q, dq, ddq = state_of(model, recording)
    if dq is None or ddq is None or tau is None:
        given = {"velocity": dq, "acceleration": ddq, "torque": tau}
        missing = [name for name, values in given.items() if values is None]
        advice = "velocity and acceleration come from signals.differentiated(recording)"
        if missing == ["torque"]:
            advice = "identification needs measured torque, or currents and gains"
        raise RecordingError(
            f"{recording.name} has no {' and no '.join(missing)}; {advice}"
        )
    unknown = unknown_rows(model, recording)
    if unknown is not None:
        weights = np.where(unknown, 0.0, 1.0 if weights is None else weights)
    motion = Motion(q, dq, ddq, tau, weights, base, shift=shift)
    mixing = mixing_of(model, recording)
    if mixing is None:
        return motion
    if weights is not None and not weights.all():
        left_out = weights == 0.0
        if unknown is None or not np.array_equal(left_out, unknown):
            mixing = replace(mixing, unknown=left_out, held=None).holding()
    return motion._replace(
        torque=mixing.mixed(tau),
        shift=None if shift is None else mixing.mixed(shift),
        mixing=mixing,
        peaks=abs(tau).max(axis=0),
        shares=mixing.shares,
    )

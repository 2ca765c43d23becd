"""Torque along recordings: predicted, measured, simulated.

Predicted and measured torque pass the filter that the recording's torque has passed.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from consistent_id._support.arrays import Array, Vector, frozen
from consistent_id._support.given_values import require_type
from consistent_id.errors import ProblemError
from consistent_id.recordings.recording import Recording, states
from consistent_id.recordings.signals.filtered_rows import (
    require_unchanged,
    row_filter,
)
from consistent_id.regression.recorded_motion import every_sample
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.rows.contact_maps import mixing_of
from consistent_id.regression.rows.generalised_forces import state_of


def predicted_torque(model: TorqueModel, x: Vector, recording: Recording) -> Array:
    """Return the torque of parameters along a recording, whether it has torque or not.

    Without forces of unmeasured contacts, as in `Motion`, and filtered as the
    recording's torque is.

    Raises
    ------
    ProblemError
        If the recording has no velocity or acceleration.
    """
    require_type(recording, Recording, "recording")
    behind = recording.torque_filter
    if behind is not None:
        require_unchanged(recording)
        source = behind.source
        return row_filter(recording).of_spans(
            lambda span: predicted_torque(model, x, source.samples(span)),
            behind.kept,
            len(source),
        )
    q, dq, ddq = state_of(model, recording)
    if dq is None or ddq is None:
        raise without_motion(recording)
    whole = model.predict(x, q, dq, ddq, base=recording.base)
    mixing = mixing_of(model, recording)
    return whole if mixing is None else mixing.mixed(whole)


def without_motion(recording: Recording) -> ProblemError:
    """Return the error of a recording that lacks velocity or acceleration."""
    return ProblemError(
        f"{recording.name}: torques need velocity and acceleration; call "
        "signals.differentiated(recording) first"
    )


def measured_torque(model: TorqueModel, recording: Recording) -> Array:
    """Return the torque of a recording that `predicted_torque` predicts.

    In the model's order of rows, shape (samples, torque joints), [N m or N], at every
    sample, whether it counts or not.

    Raises
    ------
    RecordingError
        If a channel or a joint is missing.
    """
    behind = recording.torque_filter
    if behind is None:
        return every_sample(model, recording, None).torque
    torque = every_sample(model, behind.source, None).torque
    return row_filter(recording)(torque, behind.kept)


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

    Examples
    --------
    >>> import consistent_id as ci
    >>> arm = ci.from_modified_dh("arm", [ci.DHRow(-np.pi / 2, 0.0)])
    >>> model = ci.TorqueModel(arm, ci.DriveTerms(viscous=True))
    >>> q, dq, ddq = np.random.default_rng(0).normal(size=(3, 200, 1))
    >>> motion = ci.Recording(("joint1",), np.arange(200) / 100, q, dq, ddq)
    >>> body = [2.0, 0.6, 0, 0, 0.05, 0, 0.3, 0, 0, 0.3]  # kg, kg m, kg m^2
    >>> log = ci.simulate_torque(model, [*body, 0.4], motion)
    >>> log.torque.shape, log.name
    ((200, 1), 'recording (simulated)')
    """
    require_type(model, TorqueModel, "model")
    require_type(motion, Recording, "motion")
    motion = motion.of(model.robot.joint_names)
    torque = replace(model, torque_joints=()).predict(parameters, *states(motion))
    shape = torque.shape[1:] if np.ndim(noise) else ()
    sigma = frozen(noise, shape, "noise")
    if sigma.any():
        if rng is None:
            raise ProblemError("noise needs a random generator; pass rng=")
        torque = torque + rng.normal(size=torque.shape) * sigma
    name = f"{motion.name} (simulated)"
    return replace(
        motion, torque=torque, torque_filter=None, torque_shift=None, name=name
    )

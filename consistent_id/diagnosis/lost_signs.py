"""Torque whose sign was not logged: a magnitude, as some drives report of currents."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from consistent_id._support.arrays import Matrix
from consistent_id.diagnosis.channel_factors import channel_factors
from consistent_id.diagnosis.corrections import Cause
from consistent_id.diagnosis.explain import Candidate, FittedLog
from consistent_id.diagnosis.missing_parts import residuals
from consistent_id.diagnosis.torque_parts import nominal_parts
from consistent_id.recordings.recording import Recording

_THRESHOLD = 2.0  # ratio of misfits, as of a torque that is reversed
_EXPLAINED = 0.03  # of the torque: misfit below which no sign is missing
_BELOW = 0.05  # of the largest torque, that filters leave below zero
_TURNS = 0.02  # share of samples in which a sign is missing, at the least
_PASSES = 5  # signs follow from the fit, and the fit from signs


def lost_signs(as_is: FittedLog) -> Iterator[Candidate]:
    """Yield the log with the signs that the robot's own torque has.

    Of torques that are never negative.  First signs are those of the nominal bodies.
    """
    if as_is.misfit < _EXPLAINED:
        return
    model, log = as_is.factors.model, as_is.recording
    logged = np.asarray(log.of(model.torque_joints).torque)
    size = abs(logged)
    bare = logged.min(axis=0) >= -_BELOW * size.max(axis=0)
    if not bare.any():
        return
    expected = sum(nominal_parts(model, log))
    for _ in range(_PASSES):
        torque = np.where(bare, np.copysign(size, expected), logged)
        signed = _with_torque(log, model.torque_joints, torque)
        left = residuals(replace(as_is, recording=signed))
        expected = torque - np.column_stack([r.rest for r in left])
    share = np.mean(torque * logged < 0.0, axis=0)
    turned = share > _TURNS
    if not turned.any():
        return
    names = ", ".join(n for n, t in zip(model.torque_joints, turned, strict=True) if t)
    advice = f"log the torque of {names} with its sign: it is a magnitude"
    if share[turned].min() > 1.0 - _TURNS:  # then it may as well be reversed
        advice = (
            f"reverse the torque of {names} by a negative gain (--torque-gain, one "
            "number for each joint); if it is a magnitude, log it with its sign"
        )
    cause = Cause(
        "torque sign",
        names,
        f"with the sign that the torque of {names} has lost",
        advice,
        _THRESHOLD,
    )
    (factors,) = channel_factors(model, as_is.factors.base, [signed])
    yield Candidate(cause, factors, as_is.constraints)


def _with_torque(log: Recording, joints: Sequence[str], torque: Matrix) -> Recording:
    """Return a log with other torque of some joints."""
    every = np.array(log.torque)
    every[:, [log.joints.index(name) for name in joints]] = torque
    return replace(log, torque=every)

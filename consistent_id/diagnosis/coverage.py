"""Logs that rest, saturate, carry no signal, or do not excite all parameters."""

from dataclasses import replace

import numpy as np

from consistent_id._support.arrays import Array, BoolArray
from consistent_id.diagnosis.findings import Finding
from consistent_id.recordings.recording import Recording
from consistent_id.regression.base import BaseParameters
from consistent_id.regression.data_rank import excitation_of
from consistent_id.regression.regression import build_regression
from consistent_id.regression.regressor import TorqueModel

_STILL = 0.02  # of a joint's largest velocity, below which it stands
_IDLE = 0.2  # share of samples with all joints at rest that is worth a warning
_PINNED = 5  # samples in a row at the largest torque that are a saturation
_MOVES = 2e-3  # rad or m of travel, below which a joint's readings only flicker


def standstill_findings(recording: Recording) -> list[Finding]:
    """Warn of long rests of all joints together."""
    velocity = recording.velocity
    if velocity is None:
        velocity = np.gradient(recording.position, recording.time, axis=0)
    largest = abs(velocity).max(axis=0)
    still = (abs(velocity) <= _STILL * np.where(largest > 0.0, largest, 1.0)).all(
        axis=1
    )
    share = float(still.mean())
    if share < _IDLE:
        return []
    return [
        Finding(
            "standstill",
            "warning",
            recording.name,
            f"all joints stand still in {share:.0%} of {len(recording)} samples",
            "trim the rests; Coulomb friction at rest is anything between its bounds",
            share / _IDLE,
        )
    ]


def dead_findings(recording: Recording) -> list[Finding]:
    """Find torque channels without a signal: one value throughout."""
    if recording.torque is None:
        return []
    return [
        Finding(
            "dead channel",
            "fault",
            joint,
            f"{joint}: torque is {tau[0]:.4g} throughout",
            "check column, unit and gain, or leave the joint out of torque_joints",
            10.0,
        )
        for joint, tau in zip(recording.joints, recording.torque.T, strict=True)
        if np.ptp(tau) == 0.0
    ]


def saturation_findings(recording: Recording) -> list[Finding]:
    """Find torques that stay at their largest value."""
    if recording.torque is None:
        return []
    found = []
    for joint, tau in zip(recording.joints, recording.torque.T, strict=True):
        for limit in (tau.max(), tau.min()):
            if limit == 0.0:
                continue
            run = _longest_run(tau == limit)
            if run >= _PINNED:
                found.append(
                    Finding(
                        "saturation",
                        "fault",
                        joint,
                        f"{joint}: torque stays at {limit:.4g} for {run} samples",
                        "leave these samples out, or move more gently: what the drive "
                        "could not give is missing from the torque",
                        run / _PINNED,
                    )
                )
                break
    return found


def rank_findings(
    model: TorqueModel, recording: Recording, base: BaseParameters
) -> list[Finding]:
    """Name the combinations of base parameters that are not identifiable.

    What an encoder reads of a joint at rest flickers; it is taken for the rest it is.

    Parameters
    ----------
    model : TorqueModel
    recording : Recording
        With velocity, acceleration and torque.
    base : BaseParameters
    """
    recording = recording.of(model.robot.joint_names)
    travel = np.ptp(recording.position, axis=0)
    at_rest = travel < _MOVES
    steady = _without_motion(recording, at_rest)
    excitation = excitation_of(build_regression(model, steady), base)
    missing = excitation.structural_rank - excitation.data_rank
    if missing == 0:
        return []
    still = [j for j, rests in zip(recording.joints, at_rest, strict=True) if rests]
    cause = f"{', '.join(still)} did not move; " if still else ""
    return [
        Finding(
            "rank",
            "warning",
            ", ".join(still) or "all joints",
            f"{cause}the data determine {excitation.data_rank} of "
            f"{excitation.structural_rank} base parameters (structural rank); not "
            "identifiable: " + "; ".join(excitation.undetermined),
            "move the joints that these combinations name, and not all alike; what is "
            "not identifiable is taken from the prior",
            1.0 + missing,
        )
    ]


def _without_motion(recording: Recording, at_rest: BoolArray) -> Recording:
    """Return a recording in which some joints do not move at all."""
    q = np.where(at_rest, recording.position.mean(axis=0), recording.position)
    dq, ddq = (
        np.where(at_rest, 0.0, np.asarray(rate))
        for rate in (recording.velocity, recording.acceleration)
    )
    return replace(recording, position=q, velocity=dq, acceleration=ddq)


def _longest_run(flags: Array) -> int:
    edges = np.flatnonzero(np.diff(np.concatenate([[0], flags.astype(int), [0]])))
    return int(max(edges[1::2] - edges[::2], default=0))

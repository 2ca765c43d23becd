"""Logs that rest, saturate, carry no signal, or do not excite all parameters."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from consistent_id._support.arrays import BoolArray, Vector
from consistent_id.diagnosis.findings import LogFinding
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals.masks import saturated, standstill
from consistent_id.regression.base import BaseParameters, excitation_of
from consistent_id.regression.regression import build_regression
from consistent_id.regression.regressor import TorqueModel

_STILL = 0.02  # of a joint's largest velocity, below which it stands
_IDLE = 0.2  # share of samples with all joints at rest that is worth a warning
_RESTS = 0.9  # share of samples at rest of a joint that only goes to where it stays
_PINNED = 5  # samples at a limit that are worth a word
_SMALL, _SLOW = 0.05, 0.1  # rad or m; rad/s or m/s, of the joint that moves most
_BRIEF = 3.0  # s, below which a log may be too short for its motion to turn back
_TURNS, _TURNING = 2.5, 0.05  # of the median joint; share of its top speed
_MOVES = 2e-3  # rad or m of travel, below which a joint's readings only flicker,
_STEPS = 2.0  # as they do within so many steps of its encoder


def standstill_findings(recording: Recording) -> list[LogFinding]:
    """Warn of long rests of all joints together."""
    velocity = recording.velocity
    if velocity is None or not velocity.any():
        velocity = np.gradient(recording.position, recording.time, axis=0)
    largest = abs(velocity).max(axis=0)
    still = (abs(velocity) <= _STILL * np.where(largest > 0.0, largest, 1.0)).all(
        axis=1
    )
    share = float(still.mean())
    if share < _IDLE:
        return []
    return [
        LogFinding(
            "standstill",
            "warning",
            recording.name,
            f"all joints stand still in {share:.0%} of {len(recording)} samples",
            "trim the rests; Coulomb friction at rest may be any value in its bounds",
            share / _IDLE,
        )
    ]


def in_motion(model: TorqueModel, prepared: Recording) -> TorqueModel:
    """Return a model with the torque of those joints alone that move in a log.

    Friction holds a joint at rest with whatever is needed, up to its breakaway torque.
    No law of velocity gives that torque, and so it contradicts no model.

    Parameters
    ----------
    prepared : Recording
        With velocity, filtered.
    """
    rests = standstill(prepared.of(model.robot.joint_names)).mean(axis=0) > _RESTS
    resting = np.array(model.robot.joint_names)[rests]
    moving = tuple(name for name in model.torque_joints if name not in resting)
    return replace(model, torque_joints=moving or model.torque_joints)


def saturation_findings(
    recording: Recording, limits: Mapping[str, float] | None = None
) -> list[LogFinding]:
    """Find torques that stay at their largest value (`saturated`).

    Parameters
    ----------
    limits : mapping of str to float, optional, [N m or N]
        Of joints whose torque was made of commands and clipped where the drive clips
        it: staying there, it is the drive's.
    """
    if recording.torque is None:
        return []
    at_limit, limits = saturated(recording), limits or {}
    return [
        LogFinding(
            "saturation",
            "fault",
            joint,
            f"{joint}: torque stays at {abs(tau[at]).max():.4g} in {int(at.sum())} of "
            f"{len(tau)} samples",
            "leave these samples out, or move more gently: torque that the drive could "
            "not give is missing from the channel",
            float(at.sum()) / _PINNED,
        )
        for joint, tau, at in zip(
            recording.joints, recording.torque.T, at_limit.T, strict=True
        )
        if at.sum() >= _PINNED
        and abs(tau[at]).max() > 0.0
        and not np.isclose(abs(tau[at]).max(), limits.get(joint, np.inf))
    ]


def extent_findings(prepared: Recording) -> list[LogFinding]:
    """Warn of motion that is small, slow, or over before it has turned back twice.

    Parameters
    ----------
    prepared : Recording
        With velocity, filtered.
    """
    velocity = np.asarray(prepared.velocity)
    travel = float(np.ptp(prepared.position, axis=0).max())
    fastest = float(abs(velocity).max())
    turns = float(np.median([_turns(v) for v in velocity.T if v.any()] or [0]))
    brief = prepared.duration < _BRIEF
    for kind, seen, least, unit, advice in (
        (
            "small motion",
            travel,
            _SMALL,
            "rad or m is the widest travel",
            "more widely",
        ),
        ("slow motion", fastest, _SLOW, "rad/s or m/s is the top speed", "faster"),
        ("short", turns if brief else _TURNS, _TURNS, "turns of a joint", "for longer"),
    ):
        if seen < least:
            return [
                LogFinding(
                    kind,
                    "warning",
                    prepared.name,
                    f"{seen:.3g} {unit} in {prepared.duration:.3g} s; less than "
                    f"{least:g} shows little of the bodies",
                    f"move {advice}",
                    least / max(seen, 0.1 * least),
                )
            ]
    return []


def _turns(velocity: Vector) -> int:
    """Return how often a joint turns back, flickering at rest left out."""
    moving = velocity[abs(velocity) > _TURNING * abs(velocity).max()]
    return int((np.diff(np.sign(moving)) != 0.0).sum())


def rank_findings(
    model: TorqueModel,
    recording: Recording,
    base: BaseParameters,
    steps: Vector | float = 0.0,
) -> list[LogFinding]:
    """Name the combinations of base parameters that are not identifiable.

    What an encoder reads of a joint at rest flickers; it is taken for the rest it is.

    Parameters
    ----------
    recording : Recording
        With velocity, acceleration and torque.
    steps : ndarray, shape (joints,), or float, [rad or m]
        In which encoders read, which no longer shows in a filtered position.
    """
    recording = recording.of(model.robot.joint_names)
    travel = np.ptp(recording.position, axis=0)
    at_rest = travel < np.maximum(_MOVES, _STEPS * np.asarray(steps))
    steady = _without_motion(recording, at_rest)
    excitation = excitation_of(build_regression(model, steady), base)
    missing = excitation.structural_rank - excitation.data_rank
    if missing == 0:
        return []
    still = [j for j, rests in zip(recording.joints, at_rest, strict=True) if rests]
    cause = f"{', '.join(still)} did not move; " if still else ""
    return [
        LogFinding(
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

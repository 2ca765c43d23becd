"""Gravity in another direction than the model's: a base that leans."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from consistent_id._support.arrays import Vector
from consistent_id.diagnosis.channel_factors import channel_factors
from consistent_id.diagnosis.corrections import Cause
from consistent_id.diagnosis.explain import Candidate, FittedLog
from consistent_id.diagnosis.findings import LogFinding
from consistent_id.diagnosis.jackknife import RANK
from consistent_id.diagnosis.torque_parts import (
    TorqueParts,
    nominal_parts,
    torque_parts,
)
from consistent_id.recordings.recording import Recording
from consistent_id.regression.base import base_parameters
from consistent_id.regression.linear import smallest_solution
from consistent_id.regression.regressor import TorqueModel
from consistent_id.robot.scaling import reference_bodies

_THRESHOLD = 1.3  # ratio of misfits, as in the table of corrections
# Ratio of what the nominal robot leaves, upright and leaning: turning takes up a part
# of a drawing's errors as well.
_CLEARLY = 1.5
_TURNED = np.radians(5.0)  # of gravity: less is a floor that is not level
_G = (0.7, 1.4)  # ratio of its size to the model's within which it is gravity
_CREEP = 0.02  # rad/s or m/s, of the smooth Coulomb term
_ADVICE = (
    "turn the base in the model, or its gravity, as the robot is mounted; or check "
    "the zero of the first joint, if its axis is level"
)


def other_gravity(as_is: FittedLog) -> Iterator[Candidate]:
    """Yield gravity in the direction that the nominal bodies find in the log."""
    model = as_is.factors.model
    turned = turned_gravity(model, as_is.recording)
    if turned is None:
        return
    cause = Cause(
        "gravity", "base", f"with {_words(model, turned)}", _ADVICE, _THRESHOLD
    )
    other = replace(model, robot=replace(model.robot, gravity=turned))
    (factors,) = channel_factors(other, base_parameters(other), [as_is.recording])
    yield Candidate(cause, factors, as_is.constraints)


def leaning_findings(
    model: TorqueModel, prepared: Recording, upright: TorqueParts
) -> list[LogFinding]:
    """Find that the nominal robot explains a log if it leans, and less if it does not.

    A base that leans scales the part of gravity that upright joints show, as a gain
    does.

    Parameters
    ----------
    upright : TorqueParts
        Of the model as it is.
    """
    turned = turned_gravity(model, prepared)
    if turned is None:
        return []
    other = replace(model, robot=replace(model.robot, gravity=turned))
    leaning = torque_parts(other, prepared)
    before, after = float(np.median(upright.rest)), float(np.median(leaning.rest))
    if before < _CLEARLY * after:
        return []
    return [
        LogFinding(
            "gravity",
            "fault",
            "base",
            f"with {_words(model, turned)}, the nominal robot and friction leave "
            f"{after:.1%} of each joint's torque unexplained (median over joints); as "
            f"it is, {before:.1%}",
            _ADVICE,
            before / max(_CLEARLY * after, 1e-12),
        )
    ]


def turned_gravity(model: TorqueModel, recording: Recording) -> Vector | None:
    """Return gravity as the log has it, [m/s^2]; None if it is the model's, or none."""
    robot = model.robot
    size = float(np.linalg.norm(robot.gravity))
    if robot.nominal is None or size == 0.0:
        return None
    gravity = gravity_in(model, recording)
    length = float(np.linalg.norm(gravity))
    if not _G[0] <= length / size <= _G[1]:
        return None
    turned = gravity * size / length
    return None if _angle(model, turned) < _TURNED else turned


def _angle(model: TorqueModel, gravity: Vector) -> float:
    """Return the angle between a gravity and the model's [rad]."""
    own = np.asarray(model.robot.gravity)
    cosine = float(gravity @ own) / float(np.linalg.norm(gravity) * np.linalg.norm(own))
    return float(np.arccos(np.clip(cosine, -1.0, 1.0)))


def _words(model: TorqueModel, turned: Vector) -> str:
    text = ", ".join(f"{g:.2f}" for g in turned)
    degrees = np.degrees(_angle(model, turned))
    return f"gravity along ({text}) m/s^2, {degrees:.0f} degrees from the model's"


def gravity_in(model: TorqueModel, recording: Recording) -> Vector:
    """Return the gravity that explains a log best at the nominal bodies, [m/s^2].

    The torque is linear in it: three unknowns, beside friction and the inertial torque
    of each joint.
    """
    robot, torque = model.robot, np.asarray(recording.of(model.torque_joints).torque)
    bodies, q = (
        reference_bodies(robot).ravel(),
        recording.of(robot.joint_names).position,
    )
    rows = model.torque_joints
    turned = (
        TorqueModel(replace(robot, gravity=axis), torque_joints=rows)
        for axis in np.eye(3)
    )
    unit = [one.rigid_torque(bodies, (q, None, None)) for one in turned]
    _, inertial = nominal_parts(model, recording)
    speed = np.asarray(recording.of(model.torque_joints).velocity)
    left, right = [], []
    for j, tau in enumerate(torque.T):
        own = [inertial[:, j], speed[:, j], np.tanh(speed[:, j] / _CREEP)]
        own.append(np.ones(len(tau)))
        Q, _ = np.linalg.qr(np.column_stack(own))
        seen = np.column_stack([u[:, j] for u in unit])
        scale = float(np.sqrt(np.mean(tau**2))) or 1.0
        left.append((seen - Q @ (Q.T @ seen)) / scale)
        right.append((tau - Q @ (Q.T @ tau)) / scale)
    return smallest_solution(np.vstack(left), np.concatenate(right), RANK)

"""Causes that the log itself suggests: gravity, masses, the order of all channels."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from consistent_id._support.arrays import IntArray, Matrix, Vector
from consistent_id.constraints import FixedMasses
from consistent_id.diagnosis.channel_factors import channel_factors
from consistent_id.diagnosis.corrections import Cause
from consistent_id.diagnosis.explain import Candidate, FittedLog
from consistent_id.diagnosis.jackknife import solution
from consistent_id.diagnosis.missing_parts import missing_parts
from consistent_id.diagnosis.torque_parts import nominal_parts
from consistent_id.recordings.recording import Recording
from consistent_id.regression.base import base_parameters
from consistent_id.regression.regressor import TorqueModel

_THRESHOLD = 1.3  # ratio of misfits, as in the table of corrections
_TURNED = np.radians(5.0)  # of gravity: less is a floor that is not level
_G = (0.7, 1.4)  # ratio of its size to the model's within which it is gravity
_CREEP = 0.02  # rad/s or m/s, of the smooth Coulomb term


def alternatives(as_is: FittedLog) -> list[Candidate]:
    """Return the causes in the model that a log suggests."""
    return [
        *_other_gravity(as_is),
        *_other_masses(as_is),
        *_other_channels(as_is),
        *missing_parts(as_is),
    ]


def _other_gravity(as_is: FittedLog) -> Iterator[Candidate]:
    """Yield gravity in the direction that the nominal bodies find in the log."""
    model = as_is.factors.model
    robot = model.robot
    size = float(np.linalg.norm(robot.gravity))
    if robot.nominal is None or size == 0.0:
        return
    gravity = gravity_in(model, as_is.recording)
    length = float(np.linalg.norm(gravity))
    if not _G[0] <= length / size <= _G[1]:
        return
    cosine = float(gravity @ robot.gravity) / (length * size)
    angle = float(np.arccos(np.clip(cosine, -1.0, 1.0)))
    if angle < _TURNED:
        return
    turned = gravity * size / length
    text = ", ".join(f"{g:.2f}" for g in turned)
    cause = Cause(
        "gravity",
        "base",
        f"with gravity along ({text}) m/s^2, {np.degrees(angle):.0f} degrees from the "
        "model's,",
        "turn the base in the model, or its gravity, as the robot is mounted",
        _THRESHOLD,
    )
    other = replace(model, robot=replace(robot, gravity=turned))
    (factors,) = channel_factors(other, base_parameters(other), [as_is.recording])
    yield Candidate(cause, factors, as_is.constraints)


def gravity_in(model: TorqueModel, recording: Recording) -> Vector:
    """Return the gravity that explains a log best at the nominal bodies, [m/s^2].

    The torque is linear in it: three unknowns, beside friction and the inertial torque
    of each joint.
    """
    robot, torque = model.robot, np.asarray(recording.of(model.torque_joints).torque)
    unit = [
        nominal_parts(replace(model, robot=replace(robot, gravity=axis)), recording)[0]
        for axis in np.eye(3)
    ]
    _, inertial = nominal_parts(model, recording)
    speed = np.asarray(recording.of(model.torque_joints).velocity)
    rows, right = [], []
    for j, tau in enumerate(torque.T):
        own = [inertial[:, j], speed[:, j], np.tanh(speed[:, j] / _CREEP)]
        own.append(np.ones(len(tau)))
        Q, _ = np.linalg.qr(np.column_stack(own))
        seen = np.column_stack([u[:, j] for u in unit])
        scale = float(np.sqrt(np.mean(tau**2))) or 1.0
        rows.append((seen - Q @ (Q.T @ seen)) / scale)
        right.append((tau - Q @ (Q.T @ tau)) / scale)
    return solution(np.vstack(rows), np.concatenate(right))


def _other_masses(as_is: FittedLog) -> Iterator[Candidate]:
    """Yield the log with masses that are not known."""
    free = [c for c in as_is.constraints if not isinstance(c, FixedMasses)]
    if len(free) == len(as_is.constraints):
        return
    cause = Cause(
        "datasheet",
        "masses",
        "with masses that are not the model's",
        'masses = "free" (--masses free); check load, tool, model and gains',
        _THRESHOLD,
        excuse=1,
    )
    yield Candidate(cause, as_is.factors, free)


def _other_channels(as_is: FittedLog) -> Iterator[Candidate]:
    """Yield the order of all torque channels in which rows fit best, one by one."""
    factors = as_is.factors
    names = factors.model.torque_joints
    if len(names) < 3:
        return
    costs = np.array([_row_misfits(F, len(factors.base)) for F in factors.factors])
    if (costs.argmin(axis=1) == np.arange(len(names))).all():
        return  # each row fits its own channel best
    order = _cheapest_order(np.log(np.maximum(costs, 1e-9)))
    if (order == np.arange(len(order))).sum() >= len(order) - 2:
        return  # at most two exchanged, which the table has
    everyone = factors.model.robot.joint_names
    matrix = np.eye(len(everyone))
    places = [everyone.index(name) for name in names]
    matrix[np.ix_(places, places)] = np.eye(len(names))[:, order]
    meant = ", ".join(names[k] for k in order)
    cause = Cause(
        "channel order",
        "all joints",
        f"with the torques of {', '.join(names)} taken from the columns of {meant}",
        "name the torque columns in the order of the joints they belong to",
        _THRESHOLD,
    )
    yield Candidate(cause, factors.changed(matrix), as_is.constraints)


def _cheapest_order(costs: Matrix) -> IntArray:
    """Return the column of each row, all different, with the least sum of costs."""
    # scipy.optimize has this too, but takes 0.3 s to be imported.
    from scipy.sparse import csr_matrix
    from scipy.sparse.csgraph import min_weight_full_bipartite_matching

    below_zero = costs - costs.max() - 1.0  # an entry of zero would be no edge
    _, order = min_weight_full_bipartite_matching(csr_matrix(below_zero))
    return np.asarray(order)


def _row_misfits(factor: Matrix, base: int) -> Vector:
    """Return what a joint's row leaves of each torque channel, relative to it."""
    columns, channels = factor[:, :base], factor[:, base:]
    kept = columns[:, columns.any(axis=0)]
    Q, _ = np.linalg.qr(kept / np.linalg.norm(kept, axis=0))
    left = channels - Q @ (Q.T @ channels)
    size = np.maximum(np.linalg.norm(channels, axis=0), 1e-300)
    return np.asarray(np.linalg.norm(left, axis=0) / size)

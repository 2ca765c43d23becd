"""What dry friction can hold: the torque of a joint at rest says little of the robot.

Friction of a joint at rest is whatever balances it, up to its breakaway torque.  A
model with Coulomb friction predicts none there, so that what it leaves of the torque
contradicts it only beyond that.
"""

import numpy as np

from consistent_id._support.arrays import Array, Vector
from consistent_id.recordings.recording import Recording
from consistent_id.regression.drive.coulomb import AsymmetricCoulomb, Coulomb
from consistent_id.regression.drive.term import DriveTerm, JointSamples
from consistent_id.regression.regression import Regression
from consistent_id.regression.regressor import TorqueModel

AT_REST = 0.05
"""Share of samples in motion below which data hardly show what a joint's friction is:
three seconds of a minute."""

IN_MOTION = 0.5
"""Share of samples in motion from which on rests are few, and change little."""

BREAKAWAY = 0.25
"""Friction over a drive's effort limit, at the most: a drive that spends more on itself
is a poor one.  It is asked for where the data do not tell the friction."""

_DRY = (Coulomb, AsymmetricCoulomb)
_AT_EASE = float(np.tanh(1.0))  # of the direction, below which a joint may be at rest


def moving_shares(model: TorqueModel, regression: Regression) -> Vector:
    """Return the share of samples in which each joint moves, shape (torque joints,).

    The mean square of the direction of motion, as Coulomb friction sees it; NaN without
    Coulomb friction.
    """
    shares = np.full(len(regression.joints), np.nan)
    for row, columns in _coulomb_columns(model).items():
        seen = float(np.sum(regression.factors[row][:, columns] ** 2))
        shares[row] = seen / regression.counts[row]
    return shares


def holding(model: TorqueModel, x: Vector, moving: Vector) -> Vector:
    """Return the torque that friction can hold of each joint, shape (torque joints,).

    The estimated Coulomb friction; of a joint that hardly moved, `BREAKAWAY` of its
    effort limit, and NaN without one: it is not known.  Zero without Coulomb friction.

    Parameters
    ----------
    x : ndarray, shape (parameters,)
    moving : ndarray, shape (torque joints,)
        From `moving_shares`.
    """
    limits = {joint.name: joint.limits.effort for joint in model.robot.joints}
    held = np.zeros(len(model.torque_joints))
    for row, columns in _coulomb_columns(model).items():
        held[row] = abs(x[columns]).max()
        if moving[row] < AT_REST:
            limit = limits.get(model.torque_joints[row], np.inf)
            known = 0.0 < limit < np.inf
            held[row] = BREAKAWAY * limit if known else np.nan
    return held


def beyond_friction(
    model: TorqueModel, recording: Recording, error: Array, held: Vector
) -> Array:
    """Return what is left of torque errors beyond what friction at rest can hold.

    In motion nothing is taken off; see `Coulomb` for how much a joint moves.

    Parameters
    ----------
    recording : Recording
        Of the robot's joints, with velocity.
    error : ndarray, shape (samples, torque joints), [N m or N]
    held : ndarray, shape (torque joints,), [N m or N]
        From `holding`; where it is NaN, any torque may be held.
    """
    left = error.copy()
    names = model.robot.joint_names
    for row, terms in _coulomb_terms(model).items():
        j = names.index(model.torque_joints[row])
        q, dq = recording.position[:, j], np.asarray(recording.velocity)[:, j]
        samples = JointSamples(q, dq, np.zeros_like(dq), None)
        speed = np.sum([abs(c) for t in terms for c in t.columns(samples)], axis=0)
        known = np.isfinite(held[row])
        slack = (
            held[row] * (1.0 - speed)
            if known
            else np.where(speed < _AT_EASE, np.inf, 0.0)
        )
        left[:, row] = np.maximum(abs(error[:, row]) - slack, 0.0)
    return left


def _coulomb_terms(model: TorqueModel) -> dict[int, list[DriveTerm]]:
    """Return the Coulomb terms of each row that has any."""
    names = model.robot.joint_names
    found: dict[int, list[DriveTerm]] = {}
    for row, name in enumerate(model.torque_joints):
        if name not in names:
            continue
        terms = model.terms[names.index(name)].terms
        dry: list[DriveTerm] = [t for t in terms if isinstance(t, _DRY)]
        if dry:
            found[row] = dry
    return found


def _coulomb_columns(model: TorqueModel) -> dict[int, list[int]]:
    """Return the columns of each row's Coulomb friction."""
    index = model.layout.index
    return {
        row: [index(f"{model.torque_joints[row]}.{n}") for t in terms for n in t.names]
        for row, terms in _coulomb_terms(model).items()
    }

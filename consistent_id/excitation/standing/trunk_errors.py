"""What a motion on feet tells of the trunk, whatever joints and ground do."""

import numpy as np

from consistent_id._support.arrays import Array, Vector
from consistent_id.errors import NotExcitedError, ProblemError
from consistent_id.excitation.standing.stance import Stance
from consistent_id.excitation.standing.standing_motion import StandingMotion
from consistent_id.recordings.recording import Recording
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.rows.contact_free import (
    contact_free_model,
    contact_free_regression,
)
from consistent_id.robot.inertia import InertialParameters
from consistent_id.robot.parameters import did_you_mean

REST = 0.03
"""rad/s or m/s, below which a joint's torque tells nothing: at rest, dry friction is
whatever balances it (`without_rests`; benchmarks/quadruped.py: with such joints the
moments of G1's torso are 6 % off, without them 1 %)."""

_THIN = 0.01  # m; no trunk is thinner, whatever a file says


def trunk_errors(
    stance: Stance,
    model: TorqueModel,
    motion: StandingMotion,
    rate: float,
    link: str | None = None,
) -> Vector:
    """Return standard errors of the trunk's ten parameters, shape (10,).

    Of `INERTIAL_NAMES`, for torque noise of 1 N m that is white at a rate [Hz]; drive
    terms are unknown, bodies of the other links known.  Rows are those that no force of
    the ground enters, without joints slower than `REST`.  The trunk is a link of the
    robot, by default the base.

    Raises
    ------
    NotExcitedError
        If the motion does not tell all ten.
    """
    factor = trunk_factor(stance, model, motion, link_number(stance, link))
    share = len(motion.time) / (rate * (motion.time[-1] - motion.time[0]))
    inverse = np.linalg.inv(factor)
    return np.asarray(np.sqrt(share) * np.linalg.norm(inverse, axis=1))


def link_number(stance: Stance, link: str | None) -> int:
    """Return which link is to be identified, by default the base."""
    names = stance.robot.link_names
    if link is not None and link not in names:
        near = did_you_mean(link, names)
        raise ProblemError(f"no link {link!r} to identify; {near}")
    return 0 if link is None else names.index(link)


def relative_size(errors: Vector, trunk: InertialParameters) -> float:
    """Return the root mean square of a body's ten errors, relative to its own size.

    With ``m s_i^2 = J_ii``, of its mass and pseudo-inertia, units are ``m``, ``m s_i``
    of first moments, and ``sqrt(I_ii I_jj)`` of moments, ``I_ii = m (s_j^2 + s_k^2)``.
    """
    m = trunk.mass
    squares = np.diagonal(trunk.pseudo_inertia)[:3] / m
    squares = np.maximum(squares, _THIN**2)
    d = np.sqrt(m * (squares.sum() - squares))
    moments = [d[i] * d[j] for i, j in ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2))]
    units = np.array([m, *(m * np.sqrt(squares)), *moments])
    return float(np.sqrt(np.mean((errors / units) ** 2)))


def trunk_factor(
    stance: Stance, model: TorqueModel, motion: StandingMotion, number: int
) -> Array:
    """Return the triangle of the trunk's columns, those of drives taken out of them."""
    n, moved = len(motion.time), motion.joints
    log = Recording(
        stance.robot.joint_names,
        motion.time,
        moved.q,
        moved.dq,
        moved.ddq,
        np.zeros_like(moved.q),
        base=motion.trunk.base,
        contacts=stance.contacts(n),
        torque_known=abs(moved.dq) > REST,
    )
    free = contact_free_model(model)
    (R,) = contact_free_regression(free, log).factors
    drives = np.arange(10 * len(stance.robot.links), len(model.layout))
    columns = R[:, np.append(drives, 10 * number + np.arange(10))]
    triangle = np.asarray(np.linalg.qr(columns, mode="r"))[-10:, -10:]
    sizes = abs(np.diagonal(triangle))
    if len(triangle) < 10 or not sizes.min() > 1e-9 * sizes.max():
        raise NotExcitedError("the trunk's path does not tell its ten parameters")
    return np.asarray(triangle)

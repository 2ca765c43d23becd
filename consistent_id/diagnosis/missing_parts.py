"""Causes that residuals look like: drift, springs, coupled joints.

What least squares leaves of each joint's torque is regressed on what the model may
lack.  What takes up most of it is taken off the torque, and the log is fitted again.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from consistent_id._support.arrays import Matrix, Vector
from consistent_id.diagnosis.channel_factors import channel_factors
from consistent_id.diagnosis.corrections import Cause
from consistent_id.diagnosis.explain import Candidate, FittedLog
from consistent_id.regression.motion_arrays import motion_of

_THRESHOLD = 1.3  # ratio of misfits, as in the table of corrections
# Of a drift: a filtered torque is slow too, and a line in time takes up half of that.
_OF_DRIFT = 2.0
_SHARE = 0.5  # of the squared residual, that what is missing has to take up
_BOTH = 0.25  # in each of two joints
_MATTERS = 0.1  # of the largest squared residual: the others' are not looked at
_CREEP = 0.02  # rad/s or m/s, of the smooth Coulomb term


@dataclass(frozen=True, slots=True, eq=False)
class Residual:
    """What least squares leaves of a joint's torque.

    Parameters
    ----------
    spanned : ndarray, shape (samples, columns)
        Orthonormal columns of the model.
    rest : ndarray, shape (samples,), [N m or N]
    size : float
        Norm of the torque.
    """

    spanned: Matrix
    rest: Vector
    size: float

    @property
    def energy(self) -> float:
        """Squared, relative to the torque."""
        return float(self.rest @ self.rest) / self.size**2

    def taken_up(self, columns: Matrix) -> Vector:
        """Return the part of the torque that columns beside the model's explain."""
        beside = columns - self.spanned @ (self.spanned.T @ columns)
        amount = np.linalg.lstsq(beside, self.rest, rcond=1e-6)[0]
        part: Vector = np.dot(columns, amount)
        return part

    def share(self, columns: Matrix) -> float:
        """Return the share of the squared residual that they take up."""
        part = self.taken_up(columns)
        left = self.rest - part + self.spanned @ (self.spanned.T @ part)
        return 1.0 - float(left @ left) / max(float(self.rest @ self.rest), 1e-300)


def residuals(log: FittedLog) -> list[Residual]:
    """Return what least squares of each joint's own row leaves."""
    model = log.factors.model
    motion = motion_of(model, log.recording, None)
    Y = model.regressor(motion.q, motion.dq, motion.ddq)
    found = []
    for row, tau in zip(Y, motion.torque.T, strict=True):
        columns = row[list(log.factors.base.independent)].T
        U, s, _ = np.linalg.svd(_unit(columns), full_matrices=False)
        spanned = U[:, s > 1e-6 * s.max(initial=0.0)]
        rest = tau - spanned @ (spanned.T @ tau)
        found.append(Residual(spanned, rest, max(float(np.linalg.norm(tau)), 1e-300)))
    return found


def _unit(columns: Matrix) -> Matrix:
    norms = np.linalg.norm(columns, axis=0)
    return np.asarray(columns[:, norms > 0.0] / norms[norms > 0.0])


def missing_parts(as_is: FittedLog) -> list[Candidate]:
    """Return the causes that most of the residuals look like."""
    left = residuals(as_is)
    most = max(r.energy for r in left)
    matter = [j for j, r in enumerate(left) if r.energy >= _MATTERS * most]
    return [
        *_of_one_joint(as_is, left, matter),
        *_of_pairs(as_is, left, matter),
    ]


def _of_one_joint(
    as_is: FittedLog, left: list[Residual], matter: list[int]
) -> Iterator[Candidate]:
    names = as_is.factors.model.torque_joints
    log = as_is.recording.of(names)
    lapse = np.linspace(-1.0, 1.0, len(log))[:, None]
    for j in matter:
        q = log.position[:, j]
        spring = np.column_stack([q, q**2, q**3, np.sin(2 * q), np.cos(2 * q)])
        for columns, kind, statement, advice in (
            (
                lapse,
                "drift",
                "without a drift of the torque of {}",
                "warm up the sensor or the drive, or split the log (an offset each)",
            ),
            (
                spring,
                "spring",
                "with a torque at {} that depends on its position",
                "add spring = true to its drive terms, or a term of its own: a "
                "counterbalance, a cable or a spring",
            ),
        ):
            if left[j].share(columns) >= _SHARE:
                cause = Cause(
                    kind,
                    names[j],
                    statement.format(names[j]),
                    advice,
                    _OF_DRIFT if kind == "drift" else _THRESHOLD,
                    excuse=2 if kind == "spring" else 0,
                    of_residual=True,
                )
                parts = {names[j]: left[j].taken_up(columns)}
                yield _without(as_is, cause, parts)
                break


def _of_pairs(
    as_is: FittedLog, left: list[Residual], matter: list[int]
) -> Iterator[Candidate]:
    names = as_is.factors.model.torque_joints
    speed = np.asarray(as_is.recording.of(names).velocity)
    for i, j in combinations(matter, 2):
        both = np.tanh((speed[:, i] + speed[:, j]) / _CREEP)[:, None]
        if min(left[i].share(both), left[j].share(both)) < _BOTH:
            continue
        cause = Cause(
            "coupling",
            f"{names[i]}, {names[j]}",
            f"with friction of a motor that turns with {names[i]} and {names[j]}",
            "add a gear coupling of these joints (couplings)",
            _THRESHOLD,
            of_residual=True,
        )
        parts = {names[k]: left[k].taken_up(both) for k in (i, j)}
        yield _without(as_is, cause, parts)


def _without(as_is: FittedLog, cause: Cause, parts: dict[str, Vector]) -> Candidate:
    """Return the log without parts of its torque, by joint."""
    log = as_is.recording
    torque = np.array(log.torque)
    for name, part in parts.items():
        torque[:, log.joints.index(name)] -= part
    model, base = as_is.factors.model, as_is.factors.base
    (factors,) = channel_factors(model, base, [replace(log, torque=torque)])
    return Candidate(cause, factors, as_is.constraints)

"""Slopes of a measured torque on the parts of the nominal model.

Per joint ``tau = a g(q) + b (tau_0(q, dq, ddq) - g(q)) + viscous dq + coulomb s(dq) +
c``, with the nominal robot's gravity torque ``g`` and torque ``tau_0``.  The slopes
``a`` and ``b`` are one for a torque in N m of the robot that the model describes.

A joint with a spring or a counterbalance in the model has ``spring q`` besides: it
carries part of gravity, which is no gain of the torque.  A rotor adds to the inertial
part: where the model has one, that part shows no gain above one.
"""

from dataclasses import dataclass, replace

import numpy as np

from consistent_id._support.arrays import Array, BoolArray, Matrix, Vector
from consistent_id.diagnosis.linearise import Fitted, jackknife
from consistent_id.diagnosis.sample_rows import SampleRows
from consistent_id.recordings.recording import Recording
from consistent_id.regression.drive.laws import RotorInertia, Spring
from consistent_id.regression.drive.term import DriveTerm
from consistent_id.regression.regressor import TorqueModel
from consistent_id.robot.scaling import reference_bodies

_CREEP = 0.02  # rad/s or m/s, of the smooth Coulomb term
# Share of the torque's standard deviation: larger parts are judged.  A constant part,
# such as the weight on a sliding trunk, cannot be distinguished from an offset.
_SHOWN = 0.3
_SURE = 0.15  # largest standard error over the slope's scale that can be judged
# Student's quantile for one degree of freedom less than segments, over the normal one.
_FEW = 2.0930 / 1.9600


@dataclass(frozen=True, slots=True, eq=False)
class TorqueParts:
    """Slopes on the parts of the nominal model, per torque joint.

    Parameters
    ----------
    gravity, inertial, whole : ndarray, shape (joints,)
        Slopes on the gravity torque, on the inertial torque (Coriolis included), and on
        their sum.
    gravity_error, inertial_error, whole_error : ndarray, shape (joints,)
        Standard errors from leaving segments out, which allows for correlation.  They
        are so much larger, for few segments, that 1.96 of them are 95 % intervals.
    gravity_shown, inertial_shown, whole_shown : ndarray of bool, shape (joints,)
        Whether the part is large enough and the slope exact enough to be judged.
    friction : ndarray, shape (joints,)
        RMS friction over the torque's standard deviation.
    bodies : ndarray, shape (joints,)
        Standard deviation of the fitted parts of bodies, over the torque's.
    rest : ndarray, shape (joints,)
        RMS torque that no part explains, over the torque's standard deviation.
    rotors : ndarray of bool, shape (joints,)
        Whether the model has a rotor there, which adds to the inertial part.
    """

    joints: tuple[str, ...]
    gravity: Vector
    gravity_error: Vector
    gravity_shown: BoolArray
    inertial: Vector
    inertial_error: Vector
    inertial_shown: BoolArray
    whole: Vector
    whole_error: Vector
    whole_shown: BoolArray
    friction: Vector
    bodies: Vector
    rest: Vector
    rotors: BoolArray


def torque_parts(model: TorqueModel, prepared: Recording) -> TorqueParts:
    """Regress a prepared log's torque on the parts of the nominal model."""
    log = SampleRows.of(model, prepared)
    parts = np.stack(nominal_parts(log), axis=-1)  # (samples, joints, parts)
    parts = log.filtered(parts.transpose(1, 2, 0)).transpose(0, 2, 1)
    rubbing = log.filtered(friction_shapes(log)).transpose(0, 2, 1)
    springs = log.filtered(log.place[:, None]).transpose(0, 2, 1)
    sprung, rotors = _having(model, Spring), _having(model, RotorInertia)
    none = np.zeros((len(log.motion.q), 0))
    rows = [
        (
            *_of_joint(
                parts[j],
                np.hstack([rubbing[j], springs[j] if joint in sprung else none]),
                log.torque[j],
            ),
            joint in rotors,
        )
        for j, joint in enumerate(model.torque_joints)
    ]
    return TorqueParts(model.torque_joints, *map(np.array, zip(*rows, strict=True)))


def nominal_parts(log: SampleRows) -> tuple[Matrix, Matrix]:
    """Return gravity and inertial torque of the nominal robot along `SampleRows.along`.

    Returns
    -------
    two ndarray, each shape (samples of `along`, torque joints)
        Not filtered.
    """
    model, (q, dq, ddq) = log.model, log.along[:3]
    rigid = TorqueModel(model.robot, torque_joints=model.torque_joints)
    bodies = reference_bodies(model.robot).ravel()
    gravity = rigid.rigid_torque(bodies, (q, None, None))
    whole = rigid.rigid_torque(bodies, (q, dq, ddq))
    return gravity, whole - gravity


def friction_shapes(log: SampleRows) -> Array:
    """Return viscous and Coulomb friction and an offset, (torque joints, 3, samples).

    Along `SampleRows.along`, not filtered.
    """
    speed = log.speed
    return np.stack([speed, np.tanh(speed / _CREEP), np.ones_like(speed)], axis=1)


def _having(model: TorqueModel, law: type[DriveTerm]) -> set[str]:
    """Return the joints whose drive model has a term, such as a spring."""
    return {
        joint
        for joint, drive in zip(model.robot.joint_names, model.terms, strict=True)
        if any(isinstance(term, law) for term in drive.terms)
    }


def _of_joint(
    bodies: Matrix, others: Matrix, torque: Vector
) -> tuple[float | bool, ...]:
    """Return the slopes of a joint on gravity and inertial torque, beside others.

    Parameters
    ----------
    bodies : ndarray, shape (samples, 2)
    others : ndarray, shape (samples, columns)
        Friction, offset and spring.
    """
    changing, (g, inertial) = float(np.std(torque)) or 1.0, bodies.T
    parts = np.column_stack([bodies, others])
    fit = _fitted(parts, torque)
    whole = _fitted(np.column_stack([g + inertial, others]), torque)
    a, b = fit.solution[:2]
    rubbed = parts[:, 2:4] @ fit.solution[2:4]
    return (
        *_judged(a, fit.errors[0], g, changing),
        *_judged(b, fit.errors[1], inertial, changing),
        *_judged(whole.solution[0], whole.errors[0], g + inertial, changing),
        float(np.sqrt(np.mean(rubbed**2))) / changing,
        float(np.std(parts[:, :2] @ fit.solution[:2])) / changing,
        fit.misfit / (changing * float(np.sqrt(len(torque)))),
    )


def _judged(
    slope: float, error: float, part: Vector, changing: float
) -> tuple[float, float, bool]:
    """Return a slope, its standard error, and whether it can be judged."""
    size = float(np.std(part))
    large = max(1.0, abs(slope)) * size >= _SHOWN * changing
    # In other units of torque, the scale of a slope is the one that fits the torque.
    scale = max(abs(slope), min(1.0, changing / size if size > 0.0 else 1.0))
    return float(slope), float(error), bool(large and error <= _SURE * scale)


def _fitted(columns: Matrix, torque: Vector) -> Fitted:
    fit = jackknife(columns[None], torque[None]).fitted(list(range(columns.shape[1])))
    return replace(fit, errors=_FEW * fit.errors)

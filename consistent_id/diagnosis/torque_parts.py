"""How much of each part of the nominal model a measured torque holds.

Per joint ``tau = a g(q) + b (tau_0(q, dq, ddq) - g(q)) + viscous dq + coulomb s(dq) +
c``, with the nominal robot's gravity torque ``g`` and torque ``tau_0``.  The slopes
``a`` and ``b`` are one for a torque in N m of the robot that the model describes.

A joint to which the model gives a spring or a counterbalance has ``spring q`` beside:
it carries a part of gravity, which is no gain of the torque.  A rotor adds to the
inertial part: where the model has one, no gain above one is read off that part.
"""

from dataclasses import dataclass

import numpy as np

from consistent_id._support.arrays import BoolArray, Matrix, Vector
from consistent_id.diagnosis.jackknife import Fitted, jackknife
from consistent_id.recordings.recording import Recording
from consistent_id.regression.drive.laws import RotorInertia, Spring
from consistent_id.regression.drive.term import DriveTerm
from consistent_id.regression.regressor import TorqueModel
from consistent_id.robot.scaling import reference_bodies

_CREEP = 0.02  # rad/s or m/s, of the smooth Coulomb term
# Of what changes in the torque: a part that is expected to be, or is, so large counts.
# What is constant, as the weight that a sliding trunk carries, is an offset as well.
_SHOWN = 0.3
_SURE = 0.15  # standard error of a slope over the slope's scale that can be judged


@dataclass(frozen=True, slots=True, eq=False)
class TorqueParts:
    """Slopes on the parts of the nominal model, per torque joint.

    Parameters
    ----------
    gravity, inertial, whole : ndarray, shape (joints,)
        Slopes on the gravity torque, on the inertial torque (Coriolis included), and on
        their sum.
    gravity_error, inertial_error, whole_error : ndarray, shape (joints,)
        Standard errors, by leaving segments out: residual correlation is counted.
    gravity_shown, inertial_shown, whole_shown : ndarray of bool, shape (joints,)
        Whether the part is large enough, and the slope sure enough, to be judged.
    friction : ndarray, shape (joints,)
        Root mean square of the friction's part over the torque's standard deviation.
    bodies : ndarray, shape (joints,)
        Root mean square of what changes in the bodies' parts, as fitted, likewise.
    rest : ndarray, shape (joints,)
        What no part explains, likewise.
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
    g, inertial = nominal_parts(model, prepared)
    log = prepared.of(model.torque_joints)
    torque, speed = np.asarray(log.torque), np.asarray(log.velocity)
    sprung, rotors = _having(model, Spring), _having(model, RotorInertia)
    rows = [
        (
            *_of_joint(
                g[:, j],
                inertial[:, j],
                speed[:, j],
                torque[:, j],
                log.position[:, [j]] if joint in sprung else None,
            ),
            joint in rotors,
        )
        for j, joint in enumerate(model.torque_joints)
    ]
    return TorqueParts(model.torque_joints, *map(np.array, zip(*rows, strict=True)))


def nominal_parts(model: TorqueModel, prepared: Recording) -> tuple[Matrix, Matrix]:
    """Return gravity and inertial torque of the nominal robot, (samples, joints)."""
    rigid = TorqueModel(model.robot, torque_joints=model.torque_joints)
    bodies = reference_bodies(model.robot).ravel()
    log = prepared.of(model.robot.joint_names)
    rates = np.asarray(log.velocity), np.asarray(log.acceleration)
    gravity = rigid.rigid_torque(bodies, (log.position, None, None))
    whole = rigid.rigid_torque(bodies, (log.position, *rates))
    return gravity, whole - gravity


def _having(model: TorqueModel, law: type[DriveTerm]) -> set[str]:
    """Return the joints whose drive the model gives a term, such as a spring."""
    return {
        joint
        for joint, drive in zip(model.robot.joint_names, model.terms, strict=True)
        if any(isinstance(term, law) for term in drive.terms)
    }


def _of_joint(
    g: Vector, inertial: Vector, speed: Vector, torque: Vector, spring: Matrix | None
) -> tuple[float | bool, ...]:
    changing = float(np.std(torque)) or 1.0
    friction = [speed, np.tanh(speed / _CREEP), np.ones_like(speed)]
    friction += [] if spring is None else [spring]
    parts = np.column_stack([g, inertial, *friction])
    fit = _fitted(parts, torque)
    whole = _fitted(np.column_stack([g + inertial, *friction]), torque)
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
    # Of a torque in other units, a slope is known beside what would fill the torque.
    scale = max(abs(slope), min(1.0, changing / size if size > 0.0 else 1.0))
    return float(slope), float(error), bool(large and error <= _SURE * scale)


def _fitted(columns: Matrix, torque: Vector) -> Fitted:
    return jackknife(columns[None], torque[None]).fitted(list(range(columns.shape[1])))

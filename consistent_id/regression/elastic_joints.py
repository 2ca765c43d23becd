"""Joints with a spring between motor and link (two masses at each joint).

The encoder sits at the motor, which is at ``theta``; the link is off by ``delta``:

``tau = drive(theta) + body(theta + delta)``,
``body(theta + delta) + d delta' + k delta = 0``.

Rotor and friction of the drive move with the motor, bodies with the link.  The torque
that moves bodies as the links do, less the torque that would move them as the motors
do, is no part of a rigid robot's torque.  Without it, the recorded torque is that of
the same robot without springs, which all other rooms assume.

Bodies vibrate on their springs, so ``delta`` follows from the motion of motors by a
differential equation: linear, with the mass matrix of the mean position, solved mode by
mode; all other torque of the bodies is on its right-hand side, from the round before.
"""

from dataclasses import replace

import numpy as np

from consistent_id._support.arrays import Matrix, Vector
from consistent_id._support.caches import kept_with
from consistent_id.errors import ModelError, RecordingError
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals.clocks import uniform_rate
from consistent_id.recordings.signals.filtered_rows import altered
from consistent_id.regression.drive.drive_terms import DriveTerms
from consistent_id.regression.mass_matrix import mass_matrices
from consistent_id.regression.regressor import TorqueModel
from consistent_id.robot.chains import branches_with
from consistent_id.robot.model import RobotModel

DAMPING = 0.03
"""Damping of a link on its spring over the critical one; gears and belts have 1 to 10
%.
"""

_ROUNDS = 3
"""Rounds of computing deflections from torque and torque from deflections.  The error
falls in each round by the relative change of the mass matrix over the deflection.
"""


def as_rigid(robot: RobotModel, recording: Recording, compliance: Vector) -> Recording:
    """Return a recording with the torque that the robot would need without springs.

    Parameters
    ----------
    robot : RobotModel
        With nominal bodies, from which the springs' torque is computed.
    recording : Recording
        With position of the motors as seen from the links, velocity, acceleration and
        torque; filtered.
    compliance : ndarray, shape (joints,), [rad/(N m) or m/N]
        Zero for a rigid joint.

    Raises
    ------
    ModelError
        If bodies of the robot are not known.
    RecordingError
        If the recording's clock is not uniform.
    """
    if recording.torque is None or not np.any(compliance):
        return recording
    return altered(recording, lambda log: _as_rigid(robot, log, compliance))


def _as_rigid(robot: RobotModel, recording: Recording, compliance: Vector) -> Recording:
    rigid = np.array(recording.torque)
    places = [recording.joints.index(name) for name in robot.joint_names]
    rigid[:, places] -= deflection_torque(robot, recording, compliance)
    return replace(recording, torque=rigid)


def deflection_torque(
    robot: RobotModel, recording: Recording, compliance: Vector
) -> Matrix:
    """Return the effect of springs on joint torques, (samples, joints), [N m or N].

    Parameters and errors are those of `as_rigid`.
    """
    every = robot.joint_names
    torque = np.zeros((len(recording), len(every)))
    # Springs move nothing on other branches: of a quadruped, they shake one leg.
    robot = branches_with(robot, tuple(np.array(every)[compliance > 0.0].tolist()))
    own = [every.index(name) for name in robot.joint_names]
    torque[:, own] = _of_branches(robot, recording, compliance[own])
    return torque


def _of_branches(robot: RobotModel, recording: Recording, compliance: Vector) -> Matrix:
    """Return `deflection_torque` of a robot all whose branches have springs."""
    q, dq, ddq = _motion(robot, recording)
    bodies, x = TorqueModel(robot, DriveTerms()), _nominal(robot)
    soft = np.flatnonzero(compliance)
    M = mass_matrices(bodies, x, q.mean(axis=0)[None])[0][np.ix_(soft, soft)]
    stiff = carried = _stiff_torque(recording, robot)
    change = np.zeros((3, *q.shape))  # of position, velocity and acceleration
    for _ in range(_ROUNDS):
        force = change[2][:, soft] @ M - carried[:, soft]
        step = 1.0 / uniform_rate(recording)
        change[:, :, soft] = _vibration(M, 1.0 / compliance[soft], force, step)
        carried = bodies.predict(x, q + change[0], dq + change[1], ddq + change[2])
    return np.asarray(carried - stiff)


@kept_with(0, most=16)  # a search tries many springs on the same recordings
def _stiff_torque(recording: Recording, robot: RobotModel) -> Matrix:
    """Return the torque of a rigid robot's bodies, (samples, joints), [N m or N]."""
    bodies = TorqueModel(robot, DriveTerms())
    return bodies.predict(_nominal(robot), *_motion(robot, recording))


def _motion(robot: RobotModel, recording: Recording) -> tuple[Matrix, Matrix, Matrix]:
    """Return position, velocity and acceleration of a robot's motors."""
    motors = recording.of(robot.joint_names)
    dq, ddq = motors.velocity, motors.acceleration
    if dq is None or ddq is None:
        raise RecordingError(
            f"{motors.name}: the torque of springs needs velocity and acceleration; "
            "call signals.differentiated(recording) first"
        )
    return motors.position, dq, ddq


def link_inertias(robot: RobotModel, q: Vector) -> Vector:
    """Return the inertia that each joint's spring moves alone, [kg m^2 or kg].

    Parameters
    ----------
    robot : RobotModel
        With nominal bodies.
    q : ndarray, shape (joints,), [rad or m]
    """
    M = mass_matrices(TorqueModel(robot, DriveTerms()), _nominal(robot), q[None])[0]
    return np.array(np.diag(M))


def _nominal(robot: RobotModel) -> Vector:
    x = robot.nominal
    if x is None:
        raise ModelError(
            f"robot {robot.name!r}: springs between motors and links carry its bodies, "
            "but its file does not state all of their inertias; leave stiffness out"
        )
    return x


def _vibration(M: Matrix, stiffness: Vector, force: Matrix, step: float) -> Matrix:
    """Solve ``M delta'' + D delta' + K delta = force``, from equilibrium.

    Each mode has the damping `DAMPING`, and the force is linear between samples.

    Returns
    -------
    ndarray, shape (3, samples, springs)
        Deflection, its velocity and acceleration.
    """
    from scipy.linalg import eigh
    from scipy.linalg.lapack import ztbtrs  # scipy.signal takes a second to import

    squares, modes = eigh(np.diag(stiffness), M)
    found = np.zeros((3, *force.shape))
    for square, mode in zip(squares.tolist(), modes.T, strict=True):
        rate, damping = np.sqrt(square), DAMPING
        s = rate * complex(-damping, np.sqrt(1.0 - damping**2))
        # y = 2 Re z of z' = s z + g u, with u linear between samples
        g, grown = 1.0 / (2.0j * s.imag), np.exp(s * step)
        whole = g * (grown - 1.0) / s
        later = g * (grown - 1.0 - s * step) / (s * s * step)
        push = force @ mode
        grows = later * push
        grows[1:] += (whole - later) * push[:-1]
        grows[0] = -g * push[0] / s  # equilibrium
        band = np.repeat([[1.0], [-grown]], len(push), axis=1)
        z = ztbtrs(band, grows[:, None], uplo="L", diag="U")[0][:, 0]
        y, dy = 2.0 * z.real, 2.0 * (s * z).real
        motion = np.array([y, dy, push - square * y - 2.0 * damping * rate * dy])
        found += motion[:, :, None] * mode
    return found

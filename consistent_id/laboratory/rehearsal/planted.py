"""Robots of planted parameters: near the nominal one, with friction that it lacks."""

from dataclasses import dataclass

import numpy as np

from consistent_id._support.arrays import Matrix, Vector, freeze_arrays
from consistent_id.errors import ModelError
from consistent_id.motion.limits import MotionLimits
from consistent_id.regression.drive.drive_terms import DriveTerms
from consistent_id.regression.regressor import TorqueModel
from consistent_id.robot.inertia import inertial_vector, pseudo_inertia
from consistent_id.robot.model import RobotModel

DRIVE = DriveTerms(
    viscous=True, coulomb="tanh", velocity_scale=0.02, rotor_inertia=True
)
"""By which the planted robot is identified."""
_CONTROL = DriveTerms(rotor_inertia=True)  # what its controller knows of drives
_ROTOR = 0.002  # kg m^2 of a geared rotor for each N m; 0.66 for 330 N m
_DRIVES = 0.9  # share of the rotors' inertia that the controller believes in
_SPREAD = 0.1  # of the stretch that makes a planted body of a nominal one
_FRICTION = 0.04  # dry friction, in shares of the torque that a joint may have
_COUNTS = 2048  # steps of a current's reading up to the largest, of 12 bits with a sign
_POSES = 50  # at which torque is looked at where no effort limit is known


@dataclass(frozen=True, slots=True, eq=False)
class TorqueSensors:
    """What a log has for torque: torque itself, or motor currents in torque units.

    Parameters
    ----------
    gains : ndarray, shape (joints,)
        True torque over what a current is taken for: torque constants are known
        roughly.
    steps : ndarray, shape (joints,), [N m or N]
        Of a reading; 0 for none.
    """

    gains: Vector
    steps: Vector

    def __post_init__(self) -> None:
        shapes = dict.fromkeys(("gains", "steps"), (None,))
        freeze_arrays(self, shapes, "torque sensors")

    def read(self, torque: Matrix) -> Matrix:
        """Return what is logged of a torque, shape (samples, joints)."""
        readings = torque / self.gains
        steps = np.where(self.steps > 0.0, self.steps, 1.0)
        stepped = np.floor(readings / steps + 0.5) * steps
        return np.asarray(np.where(self.steps > 0.0, stepped, readings))


@dataclass(frozen=True, slots=True, eq=False)
class PlantedRobot:
    """A robot whose parameters are known, because they were chosen.

    Parameters
    ----------
    model : TorqueModel
        By which it is identified: viscous friction, and Coulomb's as a ``tanh``.
    parameters : ndarray, shape (parameters,)
        The truth; Coulomb coefficients are those of dry friction.
    controlled : TorqueModel
        The controller's: rigid bodies and rotors.
    believed : ndarray, shape (parameters of `controlled`,)
        What the controller takes for the truth: the nominal robot, and most of the
        rotors.
    effort : ndarray, shape (joints,), [N m or N]
        Torque that each joint has at most; infinite where that is not known.
    sensors : TorqueSensors
        What its log has for torque.
    """

    model: TorqueModel
    parameters: Vector
    controlled: TorqueModel
    believed: Vector
    effort: Vector
    sensors: TorqueSensors

    def __post_init__(self) -> None:
        shapes = {
            "parameters": (len(self.model.layout),),
            "believed": (len(self.controlled.layout),),
            "effort": (len(self.model.robot),),
        }
        freeze_arrays(self, shapes, "planted robot", finite=False)

    def without_friction(self, parameters: Vector) -> Vector:
        """Return the parameters of `controlled` among those of `model`."""
        layout = self.model.layout
        return parameters[[layout.index(n) for n in self.controlled.layout.names]]


def planted_robot(
    robot: RobotModel,
    limits: MotionLimits,
    rng: np.random.Generator,
    currents: float | None = None,
    known: Vector | None = None,
) -> PlantedRobot:
    """Return a robot near the nominal one.

    The pseudo-inertia of each body becomes ``A J A^T`` with a random ``A`` near one,
    which is the density of the same body stretched: always consistent.

    Parameters
    ----------
    currents : float, optional
        If it logs motor currents: the share, one standard deviation, to which their
        torque constants are known.
    known : ndarray, shape (parameters,), optional
        Of an estimate by bodies and `DRIVE`: friction and rotors that it found are
        planted to some percent, instead of made-up ones.

    Raises
    ------
    ModelError
        If the nominal robot is not known.
    """
    nominal = robot.nominal
    if nominal is None:
        raise ModelError(
            f"robot {robot.name!r}: some links have no nominal inertia, so that no "
            "robot like it can be planted; give the file inertias"
        )
    links = len(robot.links)
    stretch = np.eye(4) + _SPREAD * rng.normal(size=(links, 4, 4)) / 2.0
    J = pseudo_inertia(nominal.reshape(links, 10))
    bodies = inertial_vector(stretch @ J @ stretch.transpose(0, 2, 1)).ravel()
    model, controlled = TorqueModel(robot, DRIVE), TorqueModel(robot, _CONTROL)
    strength = _strength(TorqueModel(robot), nominal, limits)
    dry = _FRICTION * strength * rng.uniform(0.5, 1.5, len(robot))
    speed = np.where(np.isfinite(limits.velocity), limits.velocity, 1.0)
    drives = {
        "viscous": dry / speed * rng.uniform(0.5, 1.5, len(robot)),
        "coulomb": dry,
        "rotor_inertia": _ROTOR * strength,
    }
    x, believed = np.zeros(len(model.layout)), np.zeros(len(controlled.layout))
    x[: len(bodies)], believed[: len(nominal)] = bodies, nominal
    for j, name in enumerate(robot.joint_names):
        for term, values in drives.items():
            x[model.layout.index(f"{name}.{term}")] = values[j]
    if known is not None:
        own = slice(model.layout.inertial_size, None)
        near = known[own] * np.exp(_SPREAD * rng.normal(size=len(x[own])))
        x[own] = np.where(known[own] > 0.0, near, x[own])
    for name in robot.joint_names:
        rotor = _DRIVES * x[model.layout.index(f"{name}.rotor_inertia")]
        believed[controlled.layout.index(f"{name}.rotor_inertia")] = rotor
    sensors = TorqueSensors(np.ones(len(robot)), np.zeros(len(robot)))
    if currents is not None:
        gains = np.exp(currents * rng.normal(size=len(robot)))
        sensors = TorqueSensors(gains, strength / _COUNTS)
    return PlantedRobot(model, x, controlled, believed, limits.effort, sensors)


def _strength(model: TorqueModel, nominal: Vector, limits: MotionLimits) -> Vector:
    """Return effort limits; where there is none, twice the largest gravity torque.

    Of joints that carry little, a third of that of the joint that carries most.
    """
    rng = np.random.default_rng(0)
    poses = rng.uniform(limits.lower, limits.upper, (_POSES, len(model.robot)))
    still = np.zeros_like(poses)
    torque = model.predict(nominal, poses, still, still)
    needed = 2.0 * abs(torque).max(axis=0)
    known = np.isfinite(limits.effort)
    return np.where(known, limits.effort, np.maximum(needed, needed.max() / 3.0))

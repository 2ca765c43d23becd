"""Robots of planted parameters: near the nominal one, with friction that it lacks.

They have rigid bodies, viscous and Coulomb friction and rotors, independent of the
problem's ``[drive]``; its other terms are left out, and named.  In MuJoCo their
friction is dry, they have no shapes, and each joint has one torque.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from consistent_id._support.arrays import Array, IntArray, Matrix, Vector, freeze_arrays
from consistent_id._support.tables import brief
from consistent_id.constraints.cones.certificate import Certificate
from consistent_id.errors import ModelError, ProblemError
from consistent_id.estimation.estimate import Estimate
from consistent_id.excitation.aims import is_named, parameters_named
from consistent_id.export.mjcf_bodies import require_mujoco
from consistent_id.export.mjcf_export import mujoco_spec
from consistent_id.motion.limits import MotionLimits
from consistent_id.regression.base import base_parameters
from consistent_id.regression.drive.drive_terms import DriveTerms
from consistent_id.regression.regressor import TorqueModel
from consistent_id.robot.inertia import (
    InertialParameters,
    inertial_vector,
    pseudo_inertia,
)
from consistent_id.robot.model import RobotModel

DRIVE = DriveTerms(
    viscous=True, coulomb="tanh", velocity_scale=0.02, rotor_inertia=True
)
"""Drive terms with which the planted robot is identified."""
_CONTROL = DriveTerms(rotor_inertia=True)  # drive terms of its controller
_ROTOR = 0.002  # kg m^2 of a geared rotor for each N m; 0.66 for 330 N m
_DRIVES = 0.9  # share of the rotors' inertia that the controller believes in
_SPREAD = 0.1  # of the stretch that makes a planted body of a nominal one
_FRICTION = 0.04  # dry friction, in shares of the torque that a joint may have
_COUNTS = 2048  # steps of a current's reading up to the largest, of 12 bits with a sign
_POSES = 50  # at which torque is looked at where no effort limit is known


@dataclass(frozen=True, slots=True, eq=False)
class TorqueSensors:
    """The torque signal of a log: torque itself, or motor currents in torque units.

    Parameters
    ----------
    gains : ndarray, shape (joints,)
        True torque over the torque computed from currents: torque constants have
        errors.
    steps : ndarray, shape (joints,), [N m or N]
        Steps of a reading; 0 for none.
    """

    gains: Vector
    steps: Vector

    def __post_init__(self) -> None:
        shapes = dict.fromkeys(("gains", "steps"), (None,))
        freeze_arrays(self, shapes, "torque sensors")

    def read(self, torque: Matrix) -> Matrix:
        """Return the logged signal of a torque, shape (samples, joints)."""
        readings = torque / self.gains
        steps = np.where(self.steps > 0.0, self.steps, 1.0)
        stepped = np.floor(readings / steps + 0.5) * steps
        return np.asarray(np.where(self.steps > 0.0, stepped, readings))


@brief
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
        The controller's parameters: the nominal robot, and most of the rotors.
    effort : ndarray, shape (joints,), [N m or N]
        Torque that each joint has at most; infinite where that is not known.
    sensors : TorqueSensors
        The torque signal of its log.
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
        Parameters of an estimate by bodies and `DRIVE`: friction and rotors that it
        found are planted to some percent, instead of made-up ones.

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

    For joints that carry little, it is a third of that of the joint that carries most.
    """
    rng = np.random.default_rng(0)
    poses = rng.uniform(limits.lower, limits.upper, (_POSES, len(model.robot)))
    still = np.zeros_like(poses)
    torque = model.predict(nominal, poses, still, still)
    needed = 2.0 * abs(torque).max(axis=0)
    known = np.isfinite(limits.effort)
    return np.where(known, limits.effort, np.maximum(needed, needed.max() / 3.0))


@dataclass(frozen=True, slots=True, eq=False)
class MujocoRobot:
    """A compiled MuJoCo model, and where the joints of a robot are in it.

    Parameters
    ----------
    positions, velocities : ndarray, shape (joints,)
        Places in ``qpos`` and ``qvel``.
    """

    model: Any
    positions: IntArray
    velocities: IntArray

    @property
    def step(self) -> float:
        """Time step of the integrator [s]."""
        return float(self.model.opt.timestep)

    def at(self, q: Vector, dq: Vector) -> Any:
        """Return ``mujoco.MjData`` in a state."""
        mujoco = require_mujoco()
        data = mujoco.MjData(self.model)
        data.qpos[self.positions], data.qvel[self.velocities] = q, dq
        mujoco.mj_forward(self.model, data)
        return data

    def advance(self, data: Any, torque: Vector, steps: int) -> None:
        """Simulate some steps under constant torques."""
        data.qfrc_applied[self.velocities] = torque
        require_mujoco().mj_step(self.model, data, steps)


def mujoco_robot(robot: PlantedRobot, step: float) -> MujocoRobot:
    """Return a planted robot in MuJoCo.

    Parameters
    ----------
    step : float, [s]
        Step of the integrator.

    Raises
    ------
    ModelError
        If MuJoCo is not installed, refuses the robot, or joints follow others.
    """
    mujoco, arm = require_mujoco(), robot.model.robot
    if len(arm.joints) != len(arm.driven):
        raise ModelError(
            f"robot {arm.name!r}: joints that follow others cannot be rehearsed; lock "
            "them in the model"
        )
    spec = mujoco_spec(_as_estimate(robot), allow_refused=True).spec
    spec.option.timestep = step
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    try:
        model = spec.compile()
    except ValueError as cause:
        raise ModelError(f"MuJoCo refuses the planted robot: {cause}") from None
    # A design is judged by its required torque, which MuJoCo must not cut off.
    model.jnt_limited[:] = 0
    model.jnt_actfrclimited[:] = 0
    joints = [model.joint(name) for name in arm.joint_names]
    return MujocoRobot(
        model,
        np.array([joint.qposadr[0] for joint in joints]),
        np.array([joint.dofadr[0] for joint in joints]),
    )


def _as_estimate(robot: PlantedRobot) -> Estimate:
    """Return the truth as an estimate, for exporters."""
    base, size = base_parameters(robot.model), len(robot.model.layout)
    noise: Array = np.zeros(len(robot.model.torque_joints))
    unproven = Certificate("uncertified", "planted, not estimated")
    return Estimate(
        "planted", robot.model, base, robot.parameters, None, ("data",) * size, (),
        noise, unproven,
    )  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class Rehearsed:
    """A problem's torque model as rehearsed robots have it.

    Parameters
    ----------
    model : TorqueModel
        Its robot is that of the first estimate, if there is one.
    parameters : ndarray, shape (members, parameters), optional
        Parameters of the estimates, by which torque limits are kept.
    notes : tuple of str
        On what is left out.
    """

    model: TorqueModel
    interest: tuple[str, ...]
    parameters: Matrix | None
    notes: tuple[str, ...]


def as_rehearsed(
    model: TorqueModel, interest: tuple[str, ...], parameters: Matrix | None = None
) -> Rehearsed:
    """Return a problem's torque model, interest and estimates for a rehearsal.

    Parameters
    ----------
    model : TorqueModel
        The problem's.
    parameters : ndarray, shape (members, parameters), optional
        Estimates of `model`.

    Raises
    ------
    ProblemError
        If a word names nothing, no interest is left, or the first estimate's bodies are
        not physically consistent, so that no robot has them.
    """
    robot = model.robot
    if parameters is not None:
        robot = _with_bodies(robot, parameters[0])
    played = TorqueModel(robot, DRIVE)
    kept = tuple(w for w in interest if is_named(played.layout, w))
    others = tuple(w for w in interest if w not in kept)
    parameters_named(model.layout, others)
    if interest and not kept:
        raise ProblemError(
            f"interest in {', '.join(others)}: rehearsed robots have rigid bodies, "
            "viscous and Coulomb friction and rotors only; name some of theirs"
        )
    notes = _left_out("interest", others)
    if parameters is None:
        return Rehearsed(played, kept, None, notes)
    missing = [name for name in model.layout.names if name not in played.layout.names]
    carried = [n for n in missing if parameters[:, model.layout.index(n)].any()]
    common = [name for name in played.layout.names if name in model.layout.names]
    known = np.zeros((len(parameters), len(played.layout)))
    places = [[one.index(n) for n in common] for one in (played.layout, model.layout)]
    known[:, places[0]] = parameters[:, places[1]]
    return Rehearsed(played, kept, known, (*notes, *_left_out("torque", carried)))


def _left_out(what: str, names: tuple[str, ...] | list[str]) -> tuple[str, ...]:
    if not names:
        return ()
    return (
        f"{what}: rehearsed robots have no {', '.join(names)}; the design that excite "
        "would make counts them",
    )


def _with_bodies(robot: RobotModel, parameters: Matrix) -> RobotModel:
    """Return the robot with an estimate's bodies for nominal ones."""
    bodies = parameters[: 10 * len(robot.links)].reshape(-1, 10)
    links = tuple(
        replace(link, nominal=InertialParameters(body))
        for link, body in zip(robot.links, bodies, strict=True)
    )
    for link in links:
        if link.nominal is not None and not link.nominal.is_consistent():
            raise ProblemError(
                f"the estimate's body of {link.name!r} is not physically consistent: "
                "no robot has it. Give an estimate with the constraint of consistency"
            )
    return replace(robot, links=links)

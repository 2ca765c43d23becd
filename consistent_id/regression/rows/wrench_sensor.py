"""Tools on a wrench sensor: bodies behind it, and the sensor's own bias.

The frame of the sensor is a base that moves as the arm carries it, and what it measures
is the wrench on that base: the six rows of a robot of one free body, with six biases.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from consistent_id._support.arrays import Array, Matrix, checked
from consistent_id.errors import RecordingError
from consistent_id.recordings.beside import BaseMotion, Wrench
from consistent_id.recordings.recording import Recording, several
from consistent_id.recordings.signals.filtered_rows import altered
from consistent_id.regression.regression import Regression, build_regression
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.row_names import BASE_ROWS
from consistent_id.regression.rows.sensor_drift import (
    Drift,
    SensorBias,
    bias_along,
    driftless_regression,
)
from consistent_id.robot.inertia import InertialParameters
from consistent_id.robot.kinematics import frame_motion
from consistent_id.robot.model import Datasheet, Joint, Link, RobotModel

_TIME_STEP = 0.01  # s, of samples that have no time: poses at rest


def tool_model(
    name: str = "tool",
    *,
    nominal: InertialParameters | None = None,
    bias: bool = True,
    gravity: ArrayLike = (0.0, 0.0, -9.81),
) -> TorqueModel:
    """Return the model of a tool or a payload behind a wrench sensor.

    Parameters
    ----------
    name : str
    nominal : InertialParameters, optional
        In the sensor's frame.
    bias : bool
        Whether the sensor's zero is unknown: six parameters.
    gravity : array_like, shape (3,), [m/s^2]

    Examples
    --------
    >>> tool_model("gripper").layout.names[-1]
    'base.nz.bias'
    """
    free = Joint("mount", "free", -1, np.eye(3), np.zeros(3), np.eye(3)[2])
    sheet = Datasheet()
    if nominal is not None and nominal.mass > 0.0:
        sheet = Datasheet(mass=nominal.mass, com=nominal.com)
    robot = RobotModel(
        name, (free,), (Link(name, nominal, sheet),), checked(gravity, (3,), "gravity")
    )
    return TorqueModel(robot, torque_joints=BASE_ROWS, wrench_bias=bias)


def sensor_motion(arm: RobotModel, recording: Recording, frame: str) -> BaseMotion:
    """Return the motion of one of an arm's frames, in the frame's own axes.

    Parameters
    ----------
    arm : RobotModel
        With a fixed base.
    recording : Recording
        Velocity and acceleration that are missing count as zero: poses at rest.
    frame : str
        The sensor's frame: a link of the arm, or one that is fixed to it.
    """
    log = recording.of(arm.joint_names)
    still = np.zeros_like(log.position)
    dq = still if log.velocity is None else log.velocity
    ddq = still if log.acceleration is None else log.acceleration
    return carried_base(arm, log.position, dq, ddq, frame)


def carried_base(
    arm: RobotModel, q: ArrayLike, dq: ArrayLike, ddq: ArrayLike, frame: str
) -> BaseMotion:
    """Return the motion of a frame by joints, in its own axes: see `sensor_motion`.

    `q`, `dq` and `ddq` have the shape (samples, joints).
    """
    dq, ddq = np.asarray(dq, dtype=float), np.asarray(ddq, dtype=float)
    moved = frame_motion(arm, q, dq, frame=frame)
    J = moved.jacobian
    twist = np.einsum("nij,nj->ni", J, dq)
    push = np.einsum("nij,nj->ni", J, ddq) + moved.bias
    return BaseMotion.from_world(
        moved.rotation, twist[:, 3:], push[:, 3:], push[:, :3], gravity=arm.gravity
    )


def sensor_regression(
    model: TorqueModel,
    arm: RobotModel,
    recordings: Recording | Sequence[Recording],
    *,
    frame: str,
    drift: Drift = "none",
) -> Regression:
    """Compress what a wrench sensor measured along an arm's motion.

    Parameters
    ----------
    model : TorqueModel
        Model of the tool behind the sensor, see `tool_model`.
    arm : RobotModel
        Up to the sensor.
    recordings : Recording or sequence of Recording
        Each with one wrench at `frame`, in its axes: what the arm does to the tool.  A
        sensor that shows what the tool does to the arm has the opposite sign.
    frame : str
    drift : {"none", "recordings", "linear"}
        Drift of the sensor's bias.  With ``"recordings"`` each recording has a bias of
        its own, with ``"linear"`` one that changes at a constant rate; then the model
        has none, ``tool_model(bias=False)``, and `sensor_bias` computes it afterwards.

    Raises
    ------
    RecordingError
        If a recording has no such wrench, or several.
    ProblemError
        If the bias drifts, and the model has a constant one.
    """
    logs = [carried(model.robot, arm, log, frame) for log in several(recordings)]
    if drift == "none":
        return build_regression(model, logs)
    return driftless_regression(model, logs, drift)


def sensor_bias(
    model: TorqueModel,
    parameters: ArrayLike,
    arm: RobotModel,
    recording: Recording,
    *,
    frame: str,
    drift: Drift = "recordings",
) -> SensorBias:
    """Return the bias of a sensor along a recording, of a tool that is known.

    Parameters
    ----------
    model, arm, recording, frame
        See `sensor_regression`.
    parameters : array_like, shape (parameters,)
        Parameters of the model, such as an estimate's.
    drift : {"recordings", "linear"}
        Whether the bias is constant along the recording.
    """
    x = checked(parameters, (len(model.layout),), "parameters")
    return bias_along(model, x, carried(model.robot, arm, recording, frame), drift)


def carried(
    tool: RobotModel, arm: RobotModel, recording: Recording, frame: str
) -> Recording:
    """Return an arm's recording as one of the body behind its sensor.

    Parameters
    ----------
    tool, arm, frame
        See `sensor_regression`; the robot of `tool_model`.
    recording : Recording
        With one wrench at the frame.

    Raises
    ------
    RecordingError
        If it has no such wrench, or several.
    """
    own = [wrench for wrench in recording.wrenches if wrench.frame == frame]
    if len(own) != 1 or own[0].axes != "frame" or own[0].point.any():
        raise RecordingError(
            f"{recording.name}: {len(own)} wrenches at {frame!r}, expected one, in the "
            "axes of the frame and about its origin"
        )
    return altered(recording, lambda log: _carried(tool, arm, log, frame))


def _carried(
    tool: RobotModel, arm: RobotModel, recording: Recording, frame: str
) -> Recording:
    (own,) = (wrench for wrench in recording.wrenches if wrench.frame == frame)
    zeros = np.zeros_like(recording.position)
    felt = Wrench(tool.link_names[0], own.values, axes="base")
    return replace(
        recording,
        velocity=zeros if recording.velocity is None else recording.velocity,
        acceleration=(
            zeros if recording.acceleration is None else recording.acceleration
        ),
        base=sensor_motion(arm, recording, frame),
        wrenches=(felt,),
        contacts=(),
    )


def static_poses(
    arm: RobotModel, poses: ArrayLike, wrenches: ArrayLike, *, frame: str
) -> Recording:
    """Return a recording of poses at rest, from the mean wrench at each.

    They determine mass, centre of mass and the bias; inertia needs motion.

    Parameters
    ----------
    arm : RobotModel
    poses : array_like, shape (poses, joints), [rad or m]
        At least three whose frames point differently.
    wrenches : array_like, shape (poses, 6), [N, N m]
        In the axes of the frame.
    frame : str
    """
    q: Matrix = checked(poses, (None, len(arm)), "poses", RecordingError)
    values: Array = checked(wrenches, (len(q), 6), "wrenches", RecordingError)
    time: Array = _TIME_STEP * np.arange(len(q), dtype=np.float64)
    return Recording(
        arm.joint_names,
        time,
        q,
        wrenches=(Wrench(frame, values),),
        name="poses at rest",
    )

"""Tools on a wrench sensor: bodies behind it, and the sensor's own bias.

The frame of the sensor is a base that moves as the arm carries it, and what it measures
is the wrench on that base: the six rows of a robot of one free body, with six biases.

A bias may drift.  In each recording each axis of the sensor shows ``Y x + N b + noise``
with a bias, and perhaps a rate of it, of its own: the columns of ``N`` are one and
time.  Multiplied by the projection ``1 - N N^+`` no ``b`` is left, whatever it was, and
least squares finds the ``x`` that it would find together with all ``b``.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from consistent_id._support.arrays import Array, Matrix, Vector, checked
from consistent_id._support.tables import brief
from consistent_id.errors import NotExcitedError, ProblemError, RecordingError
from consistent_id.recordings.beside import BaseMotion, Wrench
from consistent_id.recordings.recording import Recording, several
from consistent_id.recordings.signals.filtered_rows import altered
from consistent_id.regression.correlated_noise import (
    CorrelatedNoise,
    joined_noise,
    spectral_noise,
    white_noise,
)
from consistent_id.regression.model_errors import (
    BlockPart,
    JointFit,
    block_part,
    block_ratio,
    joint_fit,
)
from consistent_id.regression.motion_arrays import Motion
from consistent_id.regression.recorded_motion import motion_of
from consistent_id.regression.regression import Regression, build_regression, triangle
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.row_names import BASE_ROWS
from consistent_id.regression.segments import SEGMENTS, segment_cuts
from consistent_id.robot.inertia import InertialParameters
from consistent_id.robot.kinematics import frame_motion
from consistent_id.robot.model import Datasheet, Joint, Link, RobotModel

Drift = Literal["none", "recordings", "linear"]
"""Kinds of a bias: one for all recordings, one for each, or one for each that changes
at a constant rate.
"""

_EXACT = 1e-9  # residual, relative to the wrench, that is rounding
_TIME_STEP = 0.01  # s, of samples that have no time: poses at rest


@brief
@dataclass(frozen=True, slots=True, eq=False)
class SensorBias:
    """The readings of a wrench sensor without a load, in one recording.

    Parameters
    ----------
    start : ndarray, shape (6,), [N, N m]
        At the recording's first sample.
    rate : ndarray, shape (6,), [N/s, N m/s]
        Zero unless drift is linear.
    """

    start: Vector
    rate: Vector


def driftless_regression(
    model: TorqueModel, recordings: Sequence[Recording], drift: Drift
) -> Regression:
    """Compress recordings of a body behind a sensor, without the sensor's biases.

    Parameters
    ----------
    model : TorqueModel
        Without a bias of its own.
    recordings : sequence of Recording
        Recordings of the body itself, see `carried`.
    drift : {"recordings", "linear"}

    Raises
    ------
    ProblemError
        If the model has a bias.
    NotExcitedError
        If a recording has no more samples than parameters that are taken out.
    """
    _require_no_bias(model, drift)
    parts = [_rows_without_drift(model, log, drift) for log in recordings]
    return _compressed(model, parts)


def driftless_segments(
    model: TorqueModel,
    recordings: Sequence[Recording],
    drift: Drift,
    *,
    count: int = SEGMENTS,
) -> tuple[Regression, ...]:
    """Cut the rows of `driftless_regression` into segments; compress each.

    Their sum is the regression of the whole: see `segment_regressions`.
    """
    _require_no_bias(model, drift)
    parts = [_rows_without_drift(model, log, drift) for log in recordings]
    length = max(sum(part.rows.shape[1] for part in parts) / count, 2.0)
    pieces = [
        _DriftingRows(part.rows[:, start:stop], 0 if start else part.lost)
        for part in parts
        for start, stop in segment_cuts(part.rows.shape[1], length)
    ]
    found = [_compressed(model, [piece], noise=False) for piece in pieces]
    noise = _compressed(model, parts).noise
    if noise is None:
        return tuple(found)
    total = sum(sum(one.counts) for one in found)
    return tuple(
        replace(one, noise=noise.share(sum(one.counts) / total)) for one in found
    )


def _require_no_bias(model: TorqueModel, drift: Drift) -> None:
    if model.wrench_bias:
        raise ProblemError(
            f"drift is {drift!r}, so that each recording has a bias of its own, but "
            "the model has one for all; give tool_model(bias=False)"
        )


def _compressed(
    model: TorqueModel, parts: "Sequence[_DriftingRows]", *, noise: bool = True
) -> Regression:
    """Compress rows, shape (6, samples, parameters + 1) each."""
    of_rows = zip(*(part.rows for part in parts), strict=True)
    factors = tuple(triangle(np.asfortranarray(np.vstack(rows))) for rows in of_rows)
    peaks = np.stack([abs(part.rows[:, :, -1]).max(axis=1) for part in parts])
    count = sum(max(part.rows.shape[1] - part.lost, 1) for part in parts)
    counts = (count,) * len(factors)
    found = Regression(
        layout=model.layout,
        joints=model.torque_joints,
        factors=factors,
        counts=counts,
        fingerprint=model.fingerprint,
        peaks=peaks.max(axis=0),
    )
    if not noise:
        return found
    fit = joint_fit(factors, counts)
    return replace(found, noise=joined_noise([_noise(p.rows, fit) for p in parts]))


def bias_along(
    model: TorqueModel, x: Vector, recording: Recording, drift: Drift
) -> SensorBias:
    """Return the bias, and its rate, that a recording has beside a body.

    Parameters
    ----------
    model, drift
        See `driftless_regression`.
    x : ndarray, shape (parameters,)
        Parameters of the body.
    recording : Recording
        See `carried`.
    """
    plain = replace(model, wrench_bias=False)
    motion = motion_of(plain, recording, None)
    rest = motion.torque - motion.predicted(plain, x[: len(plain.layout)])
    found = np.array(
        [
            np.linalg.lstsq(N, own, rcond=None)[0]
            for N, own in zip(_drifts(motion, recording, drift), rest.T, strict=True)
        ]
    ).T
    rate = found[1] if drift == "linear" else np.zeros(rest.shape[1])
    return SensorBias(found[0], rate)


def _drifts(motion: Motion, recording: Recording, drift: Drift) -> list[Matrix]:
    """Return the columns of each row's bias and its rate, filtered like the rows.

    Time counts from the recording's first sample.
    """
    behind = recording.torque_filter
    clock = recording.time if behind is None else behind.source.time
    since = clock - recording.time[0]
    columns = [np.ones(len(since)), since]
    N = np.column_stack(columns if drift == "linear" else columns[:1])
    return [motion.through(N, row) for row in range(motion.torque.shape[1])]


class _DriftingRows(NamedTuple):
    """Rows of a recording, shape (6, samples, parameters + 1), and how many it lost."""

    rows: Array
    lost: int


def _rows_without_drift(
    model: TorqueModel, log: Recording, drift: Drift
) -> _DriftingRows:
    motion = motion_of(model, log, None)
    n = len(motion.q)
    rows = np.empty((len(model.torque_joints), n, len(model.layout) + 1))
    rows[:, :, :-1] = np.swapaxes(motion.regressor(model), 1, 2)
    rows[:, :, -1] = motion.torque.T
    lost = 2 if drift == "linear" else 1
    if n <= lost:
        raise NotExcitedError(
            f"{log.name} has {n} samples, and its bias takes {lost} of them; join "
            "short recordings, or take drift='none'"
        )
    for own, N in zip(rows, _drifts(motion, log, drift), strict=True):
        Q, _ = np.linalg.qr(N)
        own -= Q @ (Q.T @ own)
    return _DriftingRows(rows, lost)


def _noise(rows: Array, fit: JointFit) -> CorrelatedNoise:
    """Return the noise that a fit leaves along a recording."""
    found, parts = [], []
    for row, weight in zip(rows, fit.weights, strict=True):
        residual: Matrix = row[:, -1] - row[:, :-1] @ fit.x
        exact = np.linalg.norm(residual) <= _EXACT * np.linalg.norm(row[:, -1])
        found.append(
            white_noise(row[:, :-1], residual)
            if exact
            else spectral_noise(row[:, :-1], residual, fit.steps / weight)
        )
        parts.append(block_part(row[:, :-1] / weight, residual / weight))
    effective = np.array([rows.shape[1] / noise.length for noise in found])
    scores = tuple(noise.scores for noise in found)
    sums = BlockPart(*(np.sum(each, axis=0) for each in zip(*parts, strict=True)))
    freedom = np.array([noise.freedom for noise in found])
    return CorrelatedNoise(effective, scores, freedom, block_ratio(fit, sums, scores))


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

"""Preparation steps that need the robot, or a sensor that drifts."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial, reduce
from typing import Literal

import numpy as np

from consistent_id._support.arrays import Vector
from consistent_id.constraints import Constraint
from consistent_id.estimation.base_least_squares import weighted_least_squares
from consistent_id.estimation.radius_and_delay import (
    ContactRadius,
    RadiusAndDelay,
    TorqueDelay,
    estimate_radius_and_delay,
    with_radii,
    without_torque_delay,
)
from consistent_id.estimation.resting import rest_speed
from consistent_id.problems.file import PreparationTable, ProblemTable
from consistent_id.problems.preparation import rest_reach
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals import without_rests
from consistent_id.recordings.signals.drive_limits import SPEED_ROUNDING, within_speed
from consistent_id.recordings.signals.filtered_rows import altered
from consistent_id.regression.elastic_joints import as_rigid
from consistent_id.regression.regression import Regression, build_regression
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.residual_noise import NORMAL
from consistent_id.regression.rows.contact_free import contact_free_model
from consistent_id.regression.rows.contact_maps import without_slip
from consistent_id.regression.rows.wrench_sensor import (
    Drift,
    bias_along,
    carried,
    driftless_regression,
    driftless_segments,
)
from consistent_id.regression.segments import segment_regressions
from consistent_id.robot.model import RobotModel


@dataclass(frozen=True, slots=True, eq=False)
class SensorDrift:
    """The biases of a sensor, one for each recording, and the tool to find them.

    Parameters
    ----------
    model : TorqueModel
    drift : {"none", "recordings", "linear"}
    tool : ndarray, shape (parameters,)
        From the training recordings; none, where nothing drifts.
    """

    model: TorqueModel
    drift: Drift
    tool: Vector

    @staticmethod
    def of(
        table: ProblemTable,
        model: TorqueModel,
        training: Callable[[], Sequence[Recording]],
    ) -> "SensorDrift":
        """Fit the tool to recordings with unknown biases, if the bias drifts."""
        drift = drift_of(table)
        if drift == "none":
            return SensorDrift(model, drift, np.zeros(0))
        regression = driftless_regression(model, training(), drift)
        found = weighted_least_squares(model, regression)
        return SensorDrift(model, drift, found.parameters)

    def left_out(self, parts: Sequence[Recording]) -> tuple[Recording, ...]:
        """Return recordings without their bias, as they are predicted and compared."""
        if self.drift == "none":
            return tuple(parts)
        return tuple(self._without(part) for part in parts)

    def _without(self, log: Recording) -> Recording:
        bias = bias_along(self.model, self.tool, log, self.drift)

        def change(whole: Recording) -> Recording:
            shown = bias.start + np.outer(whole.time - log.time[0], bias.rate)
            (wrench,) = whole.wrenches
            values = wrench.values - shown
            return replace(whole, wrenches=(replace(wrench, values=values),))

        return altered(log, change)


def drift_of(table: ProblemTable) -> Drift:
    """Return the drift of the bias of a problem's wrench sensor."""
    return "none" if table.wrist_sensor is None else table.wrist_sensor.drift


def regression_of(
    table: ProblemTable, model: TorqueModel, recordings: Sequence[Recording]
) -> Regression:
    """Compress prepared recordings; information on each one's bias is left out.

    The bias is subtracted from the recordings, but it remains unknown.
    """
    drift = drift_of(table)
    if drift == "none":
        return build_regression(model, recordings)
    return driftless_regression(model, recordings, drift)


def segments_of_problem(
    table: ProblemTable, model: TorqueModel, recordings: Sequence[Recording]
) -> tuple[Regression, ...]:
    """Compress prepared recordings in segments, like `regression_of`."""
    drift = drift_of(table)
    if drift == "none":
        return segment_regressions(model, recordings)
    return driftless_segments(model, recordings, drift)


def with_robot(
    table: ProblemTable,
    robot: RobotModel,
    arm: RobotModel | None,
    compliance: Vector | None,
) -> Callable[[Recording], Recording] | None:
    """Return the steps for a part: speed, springs, the motion of a sensor, slip."""
    sensor = table.wrist_sensor
    slip = None if table.data is None else table.data.preparation.most_slip
    steps: list[Callable[[Recording], Recording]] = []
    if table.data is not None and (most := table.data.preparation.most_joint_speed):
        reach = rest_reach(table.data.preparation)
        steps.append(lambda log: not_too_fast(robot, log, most, reach))
    if compliance is not None:
        steps.append(lambda log: as_rigid(robot, log, compliance))
    if sensor is not None and arm is not None:
        steps.append(lambda log: carried(robot, arm, log, sensor.frame))
    elif slip is not None:
        steps.append(lambda log: without_slip(robot, log, slip))
    if not steps:
        return None
    return lambda log: reduce(lambda part, step: step(part), steps, log)


def not_too_fast(
    robot: RobotModel, log: Recording, most: float | Literal["model"], reach: float
) -> Recording:
    """Leave out the rows of joints beyond a speed, or beyond the model's limits."""
    if most != "model":
        return within_speed(log, most, reach=reach)
    limits = {joint.name: joint.limits.velocity for joint in robot.joints}
    of_joints = [SPEED_ROUNDING * limits.get(name, np.inf) for name in log.joints]
    return within_speed(log, of_joints, reach=reach)


@dataclass(frozen=True, slots=True, eq=False)
class FoundInTraining:
    """Values that the preparation estimates from the training data.

    Parameters
    ----------
    speed : float, [rad/s or m/s]
        Speed below which joints rest; zero if no row is left out, or if it is not
        required.
    reach : float, [s]
        See `without_rests`.
    drift : SensorDrift
        Biases of a wrench sensor.
    standing : RadiusAndDelay, optional
        The correction of the radius of round feet, and the delay of the torque.
    """

    speed: float
    reach: float
    drift: SensorDrift
    standing: RadiusAndDelay | None = None

    @property
    def feet(self) -> ContactRadius | None:
        """The correction of the radius of round feet, if it is estimated."""
        return None if self.standing is None else self.standing.feet

    @property
    def delay(self) -> TorqueDelay | None:
        """The delay of the torque, if it is estimated."""
        return None if self.standing is None else self.standing.delay

    @staticmethod
    def of(
        table: ProblemTable,
        model: TorqueModel,
        parts: Callable[[str], Sequence[Recording]],
        constraints: Sequence[Constraint],
    ) -> "FoundInTraining":
        """Estimate the values that the file requires; `parts` are recordings."""
        training = partial(parts, "training")
        how = PreparationTable() if table.data is None else table.data.preparation
        reach, drift = rest_reach(how), SensorDrift.of(table, model, training)
        found = FoundInTraining(0.0, reach, drift)
        if how.least_joint_speed == "estimated":
            rests = rest_speed(model, training(), constraints=constraints, reach=reach)
            found = replace(found, speed=rests.speed, reach=rests.reach)
        radius = how.contact_radius == "estimated"
        delay = how.delays.get("torque") == "estimated"
        if not radius and not delay:
            return found
        standing = estimate_radius_and_delay(
            contact_free_model(model),
            found.applied(training()),
            constraints=constraints,
            radius=radius,
            delay=delay,
        )
        return replace(found, standing=standing)

    def applied(self, parts: Sequence[Recording]) -> tuple[Recording, ...]:
        """Return recordings with feet as found, without drift and torque at rest."""
        if self.speed > 0.0:
            parts = [without_rests(p, self.speed, reach=self.reach) for p in parts]
        if self.standing is not None:
            parts = [self.standing.applied(p) for p in parts]
        return self.drift.left_out(parts)

    def varied(self, parts: Sequence[Recording]) -> list[list[Recording]]:
        """Return applied recordings once for each error of the values found.

        Errors are those of 95 % intervals, 1.96 of them either way.  If errors of
        radius and delay are correlated, the changes are combinations of them.
        """
        if self.standing is None:
            return []
        wide = self.standing.widened(NORMAL).changes()
        return [
            [without_torque_delay(with_radii(p, radius), late) for p in parts]
            for radius, late in wide
        ]

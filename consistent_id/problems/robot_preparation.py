"""What is done to prepared recordings that takes the robot, as a problem file asks."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial, reduce

from consistent_id._support.arrays import Vector
from consistent_id.constraints import Constraint
from consistent_id.estimation.contact_radius import (
    ContactRadius,
    contact_radius,
    with_radii,
)
from consistent_id.estimation.rest_speed import rest_speed
from consistent_id.problems.file import PreparationTable, ProblemTable
from consistent_id.problems.preparation import rest_reach
from consistent_id.problems.sensor_drift_preparation import SensorDrift
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals import without_rests
from consistent_id.regression.elastic_joints import as_rigid
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.rows.contact_free import contact_free_model
from consistent_id.regression.rows.slip import without_slip
from consistent_id.regression.rows.wrench_sensor import carried
from consistent_id.robot.model import RobotModel


def with_robot(
    table: ProblemTable,
    robot: RobotModel,
    arm: RobotModel | None,
    compliance: Vector | None,
) -> Callable[[Recording], Recording] | None:
    """Return what is done to a part: springs, a sensor that carries it, slip."""
    sensor = table.wrist_sensor
    slip = None if table.data is None else table.data.preparation.most_slip
    steps: list[Callable[[Recording], Recording]] = []
    if compliance is not None:
        steps.append(lambda log: as_rigid(robot, log, compliance))
    if sensor is not None and arm is not None:
        steps.append(lambda log: carried(robot, arm, log, sensor.frame))
    elif slip is not None:
        steps.append(lambda log: without_slip(robot, log, slip))
    if not steps:
        return None
    return lambda log: reduce(lambda part, step: step(part), steps, log)


@dataclass(frozen=True, slots=True, eq=False)
class FoundInTraining:
    """What preparation takes from the training data, as a problem file asks.

    Parameters
    ----------
    speed : float, [rad/s or m/s]
        Below which joints rest; zero if no row is left out, or if it was not asked for.
    reach : float, [s]
        See `without_rests`.
    drift : SensorDrift
        Biases of a wrench sensor.
    feet : ContactRadius, optional
        What is added to the radius of round feet.
    """

    speed: float
    reach: float
    drift: SensorDrift
    feet: ContactRadius | None = None

    @staticmethod
    def of(
        table: ProblemTable,
        model: TorqueModel,
        parts: Callable[[str], Sequence[Recording]],
        constraints: Sequence[Constraint],
    ) -> "FoundInTraining":
        """Find what the file asks for; `parts` are recordings of a role."""
        training = partial(parts, "training")
        how = PreparationTable() if table.data is None else table.data.preparation
        reach, drift = rest_reach(how), SensorDrift.of(table, model, training)
        found = FoundInTraining(0.0, reach, drift)
        if how.least_joint_speed == "estimated":
            rests = rest_speed(model, training(), constraints=constraints, reach=reach)
            found = replace(found, speed=rests.speed, reach=rests.reach)
        if how.contact_radius != "estimated":
            return found
        free = contact_free_model(model)
        feet = contact_radius(free, found.applied(training()), constraints=constraints)
        return replace(found, feet=feet)

    def applied(self, parts: Sequence[Recording]) -> tuple[Recording, ...]:
        """Return recordings with feet as found, without drift and torque at rest."""
        if self.speed > 0.0:
            parts = [without_rests(p, self.speed, reach=self.reach) for p in parts]
        if self.feet is not None:
            parts = [with_radii(p, self.feet.offset) for p in parts]
        return self.drift.left_out(parts)

    def varied(self, parts: Sequence[Recording]) -> list[list[Recording]]:
        """Return applied recordings once for each value found, changed by its error."""
        if self.feet is None:
            return []
        return [[with_radii(p, self.feet.standard_error) for p in parts]]

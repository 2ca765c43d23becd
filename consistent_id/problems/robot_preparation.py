"""What is done to prepared recordings that takes the robot, as a problem file asks."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import reduce

from consistent_id._support.arrays import Vector
from consistent_id.constraints import Constraint
from consistent_id.estimation.rest_speed import rest_speed
from consistent_id.problems.file import PreparationTable, ProblemTable
from consistent_id.problems.preparation import rest_reach
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals import without_rests
from consistent_id.regression.elastic_joints import as_rigid
from consistent_id.regression.regressor import TorqueModel
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


@dataclass(frozen=True, slots=True)
class EstimatedRests:
    """The speed below which joints rest, found in the training data.

    Parameters
    ----------
    speed : float, [rad/s or m/s]
        Zero if no row is left out, or if it was not asked for.
    reach : float, [s]
        See `without_rests`.
    """

    speed: float
    reach: float

    @staticmethod
    def of(
        table: PreparationTable,
        model: TorqueModel,
        training: Callable[[], Sequence[Recording]],
        constraints: Sequence[Constraint],
    ) -> "EstimatedRests":
        """Find it, if the table asks for it."""
        reach = rest_reach(table)
        if table.least_joint_speed != "estimated":
            return EstimatedRests(0.0, reach)
        found = rest_speed(model, training(), constraints=constraints, reach=reach)
        return EstimatedRests(found.speed, found.reach)

    def left_out(self, parts: Sequence[Recording]) -> tuple[Recording, ...]:
        """Return recordings in which torque of joints at rest is not known."""
        if self.speed == 0.0:
            return tuple(parts)
        return tuple(without_rests(p, self.speed, reach=self.reach) for p in parts)

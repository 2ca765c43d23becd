"""The ``[tasks]`` and ``[laboratory]`` tables of a problem file, turned into values."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from consistent_id._support.arrays import frozen
from consistent_id.errors import ProblemError
from consistent_id.laboratory.closed_loop import Controller, Encoders, with_friction
from consistent_id.laboratory.curves import (
    Curve,
    bulb,
    circle,
    ellipse,
    ellipsoid,
    helix,
    through_points,
)
from consistent_id.laboratory.experiment import Cameras, Laboratory, LoadCell
from consistent_id.laboratory.inverse_kinematics import TaskPath, follow
from consistent_id.laboratory.writing_tasks import Writer, WritingTask
from consistent_id.problems.problem import Problem
from consistent_id.problems.task_tables import (
    BulbTable,
    CircleTable,
    EllipseTable,
    HelixTable,
    LaboratoryTable,
    OutlineTable,
    PointsTable,
    SpiralTable,
    TaskTable,
)
from consistent_id.recordings.recording import Recording
from consistent_id.robot.parameters import require_known


def task_path(problem: Problem, name: str) -> TaskPath:
    """Return the joint motion of a writing task of the file.

    Raises
    ------
    ProblemError
        If there is no such task, or it is invalid.
    PathError
        If the robot cannot write it.
    """
    table = _task_table(problem, name)
    writer = Writer(
        problem.model.robot, table.frame, np.array(table.point), tuple(table.joints)
    )
    task = WritingTask(curve_of(table), table.duration, table.law)
    return follow(writer, task, start=table.start)


def task_motion(problem: Problem, name: str) -> Recording:
    """Return a writing task of the file, sampled at its rate."""
    return task_path(problem, name).recording(_task_table(problem, name).rate, name)


def curve_of(table: TaskTable) -> Curve:
    """Return the curve that a task's table describes."""
    if isinstance(table, PointsTable):
        return through_points(table.points, closed=table.closed)
    place = _placement(table)
    match table:
        case CircleTable():
            return circle(table.radius, **place)
        case EllipseTable():
            return ellipse((table.semi_axes[0], table.semi_axes[1]), **place)
        case BulbTable():
            a, b = table.semi_axes
            return bulb((a, b), taper=table.taper, **place)
        case SpiralTable():
            a, b, c = table.semi_axes
            latitude = float(np.radians(table.latitude_deg))
            return ellipsoid((a, b, c), latitude=latitude, **place)
        case HelixTable():
            return helix(table.radius, table.height, **place)


def laboratory_table(problem: Problem) -> LaboratoryTable:
    """Return a problem's laboratory; without one, that is an error."""
    if problem.table.laboratory is None:
        raise ProblemError(f"problem {problem.name!r} has no [laboratory] table")
    return problem.table.laboratory


def laboratory_of(problem: Problem, inertial: ArrayLike) -> Laboratory:
    """Return the laboratory of a problem, around a robot of known inertia.

    The controller's parameters are the robot's own, friction included, less the share
    that the file states.

    Parameters
    ----------
    inertial : array_like, shape (10 links,)
    """
    table = laboratory_table(problem)
    n = len(problem.model.robot)
    known = frozen(inertial, (10 * n,), "inertial parameters")
    friction = table.friction
    robot = with_friction(
        problem.model.robot,
        known,
        viscous=friction.viscous,
        coulomb=friction.coulomb,
        velocity_scale=friction.velocity_scale,
    )
    belief, cell, seen = table.controller, table.load_cell, table.cameras
    return Laboratory(
        robot=robot,
        controller=Controller(
            robot.model,
            (1.0 - belief.error) * robot.parameters,
            belief.bandwidth,
            belief.damping,
            belief.rate_cutoff,
        ),
        encoders=Encoders(np.array(table.encoders.step)),
        load_cell=LoadCell(np.array(cell.noise), np.array(cell.offset)),
        cameras=Cameras(
            seen.rate,
            seen.delay,
            seen.drift,
            np.array(seen.position_noise),
            np.array(seen.acceleration_noise),
        ),
        substeps=table.substeps,
    )


def _task_table(problem: Problem, name: str) -> TaskTable:
    require_known([name], problem.table.tasks, f"problem {problem.name!r}: no task")
    return problem.table.tasks[name]


def _placement(table: OutlineTable) -> dict[str, Any]:
    return {
        "centre": table.centre,
        "along": table.along,
        "across": table.across,
        "turns": table.turns,
    }

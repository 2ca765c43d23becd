"""What moves in a problem, and what is measured: joint torque or a sensor's wrench."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from consistent_id.problems.problem import Problem
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.rows.sensor_rows import SensorRows
from consistent_id.robot.frame_motion import frame_in_link
from consistent_id.robot.inertia import InertialParameters
from consistent_id.robot.model import RobotModel


class Moved(NamedTuple):
    """What moves, and what is measured of it.

    Attributes
    ----------
    torque : TorqueModel
        Of the joints.
    sensor : SensorRows, optional
        If it is a sensor's tool that is identified.
    parameters : array_like, optional
        With which torque is predicted; see `design_trajectory`.
    notes : tuple of str
    """

    torque: TorqueModel
    sensor: SensorRows | None
    parameters: ArrayLike | None
    notes: tuple[str, ...]


def what_moves(problem: Problem, parameters: ArrayLike | None = None) -> Moved:
    """Return the torque model and the sensor of a problem's motion.

    Parameters
    ----------
    problem : Problem
    parameters : array_like, shape (parameters,) or (members, parameters), optional
        Of the problem's model.  Those of a tool load the arm: of several the heaviest.
    """
    table = problem.table.wrist_sensor
    if table is None or problem.arm is None:
        return Moved(problem.model, None, parameters, ())
    # a bias that drifts is unknown in each recording, that of this motion included
    told = replace(problem.model, wrench_bias=table.bias)
    sensor = SensorRows(told, problem.arm, table.frame)
    tool = _tool(problem, parameters)
    if tool is None:
        name = problem.model.robot.link_names[0]
        note = (
            "torque limits: the arm's without its tool, of which nothing is known; "
            f"state [links.{name}] mass, or --parameters of an estimate"
        )
        return Moved(TorqueModel(problem.arm), sensor, None, (note,))
    note = f"torque limits: the arm carries {tool.mass:.3g} kg at {table.frame}"
    loaded = with_load(problem.arm, table.frame, tool)
    return Moved(TorqueModel(loaded), sensor, None, (note,))


def _tool(problem: Problem, parameters: ArrayLike | None) -> InertialParameters | None:
    """Return the tool of an estimate, or a point of the datasheet's largest mass."""
    if parameters is not None:
        every = np.atleast_2d(np.asarray(parameters, dtype=float))
        return InertialParameters(every[every[:, 0].argmax(), :10])
    sheet = problem.model.robot.links[0].datasheet
    mass = (sheet.mass_bounds or (0.0, None))[1] if sheet.mass is None else sheet.mass
    if mass is None or np.isinf(mass):
        return None
    com = np.zeros(3) if sheet.com is None else sheet.com
    return InertialParameters.from_central(mass, com, np.zeros((3, 3)))


def with_load(arm: RobotModel, frame: str, load: InertialParameters) -> RobotModel:
    """Return an arm one of whose links carries a load, given in a frame on it.

    Nothing changes where the link's own nominal body is not known.
    """
    k, rotation, translation = frame_in_link(arm, frame, (0.0, 0.0, 0.0))
    link = arm.links[k]
    if link.nominal is None:
        return arm
    both = link.nominal + load.transformed(rotation, translation)
    links = list(arm.links)
    links[k] = replace(link, nominal=both)
    return replace(arm, links=tuple(links))

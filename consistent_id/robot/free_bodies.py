"""Bodies whose connections are not known, as a robot without any."""

from collections.abc import Mapping

import numpy as np

from consistent_id.robot.inertia import InertialParameters
from consistent_id.robot.model import Datasheet, Joint, Link, RobotModel


def free_bodies(
    name: str, bodies: Mapping[str, InertialParameters | None]
) -> RobotModel:
    """Return a robot of bodies that are not connected, for a regressor that is given.

    Each body is a link with ten parameters in a frame of its own.

    Parameters
    ----------
    name : str
    bodies : mapping of str to InertialParameters or None
        Nominal parameters by link, where they are known.

    Examples
    --------
    >>> pair = free_bodies("pair", {"upper": None, "lower": None})
    >>> pair.link_names, len(pair), pair.connected
    (('upper', 'lower'), 0, False)
    """
    joints = tuple(
        Joint(f"{link}_free", "free", -1, np.eye(3), np.zeros(3), np.eye(3)[2])
        for link in bodies
    )
    links = tuple(
        Link(link, nominal, Datasheet() if nominal is None else _sheet(nominal))
        for link, nominal in bodies.items()
    )
    return RobotModel(name, joints, links)


def _sheet(nominal: InertialParameters) -> Datasheet:
    if nominal.mass <= 0.0:
        return Datasheet()
    return Datasheet(mass=nominal.mass, com=nominal.com)

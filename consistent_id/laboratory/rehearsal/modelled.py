"""What a rehearsal makes of a problem's torque model, its interest and its estimates.

Rehearsed robots have rigid bodies, viscous and Coulomb friction and rotors, whatever
the problem's ``[drive]`` says.  What else it has is left out, and named.
"""

from dataclasses import dataclass, replace

import numpy as np

from consistent_id._support.arrays import Matrix
from consistent_id.errors import ProblemError
from consistent_id.excitation.interest import is_named, parameters_named
from consistent_id.laboratory.rehearsal.planted import DRIVE
from consistent_id.regression.regressor import TorqueModel
from consistent_id.robot.inertia import InertialParameters
from consistent_id.robot.model import RobotModel


@dataclass(frozen=True, slots=True, eq=False)
class Rehearsed:
    """A problem's torque model as rehearsed robots have it.

    Parameters
    ----------
    model : TorqueModel
        Its robot is that of the first estimate, if there is one.
    parameters : ndarray, shape (members, parameters), optional
        Of the estimates, by which torque limits are kept.
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

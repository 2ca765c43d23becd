"""A load that the model does not have: a last link of which nothing is known.

Its mass is that of the model or more, its other nine parameters are free, and what is
known of the other links stays.  Other masses of all links explain such a log as well:
the load is the answer that changes less.
"""

from collections.abc import Iterator, Sequence

from consistent_id.constraints import (
    Constraint,
    FixedBodies,
    FixedCentresOfMass,
    FixedMasses,
    MassBounds,
)
from consistent_id.diagnosis.corrections import Cause
from consistent_id.diagnosis.explain import LOAD, Candidate, FittedLog
from consistent_id.diagnosis.model_faults import placeholders
from consistent_id.robot.model import Link, RobotModel

_THRESHOLD = 1.3  # ratio of misfits, as in the table of corrections
_HEAVIEST = 1e4  # kg: no robot carries more
_ADVICE = (
    "add the load or tool of {link} to the model, or remove it from the robot; "
    "identify_payload finds its ten parameters from logs with it and without it; if "
    'the masses of the model are made up, masses = "free" (--masses free)'
)


def other_loads(as_is: FittedLog) -> Iterator[Candidate]:
    """Yield the log with a last link of which nothing is known, for each last link.

    Of a model with placeholders nothing is known but that they are wrong.
    """
    robot = as_is.factors.model.robot
    if placeholders(robot):
        return
    for link in last_links(robot):
        free = without_link(as_is.constraints, robot, link.name)
        if free is None:
            continue
        if link.datasheet.mass is not None:
            free.append(MassBounds({link.name: (link.datasheet.mass, _HEAVIEST)}))
        cause = Cause(
            LOAD,
            link.name,
            f"with another load at {link.name} than the model's",
            _ADVICE.format(link=link.name),
            _THRESHOLD,
            excuse=1,
        )
        yield Candidate(cause, as_is.factors, free)


def last_links(robot: RobotModel) -> list[Link]:
    """Return the links that carry no other, and that a joint moves."""
    carrying = {joint.parent for joint in robot.joints}
    return [link for k, link in enumerate(robot.links) if k not in carrying]


def without_link(
    constraints: Sequence[Constraint], robot: RobotModel, link: str
) -> list[Constraint] | None:
    """Return constraints that know nothing of a link; None if they knew nothing."""
    found: list[Constraint] = []
    for constraint in constraints:
        others = _without(constraint, robot, link)
        found += [] if others is None else [others]
    return None if found == list(constraints) else found


def _without(constraint: Constraint, robot: RobotModel, link: str) -> Constraint | None:
    """Return a constraint without what it knows of a link; None if nothing is left."""
    if isinstance(constraint, FixedMasses):
        sheet = {each.name: each.datasheet.mass for each in robot.links}
        masses = sheet if constraint.masses is None else constraint.masses
        known = {k: m for k, m in masses.items() if m is not None and k != link}
        unchanged = constraint.masses is not None and link not in constraint.masses
        return constraint if unchanged else (FixedMasses(known) if known else None)
    if isinstance(constraint, FixedCentresOfMass):
        places = {each.name: each.datasheet.com for each in robot.links}
        centres = places if constraint.centres is None else constraint.centres
        left = {k: list(c) for k, c in centres.items() if c is not None and k != link}
        unchanged = constraint.centres is not None and link not in constraint.centres
        return constraint if unchanged else (FixedCentresOfMass(left) if left else None)
    if isinstance(constraint, FixedBodies):
        bodies = tuple(n for n in constraint.links or robot.link_names if n != link)
        unchanged = bool(constraint.links) and link not in constraint.links
        return constraint if unchanged else (FixedBodies(bodies) if bodies else None)
    return constraint

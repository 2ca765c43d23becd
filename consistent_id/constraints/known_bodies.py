"""Bodies known exactly, and motors of one type."""

from collections.abc import Sequence
from dataclasses import dataclass

from consistent_id.constraints.cones.sets import ConicSet
from consistent_id.constraints.rows import equalities, fixed_values, unit_row
from consistent_id.errors import ProblemError
from consistent_id.regression.regressor import TorqueModel
from consistent_id.robot.inertia import INERTIAL_NAMES
from consistent_id.robot.parameters import did_you_mean


@dataclass(frozen=True, slots=True)
class FixedBodies:
    """Bodies as the robot's file has them.

    Parameters
    ----------
    links : sequence of str
        By default all; the data then determine the drives alone.
    """

    links: Sequence[str] = ()

    def lower(self, model: TorqueModel) -> ConicSet:
        """Return ten equalities per link.

        Raises
        ------
        ProblemError
            If a link's nominal parameters are unknown.
        """
        robot = model.robot
        for name in self.links:
            if name not in robot.link_names:
                near = did_you_mean(name, robot.link_names)
                raise ProblemError(f"known bodies: no link {name!r}; {near}")
        wanted = [n for n in robot.link_names if not self.links or n in self.links]
        bodies = {link.name: link.nominal for link in robot.links}
        values: dict[str, float] = {}
        for name in wanted:
            body = bodies[name]
            if body is None:
                raise ProblemError(
                    f"the body of {name!r} is to be as in the file of {robot.name!r}, "
                    "which states no inertia of it; identify it (bodies, known_links)"
                )
            keys = (f"{name}.{entry}" for entry in INERTIAL_NAMES)
            values |= dict(zip(keys, body.vector.tolist(), strict=True))
        return fixed_values(values, model.layout)


@dataclass(frozen=True, slots=True)
class EqualMotors:
    """Joints whose motors and gears are of one type: terms of equal value.

    Parameters
    ----------
    joints : sequence of str
        Two or more.
    terms : sequence of str
        Coefficients that are equal; friction of equal drives usually is not.
    """

    joints: Sequence[str]
    terms: Sequence[str] = ("rotor_inertia",)

    def lower(self, model: TorqueModel) -> ConicSet:
        """Return one equality for each term and joint after the first.

        Raises
        ------
        ProblemError
            If there are fewer than two joints, or a joint lacks a term.
        """
        joints = tuple(self.joints)
        if len(set(joints)) != len(joints) or len(joints) < 2:
            raise ProblemError(
                f"equal motors of {joints}: expected two or more distinct joints"
            )
        rows, labels = [], []
        for term in self.terms:
            names = [f"{joint}.{term}" for joint in joints]
            for joint, name in zip(joints, names, strict=True):
                if (joint, term) not in model.layout.drive:
                    having = sorted(j for j, t in model.layout.drive if t == term)
                    raise ProblemError(
                        f"equal motors: {joint!r} has no drive term {term}; "
                        f"{did_you_mean(joint, having)}"
                    )
                if name != names[0]:
                    first = unit_row(model.layout, names[0])
                    rows.append(unit_row(model.layout, name) - first)
                    labels.append(f"{name} = {names[0]}")
        return equalities(rows, [0.0] * len(rows), labels, model)

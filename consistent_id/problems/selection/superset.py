"""All drive terms and couplings that a model may have, and their joints.

Load friction needs a known load, a slope of friction needs limits of the joint, and a
coupling needs two neighbouring joints of one kind.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import msgspec
import numpy as np

from consistent_id.problems.file import CouplingTable, DriveTable
from consistent_id.problems.selection.choice import stribeck_velocities
from consistent_id.problems.selection.samples import Samples
from consistent_id.problems.stated_model import coupling_of
from consistent_id.regression.drive.gear_coupling import GearCoupling
from consistent_id.regression.drive.term import DriveTerm
from consistent_id.regression.loads import unloaded_joints
from consistent_id.regression.regressor import TorqueModel

LEAST_LOAD = 0.05
"""Least share of the load in a joint's torque for load friction.  Gears lose 3 to 20 %
of the load; with a smaller load that is below 1 % of the torque.
"""


@dataclass(frozen=True, slots=True, eq=False)
class Superset:
    """Drive terms of each joint of the robot, and couplings of neighbours."""

    terms: tuple[tuple[DriveTerm, ...], ...]
    couplings: tuple[GearCoupling, ...]


@dataclass(frozen=True, slots=True)
class KeptLaws:
    """Drives of the robot's joints, and couplings, that a problem file states."""

    drive: tuple[DriveTable, ...] = ()
    couplings: tuple[CouplingTable, ...] = ()


NOTHING = KeptLaws()


def superset(
    bodies: TorqueModel,
    widths: Sequence[float],
    loaded: tuple[str, ...],
    sloped: tuple[str, ...],
    fading: tuple[float, ...] = (),
    stated: KeptLaws = NOTHING,
) -> Superset:
    """Return all terms that joints with torque may have.

    Parameters
    ----------
    bodies : TorqueModel
        The model without drive terms.
    widths : sequence of float, [rad/s or m/s]
        Width of friction's change of sign of each of the robot's joints.
    loaded, sloped : tuple of str
        See `loaded_joints` and `sloped_joints`.
    fading : tuple of float, [rad/s or m/s]
        Stribeck velocities besides those of `stribeck_velocities`.
    stated : KeptLaws
    """
    terms: list[tuple[DriveTerm, ...]] = []
    names = bodies.robot.joint_names
    for j, (name, width) in enumerate(zip(names, widths, strict=True)):
        tables = list[DriveTable]()
        if name in bodies.torque_joints:
            law = DriveTable(coulomb="tanh", velocity_scale=width)
            if stated.drive and stated.drive[j].coulomb == "sign":
                law = DriveTable(coulomb="sign")
            speeds = dict.fromkeys([*fading, *stribeck_velocities(width)])
            tables += _drive_tables(law, name in loaded, name in sloped, speeds)
            for own in stated.drive[j : j + 1]:
                scale = law.velocity_scale
                tables.append(msgspec.structs.replace(own, velocity_scale=scale))
        every = (term for table in tables for term in table.terms.terms)
        terms.append(tuple(dict.fromkeys(every)))
    pairs = [*couplings_between(bodies, widths), *stated.couplings]
    couplings = dict.fromkeys(coupling_of(pair) for pair in pairs)
    return Superset(tuple(terms), tuple(couplings))


def _drive_tables(
    law: DriveTable, loaded: bool, sloped: bool, fading: Iterable[float]
) -> tuple[DriveTable, ...]:
    """Return drive tables that together have every term that a joint may have.

    Parameters
    ----------
    law : DriveTable
        Dry friction.
    """
    whole = msgspec.structs.replace(
        law,
        viscous=True,
        offset=True,
        rotor_inertia=True,
        spring=True,
        drag=True,
        load_friction=loaded,
        friction_slope=sloped,
    )
    change = msgspec.structs.replace
    return (
        whole,
        change(whole, asymmetric=True, offset=False, friction_slope=False),
        *(change(whole, stribeck_velocity=v) for v in fading),
    )


def sloped_joints(bodies: TorqueModel) -> tuple[str, ...]:
    """Return the torque joints with limits, between which friction can have a slope."""
    limited = {
        joint.name: joint.kind != "continuous"
        and bool(np.isfinite([joint.limits.lower, joint.limits.upper]).all())
        for joint in bodies.robot.driven
    }
    return tuple(name for name in bodies.torque_joints if limited[name])


def couplings_between(
    bodies: TorqueModel, widths: Sequence[float]
) -> tuple[CouplingTable, ...]:
    """Return the couplings that drives of neighbouring joints may have."""
    own = dict(zip(bodies.robot.joint_names, widths, strict=True))
    kinds = {joint.name: joint.kind == "prismatic" for joint in bodies.robot.driven}
    return tuple(
        CouplingTable(
            first=first,
            second=second,
            viscous=True,
            coulomb="tanh",
            velocity_scale=own[first],
            rotor_inertia=True,
        )
        for first, second in pairwise(bodies.torque_joints)
        if kinds[first] == kinds[second]
    )


def loaded_joints(bodies: TorqueModel, samples: Samples) -> tuple[str, ...]:
    """Return the torque joints whose nominal load is a large part of their torque.

    Parameters
    ----------
    bodies : TorqueModel
        The model without drive terms.
    samples : Samples
        Rows of the log.
    """
    nominal = bodies.robot.nominal
    if nominal is None:
        return ()
    idle = unloaded_joints(bodies.robot, nominal)
    found = []
    for row, name in enumerate(bodies.torque_joints):
        load = np.linalg.norm(nominal @ samples.inertial[row])
        torque = np.linalg.norm(samples.torque[:, row])
        if name not in idle and load >= LEAST_LOAD * torque:
            found.append(name)
    return tuple(found)

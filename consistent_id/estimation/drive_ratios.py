"""Estimated friction and rotor inertia over those of the robot's file.

A wrong clock scales all rotor inertias, a wrong gain all drives alike.  What a file
says of drives is worth little: of a Unitree Z1, clean estimates are 0.4 to 1.3 times
its rotor inertias and 0.6 to 1.3 times its friction.  So only a large common factor
counts.  Values that are alike for all joints are placeholders, and do not count at all.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from consistent_id._support.arrays import Vector, freeze_arrays
from consistent_id.estimation.verdict import Reason
from consistent_id.regression.regressor import TorqueModel
from consistent_id.robot.drawn_parts import DrawnDrive, DrawnParts

FRICTION_CARE = 2.0
"""Common factor of friction from which on it counts: oil, load and wear change it."""

ROTOR_CARE = 3.0
"""Common factor of rotor inertia: a clock at half speed makes it four."""

_SURE = 3.0  # standard errors of the mean, from the scatter between joints
_JOINTS = 3  # fewer show no scatter
_USUAL = 0.25  # share of the speed limit at which friction is compared
_SPEED = 0.5  # rad/s or m/s, where no limit is known
_PLAIN = {"viscous", "coulomb", "offset", "rotor_inertia"}


@dataclass(frozen=True, slots=True, eq=False)
class DriveRatios:
    """Estimates over nominal values; NaN where either is not known.

    Parameters
    ----------
    joints : tuple of str
    friction : array_like, shape (joints,)
        At a quarter of the speed limit; of joints whose friction is viscous and dry.
    rotors : array_like, shape (joints,)
    """

    joints: tuple[str, ...]
    friction: Vector
    rotors: Vector

    def __post_init__(self) -> None:
        shape = (len(self.joints),)
        shapes = {"friction": shape, "rotors": shape}
        freeze_arrays(self, shapes, "drive ratios", finite=False)


def drive_ratios(model: TorqueModel, x: Vector, drawn: DrawnParts) -> DriveRatios:
    """Compare drives of a parameter vector with those of the robot's file.

    Parameters
    ----------
    x : ndarray, shape (parameters,)
    """
    found = [_ratios(model, x, joint.name, drawn) for joint in model.robot.joints]
    names = tuple(joint.name for joint in model.robot.joints)
    return DriveRatios(names, *np.array(found).reshape(-1, 2).T)


def _ratios(
    model: TorqueModel, x: Vector, name: str, drawn: DrawnParts
) -> tuple[float, float]:
    own = [n for n in model.layout.names if n.startswith(f"{name}.")]
    terms = {n.removeprefix(f"{name}."): float(x[model.layout.index(n)]) for n in own}
    drive = drawn.drives.get(name, DrawnDrive())
    limits = {joint.name: joint.limits.velocity for joint in model.robot.joints}
    speed = _USUAL * limits[name] if np.isfinite(limits[name]) else _SPEED
    friction = rotor = np.nan
    plain = {"viscous", "coulomb"} <= set(terms) and set(terms) <= _PLAIN
    nominal = drive.viscous * speed + drive.coulomb
    if drawn.friction_known and plain and nominal > 0.0:
        friction = (terms["viscous"] * speed + terms["coulomb"]) / nominal
    if drawn.rotors_known and "rotor_inertia" in terms and drive.rotor_inertia > 0.0:
        rotor = terms["rotor_inertia"] / drive.rotor_inertia
    return friction, rotor


def drive_reasons(ratios: DriveRatios) -> Iterator[Reason]:
    """Doubt estimates whose drives are all too large, or all too small."""
    for what, values, care in (
        ("friction", ratios.friction, FRICTION_CARE),
        ("rotor inertia", ratios.rotors, ROTOR_CARE),
    ):
        logs = np.log(values[np.isfinite(values) & (values > 0.0)])
        if len(logs) < _JOINTS:
            continue
        mean = float(np.mean(logs))
        error = float(np.std(logs, ddof=1) / np.sqrt(len(logs)))
        if abs(mean) > np.log(care) and abs(mean) > _SURE * error:
            factor, spread = np.exp(mean), np.exp(error)
            yield Reason(
                "nominal drives",
                "use with care",
                f"{what} of {len(logs)} joints is {factor:.2g} times that of the "
                f"robot's file (standard error: a factor of {spread:.2g})",
                "check the unit of time, and the gain of torque, or correct the file",
            )

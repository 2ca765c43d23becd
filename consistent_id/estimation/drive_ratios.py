"""Estimated friction and rotor inertia over those of the robot's file.

A wrong clock scales all rotor inertias, a wrong gain all drives alike.  A file's drives
are uncertain: for a Unitree Z1, clean estimates are 0.4 to 1.3 times its rotor inertias
and 0.6 to 1.3 times its friction.  So only a large common factor is reported.  Values
that are equal for all joints, or round, such as 10 or 0.5, are placeholders and are
ignored.  Values that the data do not determine, or that lie on a bound, are not
compared: the inertias of a first joint's rotor and link are one sum, whose parts come
from the prior.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from consistent_id._support.arrays import Vector, freeze_arrays
from consistent_id.constraints.parameter_constraints import ParameterBounds
from consistent_id.estimation.verdict import Reason
from consistent_id.recordings.recording import Recording, velocities
from consistent_id.regression.regressor import TorqueModel
from consistent_id.robot.parameters import ParameterLayout
from consistent_id.robot.solids import DrawnDrive, DrawnParts

FRICTION_CARE = 2.0
"""Least common factor of friction that is reported: oil, load and wear change it."""

ROTOR_CARE = 3.0
"""Common factor of rotor inertia: a clock at half speed makes it four."""

_SURE = 3.0  # standard errors of the mean, from the scatter between joints
_CLEAR = 3.0  # standard errors of a value, at least, that the data determine
_JOINTS = 3  # fewer show no scatter
_NOTHING = 1e-4  # ratio at or below which a drive has none, as on the bound at zero
_ON_BOUND = 1e-4  # of a bound, within which a value lies on it
_PLAIN = {"viscous", "coulomb", "offset", "rotor_inertia"}


@dataclass(frozen=True, slots=True, eq=False)
class DriveRatios:
    """Estimates over nominal values; NaN where one is not known or not determined.

    Parameters
    ----------
    joints : tuple of str
    friction : array_like, shape (joints,)
        Friction at the speed of the log, for joints with viscous and dry friction.
    rotors : array_like, shape (joints,)
    fault : str
        Why the robot's file cannot be read; see `DrawnParts`.
    """

    joints: tuple[str, ...]
    friction: Vector
    rotors: Vector
    fault: str = ""

    def __post_init__(self) -> None:
        shape = (len(self.joints),)
        shapes = {"friction": shape, "rotors": shape}
        freeze_arrays(self, shapes, "drive ratios", finite=False)


def log_speeds(recordings: Sequence[Recording]) -> dict[str, float]:
    """Return the RMS speed of each joint in all recordings, [rad/s or m/s]."""
    squares: dict[str, list[Vector]] = {}
    for log in recordings:
        for name, speed in zip(log.joints, velocities(log).T, strict=True):
            squares.setdefault(name, []).append(speed**2)
    return {
        name: float(np.sqrt(np.mean(np.concatenate(each))))
        for name, each in squares.items()
    }


def errors_off_bounds(
    layout: ParameterLayout,
    x: Vector,
    errors: Vector | None,
    constraints: Sequence[object],
) -> Vector | None:
    """Return standard errors, NaN for values on a bound, which is their only source.

    Parameters
    ----------
    x : ndarray, shape (parameters,)
    errors : ndarray, shape (parameters,), optional
        See `Estimate.parameter_errors`.
    constraints : sequence of Constraint
        Those of the estimate; only `ParameterBounds` are used.  A bound of zero is
        none: a drive on it is no drive.
    """
    if errors is None:
        return None
    known = errors.copy()
    for bounds in constraints:
        if isinstance(bounds, ParameterBounds):
            for name, limits in bounds.bounds.items():
                i = layout.index(name)
                finite = [at for at in limits if np.isfinite(at) and at != 0.0]
                if any(abs(x[i] - at) <= _ON_BOUND * abs(at) for at in finite):
                    known[i] = np.nan
    return known


def drive_ratios(
    model: TorqueModel,
    x: Vector,
    errors: Vector | None,
    drawn: DrawnParts,
    speeds: Mapping[str, float],
) -> DriveRatios:
    """Compare drives of a parameter vector with those of the robot's file.

    Parameters
    ----------
    x : ndarray, shape (parameters,)
    errors : ndarray, shape (parameters,), optional
        Standard errors, NaN where the data do not determine a parameter; without them
        nothing is compared.  See `errors_off_bounds`.
    speeds : mapping of str to float, [rad/s or m/s]
        Speed of each joint at which friction is compared; see `log_speeds`.
    """
    known = np.full(len(x), np.nan) if errors is None else errors
    values = {
        n: (float(x[i]), float(known[i])) for i, n in enumerate(model.layout.names)
    }
    found = [
        _ratios(values, joint.name, drawn, speeds.get(joint.name, np.nan))
        for joint in model.robot.joints
    ]
    names = tuple(joint.name for joint in model.robot.joints)
    friction, rotors = np.array(found).reshape(-1, 2).T
    return DriveRatios(names, friction, rotors, drawn.fault)


def _ratios(
    values: Mapping[str, tuple[float, float]],
    name: str,
    drawn: DrawnParts,
    speed: float,
) -> tuple[float, float]:
    """Return the ratios of friction and rotor inertia of one joint.

    Parameters
    ----------
    values : mapping of str to (float, float)
        Value and standard error of each parameter.
    """
    own = [n for n in values if n.startswith(f"{name}.")]
    terms = {n.removeprefix(f"{name}."): values[n] for n in own}
    drive = drawn.drives.get(name, DrawnDrive())
    friction = rotor = np.nan
    plain = {"viscous", "coulomb"} <= set(terms) and set(terms) <= _PLAIN
    if drawn.friction_known and plain:
        (viscous, of_viscous), (coulomb, of_coulomb) = (
            terms["viscous"],
            terms["coulomb"],
        )
        # The errors of both may add up: their correlation is ignored.
        friction = _ratio(
            viscous * speed + coulomb,
            of_viscous * speed + of_coulomb,
            drive.viscous * speed + drive.coulomb,
        )
    if drawn.rotors_known and "rotor_inertia" in terms:
        rotor = _ratio(*terms["rotor_inertia"], drive.rotor_inertia)
    return friction, rotor


def _ratio(value: float, error: float, nominal: float) -> float:
    """Return a value over the nominal one; NaN where the data do not determine it.

    A value of zero or less is returned whatever its error is.
    """
    if not (nominal > 0.0 and np.isfinite(error)):
        return np.nan
    ratio = value / nominal
    return ratio if ratio <= _NOTHING or value >= _CLEAR * error else np.nan


def drive_reasons(ratios: DriveRatios) -> Iterator[Reason]:
    """Return a reason to doubt drives that are all too large, or all too small.

    If a joint has none, or less, the joints do not agree.
    """
    if ratios.fault:
        yield Reason(
            "nominal drives",
            "use",
            "shapes of links and nominal drives were not compared, since the robot's "
            f"file cannot be read: {ratios.fault}",
        )
    for what, values, care in (
        ("friction", ratios.friction, FRICTION_CARE),
        ("rotor inertia", ratios.rotors, ROTOR_CARE),
    ):
        compared = values[np.isfinite(values)]
        if len(compared) < _JOINTS or compared.min() <= _NOTHING:
            continue
        logs = np.log(compared)
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

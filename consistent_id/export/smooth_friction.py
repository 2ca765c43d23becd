"""Friction for compensation: smooth at rest, and never more than was identified."""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from consistent_id._support.arrays import Vector
from consistent_id.errors import ProblemError
from consistent_id.regression.drive.drive_terms import DriveTerms
from consistent_id.regression.drive.laws import AsymmetricCoulomb, Coulomb, Offset
from consistent_id.regression.drive.term import DriveTerm
from consistent_id.regression.regressor import TorqueModel

FRICTION_VELOCITY = 0.05
"""Velocity [rad/s or m/s] at which compensated dry friction has 0.76 of its level.

Above what filtered encoders show of a joint at rest, and below the speeds of work.
"""


class SmoothFriction(NamedTuple):
    """A model with smooth friction, and the parameters that it is used with.

    Parameters
    ----------
    model : TorqueModel
        With the same columns, but those of `AsymmetricCoulomb`, which become a
        symmetric level and an offset.
    left_out : tuple of str
        Parameters of friction laws that are not smooth and have no stand-in: they count
        as zero, so this friction is not compensated.
    names : tuple of str
        Of the parameters of the model that was identified.
    """

    model: TorqueModel
    left_out: tuple[str, ...]
    names: tuple[str, ...]

    def parameters(self, x: Vector) -> Vector:
        """Return parameters without those that are left out."""
        given = dict(zip(self.names, np.asarray(x).tolist(), strict=True))
        for name in self.names:
            joint, _, term = name.rpartition(".")
            if term == "coulomb_positive":
                levels = given[name], given[f"{joint}.coulomb_negative"]
                given[f"{joint}.coulomb"] = 0.5 * (levels[0] + levels[1])
                given[f"{joint}.offset"] = 0.5 * (levels[0] - levels[1])
        names = self.model.layout.names
        return np.array(
            [0.0 if name in self.left_out else given[name] for name in names]
        )


def with_smooth_friction(
    model: TorqueModel, velocity: float | Sequence[float] = FRICTION_VELOCITY
) -> SmoothFriction:
    """Return a model whose dry friction changes its sign over a width of velocities.

    The direction of motion becomes ``tanh(dq / w)``, ``w`` the larger of `velocity` and
    the term's own scale.  ``|tanh(dq / w)|`` is at most the size of the identified
    direction, and has its sign: compensation that is computed with this model takes
    from dry friction less than there is, at every velocity, and nothing at rest. So it
    cannot drive a joint that has the identified friction.  Where its level differs by
    direction, dry friction balances any torque between the two levels at rest: their
    middle is an offset of the joint.

    Parameters
    ----------
    model : TorqueModel
    velocity : float or sequence of float, [rad/s or m/s]
        For all joints, or one for each.

    Raises
    ------
    ProblemError
        If velocities are not positive, or not one or one for each joint.

    Examples
    --------
    >>> from consistent_id import DHRow, DriveTerms, from_modified_dh
    >>> robot = from_modified_dh("arm", [DHRow(0, 0)])
    >>> model = TorqueModel(robot, DriveTerms(viscous=True, coulomb="sign"))
    >>> with_smooth_friction(model, 0.1).model.terms[0].velocity_scale
    0.1
    """
    widths = _widths(velocity, len(model.robot))
    drive = tuple(
        DriveTerms(terms=[_smooth(term, width) for term in _about_middle(terms)])
        for terms, width in zip(model.terms, widths.tolist(), strict=True)
    )
    couplings = tuple(
        coupling
        if coupling.coulomb == "none"
        else replace(
            coupling,
            coulomb="tanh",
            velocity_scale=max(
                coupling.velocity_scale or 0.0, *widths[list(places)].tolist()
            ),
        )
        for coupling, places in zip(model.couplings, model.coupled, strict=True)
    )
    left_out = [
        name
        for name, term in zip(
            model.layout.names[model.layout.inertial_size :],
            model.column_terms,
            strict=False,  # biases of a sensor follow
        )
        if _is_rough(term)
    ]
    smooth = replace(model, drive=drive, couplings=couplings)
    return SmoothFriction(smooth, tuple(left_out), model.layout.names)


def _about_middle(terms: DriveTerms) -> tuple[DriveTerm, ...]:
    """Return terms with one level and an offset in place of two levels."""
    found: list[DriveTerm] = []
    for term in terms.terms:
        if isinstance(term, AsymmetricCoulomb):
            found += [Coulomb(term.velocity_scale), Offset()]
        else:
            found.append(term)
    return tuple(found)


def _is_rough(term: DriveTerm) -> bool:
    """Return whether a friction law is not smooth at rest, and has no stand-in."""
    if not term.friction or term.smooth or "velocity_scale" in term.shape_parameters:
        return False
    return type(term).smoothed is DriveTerm.smoothed


def _smooth(term: DriveTerm, width: float) -> DriveTerm:
    """Return a term that is smooth at rest."""
    if "velocity_scale" not in term.shape_parameters:
        return term if _is_rough(term) or not term.friction else term.smoothed(width)
    scale = max(term.shapes.get("velocity_scale", 0.0), width)
    changed: DriveTerm = replace(term, velocity_scale=scale)  # type: ignore[type-var]
    return changed


def _widths(velocity: float | Sequence[float], joints: int) -> Vector:
    try:
        widths = np.atleast_1d(np.asarray(velocity, dtype=np.float64))
    except (TypeError, ValueError):
        widths = np.full(1, np.nan)
    sound = bool(np.isfinite(widths).all() and (widths > 0.0).all())
    if widths.ndim != 1 or len(widths) not in (1, joints) or not sound:
        raise ProblemError(
            f"the friction velocity is {velocity}, expected one positive number or "
            f"{joints}, such as {FRICTION_VELOCITY:g} [rad/s or m/s]"
        )
    return np.broadcast_to(widths, (joints,))

"""What an estimate that follows assumes: noise, typical sizes, anchor, constraints."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from consistent_id._support.arrays import Vector
from consistent_id.constraints import Constraint, lowered
from consistent_id.constraints.cones.sets import ConicSet, SemidefiniteBlock
from consistent_id.estimation.constrained_fit import DEFAULT_CONSTRAINTS
from consistent_id.estimation.estimate import Estimate
from consistent_id.estimation.torque_error import holding
from consistent_id.robot.inertia import PSEUDO_INERTIA_BASIS, pseudo_inertia
from consistent_id.robot.scaling import link_scales
from consistent_id.service.warm_fit import ConeCoordinates, cone_coordinates

ARM = 0.2
"""Typical distance of a load's centre of mass from its link's frame, [m]."""

_LEAST_DRIVE = 0.1  # of the largest of its kind: typical size of a drive's parameter


class LoadPlace(NamedTuple):
    """The number of the link that carries loads, and the mass of the largest [kg]."""

    link: int
    capacity: float


@dataclass(frozen=True, slots=True, eq=False)
class Regime:
    """What is assumed of the robot, with a load or without it.

    Parameters
    ----------
    cone : ConeCoordinates
    anchor : ndarray, shape (parameters,)
        Inverse widths of parameters about the start.
    """

    cone: ConeCoordinates
    anchor: Vector


def noise_of(estimate: Estimate) -> Vector:
    """Return each joint's noise, times the root of how much samples are alike."""
    fit = estimate.fit
    alike = 1.0 if fit is None or np.isnan(fit.correlation) else fit.correlation
    return np.asarray(estimate.sigma * np.sqrt(max(alike, 1.0)))


def held_of(estimate: Estimate) -> Vector:
    """Return the friction that may hold each joint at rest, [N m or N]."""
    joints = len(estimate.sigma)
    held = holding(estimate.model, estimate.parameters, np.full(joints, np.nan))
    return np.asarray(np.where(np.isfinite(held), held, 0.0))


def units_of(estimate: Estimate) -> Vector:
    """Return the typical size of each parameter."""
    layout, x = estimate.model.layout, estimate.parameters
    first = layout.inertial_size
    sizes = abs(x[first:])
    terms = np.array([term for _, term in layout.drive])
    for term in set(terms.tolist()):
        same = terms == term
        largest = float(sizes[same].max())
        sizes[same] = np.maximum(sizes[same], _LEAST_DRIVE * (largest or 1.0))
    return np.concatenate([link_scales(estimate.model.robot).units, sizes])


def regimes_of(
    estimate: Estimate,
    constraints: Sequence[Constraint] | None,
    bodies: float,
    load: LoadPlace,
) -> tuple[Regime, Regime]:
    """Return what is assumed of the robot without a load, and with one.

    Parameters
    ----------
    estimate : Estimate
    constraints : sequence of Constraint, optional
        By default those of the estimate.
    bodies : float
        Standard deviation of bodies, relative to their typical size.
    load : LoadPlace
    """
    model, x, unit = estimate.model, estimate.parameters, units_of(estimate)
    given = constraints
    if given is None:
        under = estimate.fitted_under
        given = DEFAULT_CONSTRAINTS if under is None else under.constraints
    known = lowered(given, model)
    widths = unit.copy()
    widths[: model.layout.inertial_size] *= bodies
    alone = Regime(cone_coordinates(known.normalised(unit)), 1.0 / widths)
    own = model.layout.link_slice(load.link)
    widths[own] = load.capacity * np.array([1.0, *[ARM] * 3, *[ARM**2] * 6])
    root = np.sqrt(load.capacity) * np.array([ARM, ARM, ARM, 1.0])
    coefficients = np.zeros((len(unit), 4, 4))
    coefficients[own] = PSEUDO_INERTIA_BASIS
    body = SemidefiniteBlock(
        "load: physical consistency", coefficients, -pseudo_inertia(x[own]), root
    )
    others = _without_link(known, own, model.layout.links[load.link])
    loaded = others & ConicSet.semidefinite([body], len(unit))
    return alone, Regime(cone_coordinates(loaded.normalised(unit)), 1.0 / widths)


def _without_link(known: ConicSet, own: slice, consistent: str) -> ConicSet:
    """Return a set without what is stated of a link's body.

    Rows and blocks that contain its parameters, such as its shape, are not of a link
    with a load; its physical consistency, the block of that label, is.
    """
    rows = np.vstack([known.A_eq, known.A_in])[:, own].any(axis=1)
    keep = np.flatnonzero(~rows).tolist()
    first = len(known.b_eq) + len(known.b_in)
    blocks = [
        first + place
        for place, block in enumerate(known.blocks)
        if block.label == consistent or not block.coefficients[own].any()
    ]
    return known.only([*keep, *blocks])

"""How well an inertial fits what else is known of a link: shapes, and other links.

Costs are minus logarithms of probabilities.  Their widths are those of what half of the
published robots at hand state (``python benchmarks/repair_causes.py --evidence`` prints
them); tails are those of Student's t with three degrees of freedom, because some of
what is published is made up.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from consistent_id._support.arrays import Matrix, Vector
from consistent_id.export.repair.link_solid import LinkSolid
from consistent_id.robot.inertia import second_moments

SCALE = 0.43  # of ln(second moments over those of the solid), mean of three
FORM = 0.34  # of the same, entries of what differs from the mean
DENSITY = 0.67  # of ln(density over the usual one) of the hull
USUAL_DENSITY = 990.0  # [kg/m^3]; median of mass over volume of the hull
LOOSE_DENSITY = 1.0  # of the same, of the ellipsoid with the same second moments
RATIO = 1.2  # of ln(largest second moment over smallest), per axis, without shapes
PRODUCT = 0.06  # of a product of inertia over its diagonal entries
_FREEDOM = 3.0
_FLOOR = 1e-6  # of the largest second moment; what is thinner is a plate or a rod
_VANISHING = 1e-30  # of the solid's; keeps logarithms finite
_DIGITS = 1e-6  # of the largest entry: twins state the same digits


@dataclass(frozen=True, slots=True, eq=False)
class LinkBody:
    """A link's mass, centre of mass and central inertia in the link's frame."""

    name: str
    mass: float
    com: Vector
    inertia: Matrix


def radius_of_gyration(body: LinkBody) -> float:
    """Return ``sqrt(tr(I) / 2 m)`` [m], the distance of mass from its centre."""
    return float(np.sqrt(max(np.trace(body.inertia), 0.0) / (2.0 * body.mass)))


def misfit(body: LinkBody, solid: LinkSolid | None) -> float:
    """Return the cost of a consistent body beside a solid, or by itself."""
    spread = second_moments(body.inertia) / body.mass
    values, axes = np.linalg.eigh(spread)
    values = np.maximum(values, max(_FLOOR * values[-1], _VANISHING))
    if solid is not None:
        return _beside(axes * values @ axes.T, body.mass, solid)
    volume = 4.0 / 3.0 * np.pi * 5.0**1.5 * float(np.sqrt(values.prod()))
    density = np.log(body.mass / volume / USUAL_DENSITY) / LOOSE_DENSITY
    ratios = np.log(values[1:] / values[:-1]) / RATIO
    diagonal = np.diag(body.inertia)
    products = body.inertia / np.sqrt(np.outer(diagonal, diagonal)) / PRODUCT
    above = products[np.triu_indices(3, 1)]
    terms = [density, *ratios, *above]
    return sum(_student(float(term**2), 1) for term in terms)


def _beside(spread: Matrix, mass: float, solid: LinkSolid) -> float:
    values, axes = np.linalg.eigh(solid.spread)
    whiten = axes / np.sqrt(values)
    found, turned = np.linalg.eigh(whiten.T @ spread @ whiten)
    found = np.maximum(found, _FLOOR * abs(found[-1]))
    logarithm = turned * np.log(np.maximum(found, _VANISHING)) @ turned.T
    mean = float(np.trace(logarithm)) / 3.0
    form = float(np.linalg.norm(logarithm - mean * np.eye(3)))
    density = float(np.log(mass / solid.volume / USUAL_DENSITY))
    return (
        _student((mean / SCALE) ** 2, 1)
        + _student((form / FORM) ** 2, 5)
        + _student((density / DENSITY) ** 2, 1)
    )


def _student(squares: float, dimensions: int) -> float:
    """Return the cost of a sum of squares under Student's distribution."""
    return (_FREEDOM + dimensions) / 2.0 * float(np.log1p(squares / _FREEDOM))


def twin_inertias(
    body: LinkBody, others: Sequence[LinkBody]
) -> list[tuple[str, Matrix]]:
    """Return the inertias that a link would have as the mirror image of others.

    A twin has the same mass, and the same centre of mass up to signs.  Where that is on
    a plane of the frame, there are several.  Centres at the origin tell nothing.
    """
    found: list[tuple[str, Matrix]] = []
    size = float(abs(body.com).max())
    if size == 0.0:
        return found
    for other in others:
        if other is body or abs(other.mass - body.mass) > _DIGITS * body.mass:
            continue
        for signs in product((1.0, -1.0), repeat=3):
            if abs(signs * other.com - body.com).max() <= _DIGITS * size:
                found.append((other.name, other.inertia * np.outer(signs, signs)))
    return found


def alike(first: Matrix, second: Matrix) -> bool:
    """Return whether two inertias have the same digits."""
    size = float(max(abs(first).max(), abs(second).max()))
    return bool(abs(first - second).max() <= _DIGITS * size)

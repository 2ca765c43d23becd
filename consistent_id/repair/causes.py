"""Mistakes that explain an impossible inertial, and the nearest consistent inertia.

These are mistakes of people and programs when they write an inertial; each is undone,
and the result is judged.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from decimal import Decimal
from itertools import combinations, permutations

import numpy as np

from consistent_id._support.arrays import Matrix, Vector
from consistent_id._support.tables import brief
from consistent_id.repair.link_evidence import (
    LinkBody,
    LinkSolid,
    alike,
    misfit,
    twin_inertias,
)
from consistent_id.robot.inertia import second_moments
from consistent_id.robot.loaders.urdf_in_place import inertia_attributes, inertia_matrix

ROUNDING = 1e-12  # of the largest moment: printed numbers may be off by so much
THINNEST = 1e-3  # thickness of a repaired link, over its own size
POINT = 1e-6  # [m]; what is smaller has no extent, and its moments are rounding


@brief
@dataclass(frozen=True, slots=True, eq=False)
class NearestInertia:
    """A central inertia, and its distance from the stated one.

    Parameters
    ----------
    inertia : ndarray, shape (3, 3), [kg m^2]
    change : float
        ``||S - S0||_F / ||S0||_F`` of the second moments of mass ``S = tr(I)/2 1 - I``;
        infinite where there were none.
    """

    inertia: Matrix
    change: float


def is_consistent(inertia: Matrix, least: float = 0.0) -> bool:
    """Return whether an inertia about the centre of mass is consistent.

    Every second moment must be `least` [kg m^2] or more, up to rounding.
    """
    moments = np.linalg.eigvalsh(second_moments(inertia))
    return bool(moments[0] >= least - ROUNDING * abs(moments).max())


def point_mass(mass: float, inertia: Matrix) -> bool:
    """Return whether an inertia has no extent except from rounding of its moments."""
    return bool(abs(inertia).max() <= mass * POINT**2)


def nearest_inertia(
    mass: float, inertia: Matrix, *, thickness: float = 0.0
) -> NearestInertia:
    """Return the nearest physically consistent central inertia.

    Mass and centre of mass stay.  Then the distance of pseudo-inertias
    ``||J0^-1/2 (J - J0) J0^-1/2||_F``, for a reference ``J0`` that has no direction, is
    that of the second moments ``S`` in the Frobenius norm; and the nearest ``S`` whose
    eigenvalues are not below a least one has the same axes, with those that are below
    it raised.  It needs no programme.

    Parameters
    ----------
    mass : float, [kg]
    inertia : ndarray, shape (3, 3), [kg m^2]
        About the centre of mass.
    thickness : float, [m]
        Least standard deviation of mass along every axis; never less than `THINNEST` of
        its size, so that rounding in simulators does not matter.

    Returns
    -------
    NearestInertia
    """
    S = second_moments(inertia)
    moments, axes = np.linalg.eigh(S)
    size = float(abs(moments).max())
    least = max(THINNEST**2 * size, mass * thickness**2)
    raised = np.maximum(moments, least)
    change = np.linalg.norm(raised - moments)
    before = float(np.linalg.norm(moments))
    nearest: Vector = axes @ np.diag(raised.sum() - raised) @ axes.T
    share = float(change) / before if before > 0.0 else np.inf
    return NearestInertia((nearest + nearest.T) / 2, share)


def ball_inertia(mass: float, density: float) -> Matrix:
    """Return the inertia of a solid ball of a density [kg/m^3] about its centre."""
    radius = (3.0 * mass / (4.0 * np.pi * density)) ** (1.0 / 3.0)
    return np.asarray(0.4 * mass * radius**2 * np.eye(3))


FAULT = 7.0  # one inertial in a thousand has a mistake of a known kind
UNKNOWN = 3.0  # a mistake that is none of them is twenty times rarer
SMALL = 0.02  # change of the nearest inertia that printed digits or CAD explain
TWIN = 12.0  # for the very digits of twins, where they cannot be a twin's mistake
ONE_TWIN = 4.0  # for those of one twin, which may be the one that is wrong
COPIED = 6.0  # against the digits of another link of another mass
CLEAR = 1.0  # ahead of all others; `benchmarks/repair_causes.py --thresholds`
CLOSE = 0.02  # of the largest moment; candidates so close are one to a simulator
LISTED = 5  # candidates that a user is shown
NEAREST = "the nearest physically consistent inertia"
_ISOTROPIC = 1e-9

_SLIPS = (-1, 1, -3, 3, -2, 2, -6, 6)  # powers of ten of one entry
_MASS_SLIPS = (-1, 1, -3, 3, -2, 2)
_UNITS = (-6, -4, -3, -7, -9)  # kg mm^2, kg cm^2, g m^2, g cm^2, g mm^2
_SLIPS_OF_ALL = (3, -1, 1, -2, 2)  # of all entries
_GRAMS = (-3, -7, -9)  # of the inertia beside a mass in grams
_SAME = 1e-9  # of the largest entry

# Where the six numbers ixx, ixy, ixz, iyy, iyz, izz stand, counted in the file's order.
_ORDERS = (
    ("the diagonal was written first (xx yy zz xy xz yz)", (0, 3, 4, 1, 5, 2), 0.0),
    ("the diagonal was written first (xx yy zz xy yz xz)", (0, 3, 5, 1, 4, 2), 2.5),
    ("the diagonal was written first (xx yy zz yz xz xy)", (0, 5, 4, 1, 3, 2), 2.5),
    ("the lower triangle was written row by row", (0, 1, 3, 2, 4, 5), 0.0),
)


@dataclass(frozen=True, slots=True, eq=False)
class MeantInertial:
    """A likely intended inertial of a link.

    Parameters
    ----------
    cause : str
        The assumed mistake.
    mass : float, [kg]
    inertia : ndarray, shape (3, 3), [kg m^2]
        About the centre of mass, in the inertial's own axes.
    price : float
        Minus the logarithm of how common the cause is beside the commonest.
    of_file : bool
        Whether the cause may be one of all links, such as units of a file: a twin with
        the same digits has it, too.
    """

    cause: str
    mass: float
    inertia: Matrix
    price: float = 0.0
    of_file: bool = False

    def same(self, other: "MeantInertial") -> bool:
        """Return whether another is the same body."""
        size = max(abs(self.inertia).max(), abs(other.inertia).max())
        alike = abs(self.inertia - other.inertia).max() <= _SAME * size
        return bool(alike and self.mass == other.mass)


@dataclass(frozen=True, slots=True, eq=False)
class Ranked:
    """A candidate and its cost, a logarithm of odds; the smallest is the likeliest."""

    candidate: MeantInertial
    cost: float


@dataclass(frozen=True, slots=True, eq=False)
class LinkStatement:
    """A link's inertial as a file states it, in the inertial's axes."""

    name: str
    mass: float
    com: Vector
    axes: Matrix
    inertia: Matrix

    def body(self, candidate: MeantInertial) -> LinkBody:
        """Return a candidate in the link's frame."""
        inertia = self.axes @ candidate.inertia @ self.axes.T
        return LinkBody(self.name, candidate.mass, self.com, inertia)

    @property
    def stated(self) -> MeantInertial:
        """The stated inertial, as a candidate without a cause."""
        return MeantInertial("", self.mass, self.inertia)

    @property
    def consistent(self) -> bool:
        """Whether what is stated is physically consistent."""
        return is_consistent(self.inertia) or point_mass(self.mass, self.inertia)


def ranked_causes(
    link: LinkStatement, others: Sequence[LinkBody], solid: LinkSolid | None
) -> tuple[Ranked, ...]:
    """Return what a link may have been meant to be, the likeliest first.

    The stated inertial is among them if it is physically consistent, and the nearest
    consistent inertia if it is not; so both have to be beaten.

    Parameters
    ----------
    link : LinkStatement
        With a positive mass.
    others : sequence of LinkBody
        The file's other links with mass.
    solid : LinkSolid, optional
        The body that fills its shapes.
    """
    known = [o for o in others if is_consistent(o.inertia) and o.inertia.any()]
    hypotheses = [
        replace(one, price=FAULT + one.price)
        for one in candidates(link.mass, link.com, link.axes, link.inertia)
        if is_consistent(one.inertia)
    ]
    for name, inertia in twin_inertias(link.body(link.stated), known):
        back = link.axes.T @ inertia @ link.axes
        cause = f"it is not that of its mirror twin {name}"
        one = MeantInertial(cause, link.mass, back, FAULT + 1.0)
        if not any(alike(one.inertia, h.inertia) for h in hypotheses):
            hypotheses.append(one)
    hypotheses.append(_as_it_is(link, known))
    found = [Ranked(one, _cost(link, one, known, solid)) for one in hypotheses]
    return tuple(sorted(found, key=lambda ranked: ranked.cost))


def clear(ranked: Sequence[Ranked]) -> bool:
    """Return whether the first of ranked candidates is far ahead of all others."""
    return lead(ranked) >= CLEAR


def lead(ranked: Sequence[Ranked]) -> float:
    """Return how far the first candidate is ahead of all that differ from it."""
    first = ranked[0].candidate
    size = CLOSE * float(abs(first.inertia).max())
    rivals = (
        one.cost
        for one in ranked[1:]
        if one.candidate.mass != first.mass
        or abs(one.candidate.inertia - first.inertia).max() > size
    )
    return next(rivals, np.inf) - ranked[0].cost


def worth_a_search(
    link: LinkStatement, others: Sequence[LinkBody], solid: LinkSolid | None
) -> bool:
    """Return whether a link's inertia may be wrong.

    It is searched for a cause if it is not consistent; and if it is, where it fits the
    shapes so badly that a mistake is likelier, or has not the digits of its twins.
    Moments that are the same in all directions were made up, and not by mistake.
    """
    if not link.consistent:
        return True
    size = float(abs(link.inertia).max())
    if abs(link.inertia - size * np.eye(3)).max() <= _ISOTROPIC * size:
        return False
    body = link.body(link.stated)
    twins = twin_inertias(body, others)
    astray = bool(twins) and not any(alike(body.inertia, t) for _, t in twins)
    return astray or (solid is not None and misfit(body, solid) > FAULT)


def _as_it_is(link: LinkStatement, known: Sequence[LinkBody]) -> MeantInertial:
    """Return the candidate without a cause: as stated, or nearest to it."""
    if link.consistent:
        stated = link.body(link.stated).inertia
        copied = any(
            alike(stated, other.inertia) and other.mass != link.mass for other in known
        )
        return replace(link.stated, price=COPIED if copied else 0.0)
    near = nearest_inertia(link.mass, link.inertia)
    price = FAULT if near.change <= SMALL else FAULT + UNKNOWN
    return MeantInertial(NEAREST, link.mass, near.inertia, price)


def _cost(
    link: LinkStatement,
    one: MeantInertial,
    known: Sequence[LinkBody],
    solid: LinkSolid | None,
) -> float:
    body = link.body(one)
    cost = one.price + misfit(body, solid)
    if one.of_file:  # of a twin with the same digits, it would be undone, too
        body = link.body(link.stated)
    agreeing = {
        name for name, t in twin_inertias(body, known) if alike(t, body.inertia)
    }
    if not agreeing or one.cause == NEAREST:
        return cost
    return cost - (TWIN if len(agreeing) > 1 or not link.consistent else ONE_TWIN)


def candidates(
    mass: float, com: Vector, axes: Matrix, inertia: Matrix
) -> tuple[MeantInertial, ...]:
    """Return what an inertial may have been meant to be, by one mistake undone.

    Parameters
    ----------
    mass : float, [kg]
    com : ndarray, shape (3,), [m]
        In the link's frame.
    axes : ndarray, shape (3, 3)
        Axes of the inertial, as columns in the link's frame.
    inertia : ndarray, shape (3, 3), [kg m^2]
        As stated, in those axes.

    Returns
    -------
    tuple of MeantInertial
        Different bodies, none the stated one; not all of them consistent.
    """
    found: list[MeantInertial] = []
    stated = MeantInertial("", mass, inertia)
    for one in _all(mass, com, axes, inertia):
        if not any(one.same(other) for other in (stated, *found)):
            found.append(one)
    return tuple(found)


def _all(
    mass: float, com: Vector, axes: Matrix, inertia: Matrix
) -> Iterator[MeantInertial]:
    for cause, matrix, price in _of_entries(inertia):
        yield MeantInertial(cause, mass, matrix, price)
    for places in (*_UNITS, *_SLIPS_OF_ALL):
        wrong, price = f"the inertia is {_times(places)}", _slip_price(places)
        of_file = places in _UNITS
        yield MeantInertial(wrong, mass, _scaled(inertia, places), price, of_file)
    turned = axes.T @ com
    steiner = mass * (turned @ turned * np.eye(3) - np.outer(turned, turned))
    about = "the inertia was stated about the link's origin"
    yield MeantInertial(about, mass, inertia - steiner, 0.3)
    twice = "the inertia was moved to the centre of mass twice"
    yield MeantInertial(twice, mass, inertia + steiner, 1.0)
    back = axes.T @ inertia @ axes
    yield MeantInertial("the inertia was stated in the link's axes", mass, back, 0.5)
    transposed = axes.T @ back @ axes
    cause = "the inertia was turned by the transpose of its rotation"
    yield MeantInertial(cause, mass, transposed, 0.5)
    for places in _MASS_SLIPS:
        cause, slipped = f"the mass is {_times(places)}", shifted(mass, places)
        price, of_file = _slip_price(places), places == -3
        yield MeantInertial(cause, slipped, inertia, price, of_file)
    for places in _GRAMS:
        matrix = _scaled(inertia, places)
        cause = f"the mass is in grams, the inertia {_times(places)}"
        grams = shifted(mass, -3)
        yield MeantInertial(cause, grams, matrix, 1.0, of_file=True)


def _of_entries(inertia: Matrix) -> Iterator[tuple[str, Matrix, float]]:
    """Yield mistakes in the six entries alone."""
    entries = inertia_attributes(inertia)
    names, values = list(entries), list(entries.values())
    products = [name for name in ("ixy", "ixz", "iyz") if entries[name] != 0.0]
    for count in (1, 3, 2):
        for some in combinations(products, count):
            signed = {n: -v if n in some else v for n, v in entries.items()}
            price = {1: 0.0, 3: 0.2, 2: 0.7}[count]
            wrong = f"the sign of {' and '.join(some)} is wrong"
            yield wrong, inertia_matrix(list(signed.values())), price
    for name in ("ixx", "iyy", "izz"):
        if entries[name] < 0.0:
            positive = entries | {name: -entries[name]}
            matrix = inertia_matrix(list(positive.values()))
            yield f"the sign of {name} is wrong", matrix, 0.0
    for name in names:
        for places in _SLIPS if entries[name] != 0.0 else ():
            slipped = entries | {name: shifted(entries[name], places)}
            matrix = inertia_matrix(list(slipped.values()))
            wrong = f"{name} is {_times(places)}"
            yield wrong, matrix, 0.5 + _slip_price(places)
    for wrong, order, price in _ORDERS:
        yield wrong, inertia_matrix([values[k] for k in order]), price
    yield from _swapped(entries)


def _swapped(entries: dict[str, float]) -> Iterator[tuple[str, Matrix, float]]:
    """Yield diagonal entries, or products, that stand in each other's places."""
    for among, price in ((("ixx", "iyy", "izz"), 2.0), (("ixy", "ixz", "iyz"), 2.0)):
        for order in permutations(among):
            if order != among:
                moved = dict(zip(among, (entries[n] for n in order), strict=True))
                matrix = inertia_matrix(list((entries | moved).values()))
                wrong = f"{' '.join(order)} stand in the places of {' '.join(among)}"
                yield wrong, matrix, price


def shifted(value: float, places: int) -> float:
    """Return a number with its decimal point moved; its digits stay."""
    return float(Decimal(repr(float(value))).scaleb(places))


def _scaled(inertia: Matrix, places: int) -> Matrix:
    entries = inertia_attributes(inertia).values()
    return inertia_matrix([shifted(value, places) for value in entries])


def _slip_price(places: int) -> float:
    """Thousands are units, and ten is a digit; others are rarer."""
    return 0.0 if abs(places) in (1, 3) else 0.7


def _times(places: int) -> str:
    word = "large" if places < 0 else "small"
    return f"{10 ** abs(places):g} times too {word}"

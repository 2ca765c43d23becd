"""Which mistake explains an inertial that cannot be right, if one does."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from consistent_id._support.arrays import Matrix, Vector
from consistent_id.export.repair.consistent_inertia import (
    is_consistent,
    nearest_inertia,
    point_mass,
)
from consistent_id.export.repair.fault_causes import Candidate, candidates
from consistent_id.export.repair.link_evidence import (
    LinkBody,
    alike,
    misfit,
    twin_inertias,
)
from consistent_id.export.repair.link_solid import LinkSolid

FAULT = 7.0  # one inertial in a thousand has a mistake of a known kind
UNKNOWN = 3.0  # a mistake that is none of them is twenty times rarer
SMALL = 0.02  # change of the nearest inertia that printed digits or CAD explain
TWIN = 12.0  # for the very digits of twins, where they cannot be a twin's mistake
ONE_TWIN = 4.0  # for those of one twin, which may be the one that is wrong
COPIED = 6.0  # against the digits of another link of another mass
CLEAR = 1.0  # ahead of all others; `benchmarks/repair_causes.py --thresholds`
CLOSE = 0.02  # of the largest moment; candidates so close are one to a simulator
LISTED = 5  # candidates that a user is shown
_ISOTROPIC = 1e-9
NEAREST = "the nearest physically consistent inertia"


@dataclass(frozen=True, slots=True, eq=False)
class Ranked:
    """A candidate and its cost, a logarithm of odds; the smallest is the likeliest."""

    candidate: Candidate
    cost: float


@dataclass(frozen=True, slots=True, eq=False)
class LinkStatement:
    """What a file states of a link, in the inertial's axes."""

    name: str
    mass: float
    com: Vector
    axes: Matrix
    inertia: Matrix

    def body(self, candidate: Candidate) -> LinkBody:
        """Return a candidate in the link's frame."""
        inertia = self.axes @ candidate.inertia @ self.axes.T
        return LinkBody(self.name, candidate.mass, self.com, inertia)

    @property
    def stated(self) -> Candidate:
        """What is stated, as a candidate without a cause."""
        return Candidate("", self.mass, self.inertia)

    @property
    def consistent(self) -> bool:
        """Whether what is stated is physically consistent."""
        return is_consistent(self.inertia) or point_mass(self.mass, self.inertia)


def ranked_causes(
    link: LinkStatement, others: Sequence[LinkBody], solid: LinkSolid | None
) -> tuple[Ranked, ...]:
    """Return what a link may have been meant to be, the likeliest first.

    What is stated is among it if it is physically consistent, and the nearest
    consistent inertia if it is not; so both have to be beaten.

    Parameters
    ----------
    link : LinkStatement
        With a positive mass.
    others : sequence of LinkBody
        The file's other links with mass.
    solid : LinkSolid, optional
        What its shapes fill.
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
        one = Candidate(cause, link.mass, back, FAULT + 1.0)
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


def _as_it_is(link: LinkStatement, known: Sequence[LinkBody]) -> Candidate:
    """Return the candidate without a cause: as stated, or nearest to it."""
    if link.consistent:
        stated = link.body(link.stated).inertia
        copied = any(
            alike(stated, other.inertia) and other.mass != link.mass for other in known
        )
        return replace(link.stated, price=COPIED if copied else 0.0)
    near = nearest_inertia(link.mass, link.inertia)
    price = FAULT if near.change <= SMALL else FAULT + UNKNOWN
    return Candidate(NEAREST, link.mass, near.inertia, price)


def _cost(
    link: LinkStatement,
    one: Candidate,
    known: Sequence[LinkBody],
    solid: LinkSolid | None,
) -> float:
    body = link.body(one)
    cost = one.price + misfit(body, solid)
    agreeing = {
        name for name, t in twin_inertias(body, known) if alike(t, body.inertia)
    }
    if not agreeing or one.cause == NEAREST:
        return cost
    return cost - (TWIN if len(agreeing) > 1 or not link.consistent else ONE_TWIN)

"""The evidence of a whole file on each link: inertial, shapes, twins, mistakes."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Self

import numpy as np

from consistent_id._support.arrays import Matrix, Vector
from consistent_id.errors import ModelError
from consistent_id.repair.causes import (
    LISTED,
    NEAREST,
    LinkStatement,
    MeantInertial,
    Ranked,
    clear,
    ranked_causes,
    worth_a_search,
)
from consistent_id.repair.link_evidence import (
    LinkBody,
    LinkSolid,
    link_solids,
    radius_of_gyration,
)
from consistent_id.repair.link_repair import Suggestion
from consistent_id.robot.loaders.urdf_in_place import (
    inertia_attributes,
    inertia_matrix,
    numbers,
    rotation_of,
)
from consistent_id.robot.loaders.urdf_lint import (
    INERTIA_ENTRIES,
    LARGEST_OF_A_BODY,
    readable_numbers,
)
from consistent_id.robot.loaders.xml import Element

_LARGE = 0.1  # change of the nearest inertia above which a user is warned


@dataclass(frozen=True, slots=True, eq=False)
class StatedInertial:
    """A link's mass and inertia as stated; None where they cannot be read.

    `unreadable` is the text in their place, `displaced` the text in place of a readable
    origin.  The inertia is about the centre of mass `com`, in `axes`, whose columns are
    directions in the link's frame.
    """

    mass: float | None
    inertia: Matrix | None
    unreadable: tuple[str, ...]
    displaced: str
    com: Vector
    axes: Matrix


@dataclass(frozen=True, slots=True, eq=False)
class Remedy:
    """The new inertial of a link, in its inertial's axes, and the reason.

    `nearest` says that no cause was found.
    """

    mass: float
    inertia: Matrix
    change: float
    text: str
    nearest: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Explained:
    """Likely intended inertials of a link, the likeliest first."""

    ranked: tuple[Ranked, ...] = ()
    consistent: bool = True

    @property
    def suggestions(self) -> tuple[Suggestion, ...]:
        """The likeliest, for people."""
        return tuple(
            Suggestion(
                one.candidate.cause or "nothing is wrong",
                one.candidate.mass,
                tuple(inertia_attributes(one.candidate.inertia).values()),
                round(one.cost - self.ranked[0].cost, 2),
            )
            for one in self.ranked[:LISTED]
        )

    @property
    def several(self) -> bool:
        """Whether no single mistake is the likeliest."""
        return bool(self.ranked) and not clear(self.ranked)

    @property
    def doubt(self) -> str:
        """The probable mistake of a consistent inertial; empty if there is none."""
        if not self.ranked or not self.ranked[0].candidate.cause or self.several:
            return ""
        return f"consistent, but probably {self.ranked[0].candidate.cause}"

    def chosen(self, name: str, choice: int | None) -> MeantInertial | None:
        """Return the user's choice, or the likeliest; None for the nearest inertia."""
        if choice == 0 or not self.ranked:
            return None
        place = (choice or 1) - 1
        if place >= min(len(self.ranked), LISTED):
            raise ModelError(
                f"link {name!r}: choice {choice}, but there are "
                f"{min(len(self.ranked), LISTED)} suggestions"
            )
        one = self.ranked[place].candidate
        return None if one.cause == NEAREST else one


@dataclass(frozen=True, slots=True, eq=False)
class FileEvidence:
    """Statements and shapes of a file's links, by name."""

    statements: Mapping[str, LinkStatement]
    bodies: tuple[LinkBody, ...]
    solids: Mapping[str, LinkSolid]

    @classmethod
    def of(cls, path: Path, root: Element) -> Self:
        """Read the inertials of a file's links, and their shapes."""
        found = {}
        for link in root.all("link"):
            inertial = link.child("inertial")
            stated = None if inertial is None else stated_inertial(inertial)
            if stated is None or stated.displaced or stated.inertia is None:
                continue
            mass, com, axes = stated.mass or 0.0, stated.com, stated.axes
            if mass > 0.0:
                statement = LinkStatement(link.name, mass, com, axes, stated.inertia)
                found[link.name] = statement
        bodies = tuple(one.body(one.stated) for one in found.values())
        return cls(found, bodies, link_solids(path, root))

    def explained(self, name: str, mass: float | None, *, fixed: bool) -> Explained:
        """Return the likely intended inertials of a link.

        If its mass is `fixed`, because the user states it, no other is considered.
        """
        link = self.statements.get(name)
        if link is None or not mass:
            return Explained()
        stated = LinkStatement(name, mass, link.com, link.axes, link.inertia)
        others = tuple(body for body in self.bodies if body.name != name)
        solid = self.solids.get(name)
        if not worth_a_search(stated, others, solid):
            return Explained()
        ranked = ranked_causes(stated, others, solid)
        if fixed:
            ranked = tuple(one for one in ranked if one.candidate.mass == mass)
        return Explained(ranked, stated.consistent)

    def warning(self, name: str, done: Remedy) -> str:
        """Return the reason to check the nearest consistent inertia."""
        link, solid = self.statements.get(name), self.solids.get(name)
        words = []
        if _LARGE < done.change < np.inf:
            words.append(
                f"no known mistake explains it, and the nearest consistent inertia "
                f"moves the second moments by {100 * done.change:.0f} %"
            )
        if link is not None and solid is not None:
            body = link.body(MeantInertial("", done.mass, done.inertia))
            radius, reach = radius_of_gyration(body), solid.reach(link.com)
            if radius > reach:
                words.append(
                    f"its radius of gyration, {radius:.3g} m, is larger than the "
                    f"reach of the link's shapes, {reach:.3g} m"
                )
        return "; ".join(words)


def stated_inertial(inertial: Element) -> StatedInertial:
    """Read an inertial; invalid numbers do not stop the others."""
    found: dict[str, float] = {}
    unreadable = []
    for tag, names in (("mass", ("value",)), ("inertia", INERTIA_ENTRIES)):
        element = inertial.child(tag)
        if element is None:
            unreadable.append(f"<{tag}> is missing")
            continue
        values = _numbers(element.attributes, names)
        for name, value in values.items():
            if value is None:
                stated = element.attributes.get(name)
                seen = "is missing" if stated is None else f"is {stated!r}"
                unreadable.append(f"<{tag} {name}> {seen}")
            else:
                found[name] = value
    whole = all(entry in found for entry in INERTIA_ENTRIES)
    inertia = inertia_matrix([found[e] for e in INERTIA_ENTRIES]) if whole else None
    origin = inertial.child("origin")
    displaced = _displaced(origin)
    where = {} if origin is None or displaced else origin.attributes
    return StatedInertial(
        found.get("value"),
        inertia,
        tuple(unreadable),
        displaced,
        numbers(where.get("xyz", "0 0 0")),
        rotation_of(numbers(where.get("rpy", "0 0 0")).tolist()),
    )


def _displaced(origin: Element | None) -> str:
    for name in ("xyz", "rpy"):
        stated = "0 0 0" if origin is None else origin.attributes.get(name, "0 0 0")
        if not readable_numbers(stated, 3, LARGEST_OF_A_BODY):
            return f"<origin {name}> is {stated!r}"
    return ""


def _numbers(
    attributes: Mapping[str, str], names: tuple[str, ...]
) -> dict[str, float | None]:
    return {
        name: (
            float(attributes[name])
            if name in attributes
            and readable_numbers(attributes[name], 1, LARGEST_OF_A_BODY)
            else None
        )
        for name in names
    }


def moments_in_words(inertia: Matrix) -> str:
    """Return the principal moments of inertia, for people."""
    return ", ".join(f"{moment:.4g}" for moment in np.linalg.eigvalsh(inertia))

"""What a URDF's link states of its inertial, readable or not."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from consistent_id._support.arrays import Matrix, Vector
from consistent_id.robot.loaders.urdf_inertial import (
    inertia_matrix,
    numbers,
    rotation_of,
)
from consistent_id.robot.loaders.urdf_lint import LARGEST_OF_A_BODY, readable_numbers
from consistent_id.robot.loaders.urdf_parts import INERTIA_ENTRIES
from consistent_id.robot.loaders.xml import Element


@dataclass(frozen=True, slots=True, eq=False)
class StatedInertial:
    """A link's mass and inertia as stated; None where they cannot be read.

    `unreadable` says what stands in their place, `displaced` what stands in that of a
    readable origin.  The inertia is about the centre of mass `com`, in `axes`, whose
    columns are directions in the link's frame.
    """

    mass: float | None
    inertia: Matrix | None
    unreadable: tuple[str, ...]
    displaced: str
    com: Vector
    axes: Matrix


def stated_inertial(inertial: Element) -> StatedInertial:
    """Read an inertial; numbers that are none do not stop the rest."""
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

"""The tables of constraints and of the prior in a problem file."""

from typing import Annotated, Literal

from msgspec import Meta

from consistent_id.constraints.priors import INSIDE
from consistent_id.problems.table_types import NonNegative, Pair, Positive, Table, Three


class RelationTable(Table, frozen=True, kw_only=True):
    """A linear relation of parameters by name."""

    terms: dict[str, float]
    lower: float | None = None
    upper: float | None = None


class EqualLinksTable(Table, frozen=True, kw_only=True):
    """Two links that are alike, or mirror images."""

    first: str
    second: str
    mirror: Literal["x", "y", "z"] | None = None


class EllipsoidTable(Table, frozen=True, kw_only=True):
    """An ellipsoid along a link frame's axes [m]."""

    centre: Three
    semi_axes: Three


class ShapeTable(Table, frozen=True, kw_only=True):
    """Where a link's centre of mass or material lies: one of four shapes [m].

    A mesh is a file in the problem's folder, in the link's frame; its hull counts, or
    the smallest ellipsoid around it.
    """

    link: str
    ellipsoid: EllipsoidTable | None = None
    box: Annotated[list[Three], Meta(min_length=2, max_length=2)] | None = None
    hull: Annotated[list[Three], Meta(min_length=4)] | None = None
    mesh: str | None = None
    mesh_scale: Positive = 1.0
    mesh_shape: Literal["hull", "ellipsoid"] = "hull"


class ConstraintsTable(Table, frozen=True, kw_only=True):
    """Constraints of the constrained estimate."""

    margin: Annotated[float, Meta(ge=0.0, lt=1.0)] = 1e-6
    bodies: Literal["identified", "model"] = "identified"
    known_links: list[str] = []
    masses: Literal["datasheet", "bounds", "free"] = "datasheet"
    centres_of_mass: Literal["datasheet", "box", "free"] = "free"
    drive_signs: bool = True
    shared_motors: bool = False
    equal_motors: list[Annotated[list[str], Meta(min_length=2)]] = []
    rotor_inertias: Literal["datasheet", "free"] = "datasheet"
    rotor_inertia_tolerance: NonNegative = 0.0
    fixed: dict[str, float] = {}
    bounds: dict[str, Pair] = {}
    relations: list[RelationTable] = []
    total_mass: NonNegative | Pair | None = None
    equal_links: list[EqualLinksTable] = []
    symmetric: dict[str, list[Literal["x", "y", "z"]]] = {}
    centre_of_mass_in: list[ShapeTable] = []
    density_on: list[ShapeTable] = []


class PriorTable(Table, frozen=True, kw_only=True):
    """The prior on parameters that are not identifiable: a slack, or a weight."""

    slack: Annotated[float, Meta(gt=0.0, lt=1.0)] | None = None
    distance: Literal["pullback", "euclidean", "entropic"] = "pullback"
    weight: Positive | None = None
    inside: Annotated[float, Meta(ge=0.0, lt=1.0)] = INSIDE

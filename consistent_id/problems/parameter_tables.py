"""Tables of a problem file for drives and constraints, and their parts."""

from typing import Annotated, Any, Literal, get_type_hints

import msgspec
from msgspec import Meta

from consistent_id.constraints.priors import INSIDE
from consistent_id.regression.drive.drive_terms import (
    DEFAULTS,
    DriveOptions,
    DriveTerms,
)

Positive = Annotated[float, Meta(gt=0.0)]
NonNegative = Annotated[float, Meta(ge=0.0)]
Three = Annotated[list[float], Meta(min_length=3, max_length=3)]
Pair = Annotated[list[float], Meta(min_length=2, max_length=2)]


class FileTable(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """A table of the file; a key that it does not name is an error."""


class RelationTable(FileTable, frozen=True, kw_only=True):
    """A linear relation of parameters by name."""

    terms: dict[str, float]
    lower: float | None = None
    upper: float | None = None


class EqualLinksTable(FileTable, frozen=True, kw_only=True):
    """Two links that are alike, or mirror images."""

    first: str
    second: str
    mirror: Literal["x", "y", "z"] | None = None


class EllipsoidTable(FileTable, frozen=True, kw_only=True):
    """An ellipsoid along a link frame's axes [m]."""

    centre: Three
    semi_axes: Three


class ShapeTable(FileTable, frozen=True, kw_only=True):
    """Region of a link's centre of mass or material: one of four shapes [m].

    A mesh is a file in the problem's folder, in the link's frame; its hull is used, or
    the smallest ellipsoid around it.
    """

    link: str
    ellipsoid: EllipsoidTable | None = None
    box: Annotated[list[Three], Meta(min_length=2, max_length=2)] | None = None
    hull: Annotated[list[Three], Meta(min_length=4)] | None = None
    mesh: str | None = None
    mesh_scale: Positive = 1.0
    mesh_shape: Literal["hull", "ellipsoid"] = "hull"


class ConstraintsTable(FileTable, frozen=True, kw_only=True):
    """Constraints of the constrained estimate."""

    margin: Annotated[float, Meta(ge=0.0, lt=1.0)] = 1e-6
    bodies: Literal["identified", "model"] | None = None
    known_links: list[str] = []
    masses: Literal["datasheet", "bounds", "free"] = "datasheet"
    centres_of_mass: Literal["datasheet", "box", "free"] = "free"
    drive_signs: bool | Literal["dissipative"] = True
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


class PriorTable(FileTable, frozen=True, kw_only=True):
    """The prior on parameters that are not identifiable: a slack, or a weight."""

    slack: Annotated[float, Meta(gt=0.0, lt=1.0)] | None = None
    distance: Literal["pullback", "euclidean", "entropic"] = "pullback"
    weight: Positive | None = None
    inside: Annotated[float, Meta(ge=0.0, lt=1.0)] = INSIDE


_POSITIVE = {float: Positive, float | None: Positive | None}
_DriveTable: Any = msgspec.defstruct(
    "_DriveTable",
    [
        (name, _POSITIVE.get(kind, kind), DEFAULTS[name])
        for name, kind in get_type_hints(DriveOptions).items()
    ],
    bases=(FileTable,),
    frozen=True,
    kw_only=True,
)


class DriveTable(_DriveTable, frozen=True, kw_only=True):  # type: ignore[misc, call-arg]
    """Friction and drive terms of all joints, or of one: the keys of `DriveOptions`."""

    @property
    def terms(self) -> DriveTerms:
        """The drive terms of the keys."""
        return DriveTerms(**{name: getattr(self, name) for name in DEFAULTS})


# If a joint has no value for a key, that of all joints is used.  TOML has no null, so
# zero stands for it.
_NONE = {float | None: NonNegative | None}
_JointDrive: Any = msgspec.defstruct(
    "_JointDrive",
    [
        (
            name,
            _NONE.get(kind, _POSITIVE.get(kind, kind)) | msgspec.UnsetType,
            msgspec.UNSET,
        )
        for name, kind in get_type_hints(DriveOptions).items()
    ],
    bases=(FileTable,),
    frozen=True,
    kw_only=True,
)
_DIRECTED = ("asymmetric", "stribeck_velocity", "load_friction")


class JointTable(_JointDrive, frozen=True, kw_only=True):  # type: ignore[misc, call-arg]
    """Exceptions for one joint, and the datasheet of its motor."""

    gear_ratio: float | None = None
    motor_inertia: NonNegative | None = None

    @property
    def stated(self) -> dict[str, Any]:
        """The keys of drive terms that the table has, and their values."""
        found = {name: getattr(self, name) for name in DEFAULTS}
        return {k: v for k, v in found.items() if v is not msgspec.UNSET}

    def over(self, drive: DriveTable) -> DriveTable:
        """Return the drive of the joint: its own keys, else those of all joints.

        Settings for all joints that contradict the joint's own are ignored: the width
        of a sign change or the friction of a direction that it does not have, and an
        offset beside asymmetric friction.
        """
        own = {
            k: None if v == 0 and k in _OPTIONAL else v for k, v in self.stated.items()
        }
        common = {name: getattr(drive, name) for name in DEFAULTS}
        if own.get("coulomb", "tanh") != "tanh":
            common["velocity_scale"] = None
        if own.get("coulomb") == "none":
            common |= {name: DEFAULTS[name] for name in _DIRECTED}
        if own.get("asymmetric"):
            common["offset"] = False
        return DriveTable(**(common | own))


def exceptions(own: DriveTable, common: DriveTable) -> dict[str, Any]:
    """Return the exceptions of one joint, by key; zero stands for none."""
    values = {key: getattr(own, key) for key in DEFAULTS}
    return {
        key: 0.0 if value is None else value
        for key, value in values.items()
        if value != getattr(common, key)
    }


_OPTIONAL = tuple(k for k, v in DEFAULTS.items() if v is None)

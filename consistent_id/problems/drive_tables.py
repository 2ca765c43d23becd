"""The tables of drive terms in a problem file: of all joints, and of one."""

from typing import Any, get_type_hints

import msgspec

from consistent_id.problems.table_types import NonNegative, Positive, Table
from consistent_id.regression.drive.drive_terms import (
    DEFAULTS,
    DriveOptions,
    DriveTerms,
)

_POSITIVE = {float: Positive, float | None: Positive | None}
_DriveTable: Any = msgspec.defstruct(
    "_DriveTable",
    [
        (name, _POSITIVE.get(kind, kind), DEFAULTS[name])
        for name, kind in get_type_hints(DriveOptions).items()
    ],
    bases=(Table,),
    frozen=True,
    kw_only=True,
)


class DriveTable(_DriveTable, frozen=True, kw_only=True):  # type: ignore[misc, call-arg]
    """Friction and drive terms of all joints, or of one: the keys of `DriveOptions`."""

    @property
    def terms(self) -> DriveTerms:
        """The terms that the keys choose."""
        return DriveTerms(**{name: getattr(self, name) for name in DEFAULTS})


# Of a joint a key may be missing: then that of all joints counts.  TOML has no null:
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
    bases=(Table,),
    frozen=True,
    kw_only=True,
)
_DIRECTED = ("asymmetric", "stribeck_velocity", "load_friction")


class JointTable(_JointDrive, frozen=True, kw_only=True):  # type: ignore[misc, call-arg]
    """What one joint has else than all, and what the datasheet says of its motor."""

    gear_ratio: float | None = None
    motor_inertia: NonNegative | None = None

    @property
    def stated(self) -> dict[str, Any]:
        """The keys of drive terms that the table has, and their values."""
        found = {name: getattr(self, name) for name in DEFAULTS}
        return {k: v for k, v in found.items() if v is not msgspec.UNSET}

    def over(self, drive: DriveTable) -> DriveTable:
        """Return the drive of the joint: its own keys, those of all for the others.

        What is of all and contradicts the joint's own is left out: the width of a sign
        change that it has not, friction of a direction that it has not, and an offset
        beside asymmetric friction.
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
    """Return what one joint has else than all, by key; zero stands for none."""
    values = {key: getattr(own, key) for key in DEFAULTS}
    return {
        key: 0.0 if value is None else value
        for key, value in values.items()
        if value != getattr(common, key)
    }


_OPTIONAL = tuple(k for k, v in DEFAULTS.items() if v is None)

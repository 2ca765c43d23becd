"""Drive terms in words: for all joints, with exceptions for some."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from consistent_id.errors import ProblemError
from consistent_id.problems.parameter_tables import DriveTable, JointTable, exceptions
from consistent_id.problems.stated_model import DEFAULT_DRIVE
from consistent_id.regression.drive.drive_terms import DEFAULTS, DriveTerms
from consistent_id.robot.parameters import did_you_mean, require_known

_SWITCHES = tuple(name for name, value in DEFAULTS.items() if value in (False, "none"))


@dataclass(frozen=True, slots=True)
class StatedDrive:
    """Drive terms of all joints, and exceptions for some."""

    common: DriveTable
    joints: Mapping[str, JointTable]

    def terms(self, joints: Sequence[str]) -> tuple[DriveTerms, ...]:
        """Return the terms of joints, in their order."""
        own = (self.joints.get(name) for name in joints)
        tables = (self.common if t is None else t.over(self.common) for t in own)
        return tuple(table.terms for table in tables)


def stated_drive(
    words: Sequence[str], joints: Sequence[str], *, width: float | None = None
) -> StatedDrive:
    """Return the drive that words state.

    Parameters
    ----------
    words : sequence of str
        Terms of all joints, such as ``viscous``, and those of one joint in their
        place: ``wrist=viscous,coulomb``, or ``wrist=`` for none.
    joints : sequence of str
        The robot's.
    width : float, optional, [rad/s or m/s]
        The width of friction's change of sign; by default a usual one.

    Raises
    ------
    ProblemError
        If there is no such term or joint, or one joint alone is described.
    """
    common = [word for word in words if "=" not in word]
    alone = [word for word in words if "=" in word]
    if alone and not common:
        raise ProblemError(
            f"drive terms are only {alone[0]!r}, expected those of all joints "
            f"before, such as viscous coulomb offset {alone[0]}"
        )
    table, own = drive_table(common, width), dict[str, JointTable]()
    for word in alone:
        joint, _, terms = word.partition("=")
        if joint not in joints:
            raise ProblemError(
                f"drive terms {word!r}: no joint {joint!r}; "
                f"{did_you_mean(joint, joints)}"
            )
        other = drive_table([term for term in terms.split(",") if term], width)
        own[joint] = JointTable(**exceptions(other, table))
    return StatedDrive(table, own)


def drive_table(names: Sequence[str], width: float | None = None) -> DriveTable:
    """Return the drive terms of these names; those with shapes have usual ones.

    Raises
    ------
    ProblemError
        If there is no such term.
    """
    require_known(names, _SWITCHES, "no drive term")
    keys: dict[str, Any] = dict.fromkeys(names, True)
    if keys.pop("coulomb", False):
        usual = DEFAULT_DRIVE.velocity_scale
        keys |= {"coulomb": "tanh", "velocity_scale": width or usual}
    return DriveTable(**keys)

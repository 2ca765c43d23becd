"""What a robot's file draws beside the robot: shapes of links, and nominal drives."""

from collections.abc import Mapping
from dataclasses import dataclass, field

_DISTINCT = 3  # values of joints that differ; placeholders are alike


@dataclass(frozen=True, slots=True)
class DrawnDrive:
    """A joint's nominal friction and rotor inertia.

    Parameters
    ----------
    viscous : float, [N m s/rad or N s/m]
    coulomb : float, [N m or N]
    rotor_inertia : float, [kg m^2 or kg]
        At the joint.
    """

    viscous: float = 0.0
    coulomb: float = 0.0
    rotor_inertia: float = 0.0


@dataclass(frozen=True, slots=True)
class DrawnParts:
    """Shapes and drives of a robot's file.

    Parameters
    ----------
    reach : mapping of str to float, [m]
        Distance from a link's joint to the farthest point of its shapes, or more; only
        of links all of whose shapes are known, and whose masses all have shapes.
    drives : mapping of str to DrawnDrive
        Of joints for which the file has any.
    fault : str
        Why the file cannot be read; empty if it can be, or if there is none.
    """

    reach: Mapping[str, float] = field(default_factory=dict)
    drives: Mapping[str, DrawnDrive] = field(default_factory=dict)
    fault: str = ""

    @property
    def friction_known(self) -> bool:
        """Whether friction is more than a placeholder: joints differ."""
        each = {(d.viscous, d.coulomb) for d in self.drives.values()}
        return len({pair for pair in each if max(pair) > 0.0}) >= _DISTINCT

    @property
    def rotors_known(self) -> bool:
        """Whether rotor inertia is more than a placeholder: joints differ."""
        rotors = {d.rotor_inertia for d in self.drives.values()}
        return len({rotor for rotor in rotors if rotor > 0.0}) >= _DISTINCT

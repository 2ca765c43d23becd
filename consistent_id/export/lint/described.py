"""A robot description as the rules of the lint see it, whatever its format."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from consistent_id._support.arrays import Matrix, Vector
from consistent_id.robot.model import RobotModel

Severity = Literal["error", "warning"]


@dataclass(frozen=True, slots=True, order=True)
class LintFinding:
    """One thing that a simulator refuses, or takes and should not.

    Parameters
    ----------
    line : int
        Counted from 1.
    rule : str
        An entry of `RULES`.
    severity : {"error", "warning"}
        An error is what some simulator refuses, or what cannot be loaded.
    sentence : str
    """

    line: int
    rule: str
    severity: Severity
    sentence: str

    def __str__(self) -> str:
        return f"line {self.line}: {self.severity}: {self.sentence} [{self.rule}]"


@dataclass(frozen=True, slots=True, eq=False)
class DescribedLink:
    """A link with mass, in its own frame.

    Parameters
    ----------
    mass : float, [kg]
    com : ndarray, shape (3,), [m]
    inertia : ndarray, shape (3, 3), [kg m^2]
        About the centre of mass.
    reach : float or None, [m]
        From the centre of mass to the farthest point of its shapes, or more.
    joints : float, [m]
        From the centre of mass to the farthest of the joints at this link, or between
        this joint and the one before.
    """

    name: str
    line: int
    mass: float
    com: Vector
    inertia: Matrix
    reach: float | None
    joints: float

    @property
    def radius(self) -> float:
        """Radius of gyration about the centre of mass, [m]."""
        return float(np.sqrt(max(np.trace(self.inertia), 0.0) / (2.0 * self.mass)))


@dataclass(frozen=True, slots=True, eq=False)
class DescribedRobot:
    """Links with mass, the robot if it can be loaded, and lines of joints by name."""

    links: tuple[DescribedLink, ...]
    robot: RobotModel | None
    joint_lines: Mapping[str, int]

"""The ``[excitation]`` table of a problem file: the motion to design and its limits."""

from typing import Annotated, Literal

from msgspec import Meta

from consistent_id.problems.parameter_tables import (
    FileTable,
    NonNegative,
    Pair,
    Positive,
)

CLEARANCE = 0.02
"""Least distance of any two bodies, unless another one is stated [m]."""

Three = tuple[float, float, float]
PerJoint = Positive | list[Positive] | dict[str, Positive]


class LimitsTable(FileTable, frozen=True, kw_only=True):
    """Limits in place of the robot file's; one for all joints, or by name."""

    position: dict[str, Pair] = {}
    velocity: PerJoint | None = None
    acceleration: PerJoint | None = None
    jerk: PerJoint | None = None
    effort: PerJoint | None = None
    effort_rate: PerJoint | None = None
    effort_rms: PerJoint | None = None
    current: PerJoint | None = None
    torque_constant: PerJoint | None = None
    friction_share: Annotated[float, Meta(ge=0.0, lt=1.0)] | None = None
    share: Annotated[float, Meta(gt=0.0, le=1.0)] = 1.0


class SphereTable(FileTable, frozen=True, kw_only=True):
    """A ball about the body's position; in m, as all that follow."""

    radius: Positive


class BoxTable(FileTable, frozen=True, kw_only=True):
    """A box about the body's position."""

    size: tuple[Positive, Positive, Positive]


class RodTable(FileTable, frozen=True, kw_only=True):
    """A capsule or cylinder: along z of the body, or between two points."""

    radius: Positive
    length: Positive | None = None
    ends: tuple[Three, Three] | None = None


class BodyTable(FileTable, frozen=True, kw_only=True):
    """A body of the robot, on a link, or without one an obstacle: one of four shapes.

    `position` [m] and `rpy_deg` [degrees] place it in the link's or the base's frame.
    """

    name: Annotated[str, Meta(min_length=1)]
    link: str | None = None
    position: Three = (0.0, 0.0, 0.0)
    rpy_deg: Three = (0.0, 0.0, 0.0)
    sphere: SphereTable | None = None
    box: BoxTable | None = None
    capsule: RodTable | None = None
    cylinder: RodTable | None = None


class WorkspaceTable(FileTable, frozen=True, kw_only=True):
    """A box in the base frame for a point of a link; in m.

    A missing face is no bound.
    """

    link: str
    point: Three = (0.0, 0.0, 0.0)
    x: Pair | None = None
    y: Pair | None = None
    z: Pair | None = None


class ConeTable(FileTable, frozen=True, kw_only=True):
    """A cone about an axis of the base frame for a link's direction."""

    link: str
    angle_deg: Annotated[float, Meta(ge=1.0, le=179.0)]
    axis: Three = (0.0, 0.0, -1.0)
    direction: Three = (0.0, 0.0, 1.0)


class SceneTable(FileTable, frozen=True, kw_only=True):
    """Bodies that must not touch: the robot's own, and obstacles."""

    robot: Literal["urdf", "bodies"] = "urdf"
    elements: Literal["collision", "visual"] = "collision"
    packages: list[str] = []
    pieces: Annotated[int, Meta(ge=1)] = 4
    ground: float | None = None
    bodies: list[BodyTable] = []
    planning_scene: str | None = None
    workspaces: list[WorkspaceTable] = []
    cones: list[ConeTable] = []
    clearance: NonNegative | None = None  # CLEARANCE, where it can be kept
    extra: dict[str, NonNegative] = {}
    allowed: list[tuple[str, str]] = []


class ExcitationTable(FileTable, frozen=True, kw_only=True):
    """Form, aim and limits of an exciting trajectory."""

    duration: Positive = 10.0
    harmonics: Annotated[int, Meta(ge=1)] | None = None
    base_frequencies: Annotated[list[Positive], Meta(min_length=1)] | None = None
    rest: bool = True
    smooth: bool = False
    periods: Annotated[int, Meta(ge=1)] = 1
    objective: Literal["condition", "D", "A", "E"] = "D"
    refine: Literal["D", "A", "E", "none"] | None = None
    interest: list[str] = []
    others: Literal["unknown", "known"] = "unknown"
    growth: Annotated[float, Meta(ge=1.0)] = 1.5
    condition_at_most: Annotated[float, Meta(ge=1.0)] | None = None
    scaling: Literal["none", "unit columns"] = "none"
    noise: PerJoint | None = None
    rate: Positive = 100.0
    correlation_time: NonNegative = 0.2
    start_pose: dict[str, float] = {}
    limits: LimitsTable = LimitsTable()
    collisions: bool = True
    scene: SceneTable | None = None

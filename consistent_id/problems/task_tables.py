"""Tables of a problem file, each for one task.

``[excitation]`` is the motion to design and its limits; writing tasks and a laboratory
are simulated; base, contacts and wrench sensors are measurements beside the joints.
"""

from collections.abc import Sequence
from dataclasses import fields
from typing import Annotated, Any, Literal

import msgspec
import numpy as np
from msgspec import Meta

from consistent_id._support.arrays import Vector
from consistent_id.problems.parameter_tables import (
    FileTable,
    NonNegative,
    Pair,
    Positive,
)
from consistent_id.recordings.readers.beside_columns import (
    BaseColumns,
    BesideColumns,
    ContactColumns,
    WrenchColumns,
)

ALWAYS = "always"
"""Word in place of a contact's column: the robot stands on that foot all the time."""

Names = str | list[str]
Three = tuple[float, float, float]
Four = Annotated[list[float], Meta(min_length=4, max_length=4)]


class BaseTable(FileTable, frozen=True, kw_only=True):
    """Columns of a floating base: of an inertial measurement unit, or of its pose."""

    angular_velocity: Names | None = None
    acceleration: Names | None = None
    position: Names | None = None
    orientation: Names | None = None
    order: Literal["xyzw", "wxyz"] = "xyzw"
    imu_position: Three = (0.0, 0.0, 0.0)
    imu_orientation: Four | None = None


class ContactTable(FileTable, frozen=True, kw_only=True):
    """A contact of the robot, and the column of its flag.

    If it stands on the foot all the time, `closed` is true.  Samples closer than the
    guard [s] to a change are left out.
    """

    frame: str
    closed: str | bool
    threshold: float = 0.5
    guard: NonNegative = 0.05
    point: Three = (0.0, 0.0, 0.0)
    surface: bool = False
    radius: NonNegative = 0.0


class WrenchTable(FileTable, frozen=True, kw_only=True):
    """Columns of a measured force, or of a force and a moment."""

    frame: str
    values: Names
    on_robot: bool = True
    point: Three = (0.0, 0.0, 0.0)
    axes: Literal["frame", "base", "world"] = "frame"


class WristSensorTable(FileTable, frozen=True, kw_only=True):
    """A wrench sensor whose tool or payload is identified, with its bias."""

    frame: str
    tool: str = "tool"
    bias: bool = True
    drift: Literal["none", "recordings", "linear"] = "none"


def beside_columns(
    base: BaseTable | None,
    contacts: Sequence[ContactTable],
    wrenches: Sequence[WrenchTable],
) -> BesideColumns:
    """Return the columns that tables name."""
    return BesideColumns(
        None if base is None else _base_columns(base),
        tuple(ContactColumns(**_values(table)) for table in contacts),
        tuple(WrenchColumns(**_values(table)) for table in wrenches),
    )


def _base_columns(table: BaseTable) -> BaseColumns:
    turned = table.imu_orientation
    values = _values(table) | {
        "imu_orientation": None if turned is None else tuple(turned)
    }
    return BaseColumns(**values)


def _values(table: FileTable) -> dict[str, Any]:
    """Return the fields, points as arrays."""
    named = msgspec.structs.asdict(table)
    return {k: np.array(v) if isinstance(v, tuple) else v for k, v in named.items()}


def beside_tables(columns: BesideColumns) -> dict[str, Any]:
    """Return the tables of `[data]` that name columns: ``base``, ``contacts``, ..."""
    base = columns.base
    return {
        "base": None if base is None else BaseTable(**_plain(base)),
        "contacts": [ContactTable(**_plain(c)) for c in columns.contacts],
        "wrenches": [WrenchTable(**_plain(w)) for w in columns.wrenches],
    }


def _plain(value: BaseColumns | ContactColumns | WrenchColumns) -> dict[str, Any]:
    """Return the fields, arrays and tuples as a file has them."""
    named = {field.name: getattr(value, field.name) for field in fields(value)}
    return {
        name: _numbers(v) if isinstance(v, np.ndarray) else _listed(v)
        for name, v in named.items()
    }


def _numbers(values: Vector) -> tuple[float, ...]:
    """Return numbers rounded to what a file should show."""
    return tuple(float(f"{v:.9g}") for v in values)


def _listed(value: object) -> object:
    return list(value) if isinstance(value, tuple) else value


class PenTable(FileTable, frozen=True, kw_only=True):
    """The common keys of writing tasks: the point that writes, times, the pose.

    The point is fixed in a frame; joints that are not named are locked.
    """

    frame: str
    point: Three = (0.0, 0.0, 0.0)
    joints: list[str] = []
    start: list[float] | None = None
    duration: Positive
    rate: Positive
    law: Literal["quintic", "septic", "cycloidal"] = "quintic"


class OutlineTable(PenTable, frozen=True, kw_only=True):
    """A curve about a centre, in the plane of two directions."""

    centre: Three
    along: Three = (1.0, 0.0, 0.0)
    across: Three = (0.0, 1.0, 0.0)
    turns: Positive = 1.0


class CircleTable(
    OutlineTable, frozen=True, kw_only=True, tag="circle", tag_field="shape"
):
    """See `curves.circle`."""

    radius: Positive


class EllipseTable(
    OutlineTable, frozen=True, kw_only=True, tag="ellipse", tag_field="shape"
):
    """See `curves.ellipse`."""

    semi_axes: Pair


class BulbTable(OutlineTable, frozen=True, kw_only=True, tag="bulb", tag_field="shape"):
    """See `curves.bulb`."""

    semi_axes: Pair
    taper: Annotated[float, Meta(ge=0.0, lt=1.0)] = 0.5


class SpiralTable(
    OutlineTable, frozen=True, kw_only=True, tag="ellipsoid", tag_field="shape"
):
    """See `curves.ellipsoid`."""

    semi_axes: Three
    latitude_deg: Annotated[float, Meta(gt=0.0, le=90.0)] = 60.0


class HelixTable(
    OutlineTable, frozen=True, kw_only=True, tag="helix", tag_field="shape"
):
    """See `curves.helix`."""

    radius: Positive
    height: Positive


class PointsTable(PenTable, frozen=True, kw_only=True, tag="points", tag_field="shape"):
    """See `curves.through_points`."""

    points: Annotated[list[Three], Meta(min_length=3)]
    closed: bool = False


TaskTable = (
    CircleTable | EllipseTable | BulbTable | SpiralTable | HelixTable | PointsTable
)

Each = NonNegative | list[NonNegative]  # one for all joints, or one each


class FrictionTable(FileTable, frozen=True, kw_only=True):
    """Friction of the laboratory's robot; see `laboratory.with_friction`."""

    viscous: Each = 0.0
    coulomb: Each = 0.0
    velocity_scale: Positive = 0.02


class ControllerTable(FileTable, frozen=True, kw_only=True):
    """See `laboratory.Controller`; `error` is the relative error of its model."""

    bandwidth: Positive = 5.0
    damping: Positive = 1.0
    rate_cutoff: Positive = 60.0
    error: Annotated[float, Meta(ge=0.0, lt=1.0)] = 0.0


class EncodersTable(FileTable, frozen=True, kw_only=True):
    """See `laboratory.Encoders`."""

    step: Each = 0.0


class LoadCellTable(FileTable, frozen=True, kw_only=True):
    """See `laboratory.LoadCell`."""

    noise: Each = 0.0
    offset: float | list[float] = 0.0


class CamerasTable(FileTable, frozen=True, kw_only=True):
    """See `laboratory.Cameras`."""

    rate: Positive
    delay: float = 0.0
    drift: float = 0.0
    position_noise: Each = 0.0
    acceleration_noise: Each = 0.0


class LaboratoryTable(FileTable, frozen=True, kw_only=True):
    """Experiments on a robot with known parameters; the preparation of their logs."""

    experiments: Annotated[list[str], Meta(min_length=1)]
    cutoff: Positive
    cameras: CamerasTable
    verification: list[str] = []
    trim: NonNegative = 0.0
    seed: Annotated[int, Meta(ge=0)] = 0
    substeps: Annotated[int, Meta(ge=1)] = 2
    friction: FrictionTable = FrictionTable()
    controller: ControllerTable = ControllerTable()
    encoders: EncodersTable = EncodersTable()
    load_cell: LoadCellTable = LoadCellTable()


CLEARANCE = 0.02
"""Least distance of any two bodies, unless another one is stated [m]."""

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
    """A ball about the body's position; in m, like all shapes below."""

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
    """A body on a link of the robot, or an obstacle if no link is named.

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
    """Bodies that must not touch: those of the robot, and obstacles."""

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

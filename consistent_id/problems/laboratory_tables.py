"""The problem file's tables of writing tasks and of the laboratory."""

from typing import Annotated, Literal

from msgspec import Meta

from consistent_id.problems.parameter_tables import (
    FileTable,
    NonNegative,
    Pair,
    Positive,
    Three,
)


class PenTable(FileTable, frozen=True, kw_only=True):
    """The common keys of writing tasks: the point that writes, times, the pose.

    The point is fixed in a frame; joints that are not named are locked.
    """

    frame: str
    point: tuple[float, float, float] = (0.0, 0.0, 0.0)
    joints: list[str] = []
    start: list[float] | None = None
    duration: Positive
    rate: Positive
    law: Literal["quintic", "septic", "cycloidal"] = "quintic"


class OutlineTable(PenTable, frozen=True, kw_only=True):
    """A curve about a centre, in the plane of two directions."""

    centre: Three
    along: tuple[float, float, float] = (1.0, 0.0, 0.0)
    across: tuple[float, float, float] = (0.0, 1.0, 0.0)
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
    """See `laboratory.Controller`; `error` is the share by which its belief is off."""

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
    """Experiments on a robot of known parameters, and how their logs are prepared."""

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

"""The ``[excitation]`` table of a problem file: what motion to design, within what."""

from typing import Annotated, Literal

from msgspec import Meta

from consistent_id.file_tables import Pair, Positive, Table

PerJoint = Positive | list[Positive] | dict[str, Positive]


class LimitsTable(Table, frozen=True, kw_only=True):
    """Limits in place of the robot file's; one for all joints, or by name."""

    position: dict[str, Pair] = {}
    velocity: PerJoint | None = None
    acceleration: PerJoint | None = None
    jerk: PerJoint | None = None
    effort: PerJoint | None = None
    share: Annotated[float, Meta(gt=0.0, le=1.0)] = 1.0


class ExcitationTable(Table, frozen=True, kw_only=True):
    """Form, aim and limits of an exciting trajectory."""

    duration: Positive = 10.0
    harmonics: Annotated[int, Meta(ge=1)] = 5
    base_frequencies: list[Positive] | None = None
    rest: bool = True
    periods: Annotated[int, Meta(ge=1)] = 1
    objective: Literal["condition", "D", "A", "E"] = "condition"
    refine: Literal["D", "A", "E", "none"] = "D"
    growth: Annotated[float, Meta(ge=1.0)] = 1.5
    scaling: Literal["none", "unit columns"] = "none"
    noise: PerJoint | None = None
    rate: Positive = 100.0
    start_pose: dict[str, float] = {}
    limits: LimitsTable = LimitsTable()

"""The problem file: ``problem.toml`` decoded into typed values, without unknown keys.

One struct per table of the file; `problem.load_problem` turns them into a problem.
"""

from pathlib import Path
from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from consistent_id._support.files import (
    LARGEST_PROBLEM,
    MOST_DOTS,
    MOST_KEYS,
    read_input,
    require_count,
)
from consistent_id.errors import ProblemError
from consistent_id.problems.parameter_tables import (
    ConstraintsTable,
    FileTable,
    NonNegative,
    Pair,
    Positive,
    PriorTable,
    Three,
)
from consistent_id.problems.parameter_tables import DriveTable as DriveTable
from consistent_id.problems.parameter_tables import JointTable as JointTable
from consistent_id.problems.task_tables import (
    BaseTable,
    ContactTable,
    ExcitationTable,
    LaboratoryTable,
    TaskTable,
    WrenchTable,
    WristSensorTable,
)
from consistent_id.recordings.log_formats import LOG_FORMATS

_ROBOTS = (".urdf", ".xml", ".mjcf", ".xacro")


class DHTable(FileTable, frozen=True, kw_only=True):
    """One row of Denavit-Hartenberg parameters; angles in degrees."""

    alpha_deg: float
    a: float
    d: float = 0.0
    theta_deg: float = 0.0
    kind: Literal["revolute", "continuous", "prismatic"] = "revolute"
    lower: float | None = None
    upper: float | None = None
    velocity: Positive | None = None
    effort: Positive | None = None


class ModelTable(FileTable, frozen=True, kw_only=True):
    """The robot: a URDF or MJCF file, or a DH table, and the part of it that moves."""

    urdf: str | None = None
    mjcf: str | None = None
    modified_dh: list[DHTable] = []
    classical_dh: list[DHTable] = []
    gravity: tuple[float, float, float] | None = None
    base: str | None = None
    tip: str | None = None
    joints: Annotated[list[str], Meta(min_length=1)] | None = None
    locked: dict[str, float] = {}


class LinkTable(FileTable, frozen=True, kw_only=True):
    """A link's datasheet."""

    mass: NonNegative | None = None
    mass_bounds: Pair | None = None
    com: Three | None = None
    com_box: Annotated[list[Three], Meta(min_length=2, max_length=2)] | None = None


class PayloadTable(LinkTable, frozen=True, kw_only=True):
    """The robot's payload, and its datasheet in the carrier's frame."""

    link: str


class CouplingTable(FileTable, frozen=True, kw_only=True):
    """Terms of two joints whose gears are coupled."""

    first: str
    second: str
    viscous: bool = False
    coulomb: Literal["sign", "tanh", "none"] = "none"
    velocity_scale: Positive | None = None
    rotor_inertia: bool = False


class ColumnsTable(FileTable, frozen=True, kw_only=True):
    """Names of the columns in the recordings."""

    time: str = "time"
    position: str = "q_{joint}"
    velocity: str | None = None
    acceleration: str | None = None
    torque: str | None = None
    position_command: str | None = None
    velocity_command: str | None = None
    torque_command: str | None = None
    names: dict[str, str] = {}
    array_joints: list[str] = []


class PreparationTable(FileTable, frozen=True, kw_only=True):
    """The preparation of each recording, in this order."""

    max_gap: Positive | None = None
    shortest_part: NonNegative | None = None
    resample: Positive | None = None
    delays: dict[
        Literal["position", "velocity", "acceleration", "torque"],
        float | Literal["estimated"],
    ] = {}
    torque_cutoff: Positive | None = None
    method: Literal["butterworth", "savitzky-golay", "smoother", "fourier"] = (
        "butterworth"
    )
    motion_cutoff: Positive | None = None
    window: Positive | None = None
    degree: Annotated[int, Meta(ge=2)] | None = None
    order: Annotated[int, Meta(ge=3, le=6)] | None = None
    period: Positive | Literal["estimated"] | None = None
    harmonics: Annotated[int, Meta(ge=1)] | None = None
    decimate: Annotated[int, Meta(ge=1)] = 1
    trim_standstill: bool | Positive = False
    least_speed: Annotated[float, Meta(gt=0.0, lt=1.0)] | None = None
    least_joint_speed: Positive | Literal["estimated"] | None = None
    most_joint_speed: Positive | Literal["model"] | None = None
    contact_radius: Literal["estimated"] | None = None
    most_slip: Positive | None = None


class TrackTable(FileTable, frozen=True, kw_only=True):
    """A channel of a recording in a separate file."""

    file: str
    channel: Literal["velocity", "acceleration", "torque"]
    column: str
    time: str = "time"
    delay: float | Literal["estimated"] = 0.0


class RecordingTable(FileTable, frozen=True, kw_only=True):
    """One recording and its part in the study.

    Rows are counted from 1, in the order of the file.  The first and the last are
    included; omitted rows are not.
    """

    file: str
    role: Literal["training", "validation"]
    rows: Annotated[list[int], Meta(min_length=2, max_length=2)] | None = None
    omit: list[int] = []
    tracks: list[TrackTable] = []


class GainsTable(FileTable, frozen=True, kw_only=True):
    """Gains of PD-controlled joints: one for all, or one each in the robot's order.

    With them torque is computed from the joints' commands, delayed by `delay` [s], the
    standard error of which is `delay_error`; one that is estimated has its own.  The
    real torque is `scale` times this torque, and encoders read the position plus
    `encoder_bias` [rad or m]; both are numbers, or estimated from the training data.
    If a `stiffness` [N m/rad or N/m] is given, there are springs between the motors,
    where the encoders are, and the links.
    """

    kp: NonNegative | list[NonNegative]
    kd: NonNegative | list[NonNegative] = 0.0
    torque_limit: Positive | list[Positive] | None = None
    delay: NonNegative | Literal["estimated"] = 0.0
    delay_error: NonNegative = 0.0
    scale: Positive | list[Positive] | Literal["estimated"] = 1.0
    encoder_bias: float | list[float] | Literal["estimated"] = 0.0
    stiffness: Positive | list[Positive] | Literal["estimated"] | None = None


class DataTable(FileTable, frozen=True, kw_only=True):
    """Recordings of a real robot."""

    recordings: Annotated[list[RecordingTable], Meta(min_length=1)]
    folder: str = "."
    columns: ColumnsTable | None = None
    units: dict[str, str | list[str]] = {}
    topic: str | None = None
    duplicates: Literal["refuse", "first", "last"] = "refuse"
    missing: Literal["refuse", "omit"] = "refuse"
    wraps: Literal["keep", "undo"] = "keep"
    position_scale: dict[str, float] = {}
    position_offset: dict[str, float] = {}
    coupled: dict[str, str] = {}
    torque_gain: float | list[float] = 1.0
    gain_source: Literal["drives", "model"] = "drives"
    torque_joints: list[str] = []
    base: BaseTable | None = None
    contacts: list[ContactTable] = []
    wrenches: list[WrenchTable] = []
    gains: GainsTable | None = None
    preparation: PreparationTable = PreparationTable()


class SinusoidTable(FileTable, frozen=True, kw_only=True):
    """One term of a joint's motion."""

    amplitude: float | Pair
    frequency: NonNegative
    phase_deg: float = 0.0


class MotionTable(FileTable, frozen=True, kw_only=True):
    """A motion given by formulas."""

    duration: Positive
    rate: Positive
    joints: list[list[SinusoidTable]]


class SimulationTable(FileTable, frozen=True, kw_only=True):
    """A simulated experiment with the consistent robot nearest to the published one."""

    training: str
    validation: str
    noise: NonNegative | list[NonNegative]
    seed: Annotated[int, Meta(ge=0)] = 0


class CombinationTable(FileTable, frozen=True, kw_only=True):
    """One combination of a published parametrisation."""

    name: str
    meaning: str
    unit: str
    terms: dict[str, float]
    effect: Literal["inertia", "gravity"] = "inertia"


class PublishedTable(FileTable, frozen=True, kw_only=True):
    """A paper's printed results: its combinations, its experiments, its tables."""

    source: str
    motion: str
    combinations: list[CombinationTable]
    experiments: list[list[float]]
    fixed: list[str] = []
    zero: list[str] = []
    mean: list[float] = []
    standard_deviation: list[float] = []
    central_inertia: dict[str, list[float]] = {}
    mean_squared_errors: list[list[float]] = []
    notes: list[str] = []
    decimals: int = 4


class ProblemTable(FileTable, frozen=True, kw_only=True):
    """The whole file."""

    name: Annotated[str, Meta(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*$")]
    model: ModelTable
    description: str = ""
    source: str = ""
    licence: str = ""
    links: dict[str, LinkTable] = {}
    payload: PayloadTable | None = None
    drive: DriveTable = DriveTable()
    joints: dict[str, JointTable] = {}
    couplings: list[CouplingTable] = []
    wrist_sensor: WristSensorTable | None = None
    constraints: ConstraintsTable = ConstraintsTable()
    prior: PriorTable = PriorTable()
    data: DataTable | None = None
    motions: dict[str, MotionTable] = {}
    tasks: dict[str, TaskTable] = {}
    laboratory: LaboratoryTable | None = None
    simulation: SimulationTable | None = None
    published: PublishedTable | None = None
    excitation: ExcitationTable = ExcitationTable()


def read_problem_table(path: Path) -> ProblemTable:
    """Decode a problem file.

    Raises
    ------
    ProblemError
        If it cannot be read or does not fit; with the path of the faulty key.
    """
    if path.suffix.lower() in _ROBOTS:
        raise ProblemError(
            f"{path} is a robot's file, expected a problem's. Name it in the [model] "
            "of a problem.toml, which consistent-id init writes, or give a log beside "
            f"it, as in consistent-id identify {path} LOG; so do check, compare, "
            "report, export, payload, gains and rollout"
        )
    if any(path.suffix.lower() in known.suffixes for known in LOG_FORMATS):
        raise ProblemError(
            f"{path} is a log, expected a problem file. Give a robot before it: "
            f"consistent-id identify ROBOT.urdf {path} (check and init likewise)"
        )
    text = read_input(path, ProblemError, LARGEST_PROBLEM)
    require_count(path, text.count(b"="), MOST_KEYS, "keys", ProblemError)
    dots = max((_key(line).count(b".") for line in text.splitlines()), default=0)
    require_count(path, dots, MOST_DOTS, "dots in a key", ProblemError)
    return problem_table(text, path)


def _key(line: bytes) -> bytes:
    """Return the key or the table's name in a line, if there is one."""
    key, equals, _ = line.partition(b"=")
    return key if equals or b"," not in line else b""  # numbers have commas


def problem_table(text: str | bytes, path: Path) -> ProblemTable:
    """Decode the text of a problem file; the path is for messages.

    Raises
    ------
    ProblemError
        If it does not fit; with the path of the faulty key.
    """
    try:
        return msgspec.toml.decode(text, type=ProblemTable)
    except msgspec.ValidationError as cause:
        from consistent_id.problems.file_faults import fault_of

        written = text if isinstance(text, str) else text.decode()
        fault = fault_of(str(cause), written, ProblemTable)
        raise ProblemError(f"{path}, {fault}") from None
    except (msgspec.DecodeError, UnicodeDecodeError) as cause:
        raise ProblemError(f"{path}: not TOML: {cause}") from None
    except RecursionError:
        raise ProblemError(
            f"{path}: arrays or tables nested too deeply; no problem file needs that"
        ) from None

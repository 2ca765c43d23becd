"""A problem file for a robot and logs that have none; guesses are marked as such."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import msgspec

from consistent_id._support.files import relative_path
from consistent_id._support.tables import Table, brief
from consistent_id.problems.file import (
    ColumnsTable,
    DataTable,
    DriveTable,
    JointTable,
    PreparationTable,
    ProblemTable,
    RecordingTable,
)
from consistent_id.problems.floating.floating_draft import StandingDraft
from consistent_id.problems.kept_text import one_line, problem_name, toml_text
from consistent_id.problems.loading import problem_of
from consistent_id.problems.log_entries import gains_table
from consistent_id.problems.parameter_tables import ConstraintsTable
from consistent_id.problems.problem import Problem
from consistent_id.problems.selection.model_selection import ModelSelection
from consistent_id.problems.stated_model import (
    DEFAULT_DRIVE,
    excitation_table,
    model_table,
)
from consistent_id.problems.statement import Statement
from consistent_id.problems.task_tables import beside_tables
from consistent_id.recordings.readers.columns import Columns
from consistent_id.recordings.recording import Recording

Role = Literal["training", "validation"]


@dataclass(frozen=True, slots=True)
class DraftRecording:
    """Rows of a log, and their role.

    Parameters
    ----------
    role : {"training", "validation"}
    rows : tuple of int
        First and last, from 1.
    """

    log: Path
    role: Role
    rows: tuple[int, int]


@brief
@dataclass(frozen=True, slots=True)
class Draft:
    """The content of a problem file that is to be written, and the reasons for it.

    Parameters
    ----------
    model : Path
    recordings : tuple of DraftRecording
        Those for training first.
    stated : Statement
        The user's statement.
    joints : tuple of str
        Joints that move.
    held : dict of str to float
        Locked joints between base and tip, and their positions [rad or m].
    columns : Columns
    rate : float, [Hz]
        The sampling rate of the log.
    resample, max_gap : float, optional, [Hz], [s]
    cutoff : float, [Hz]
        The cut-off frequency of motion and torque.
    cutoff_reason : str
    masses : {"datasheet", "free"}
    raw : mapping of Path to Recording
        The logs, as they were read.
    notes : tuple of str
        Notes on other guesses.
    drive : DriveTable
        Drive terms of all joints, if no model was selected.
    joint_drives : mapping of str to JointTable
        Exceptions for some joints.
    selection : ModelSelection, optional
        The model selected from the training rows.
    delay : float or "estimated", [s]
        Delay of the commands of PD-controlled joints.
    delay_error : float, [s]
        Its standard error.
    standing : StandingDraft, optional
        Assumptions for a robot whose base floats.
    early : float, [s]
        Time by which the position is ahead of velocity and torque.
    """

    model: Path
    recordings: tuple[DraftRecording, ...]
    stated: Statement
    joints: tuple[str, ...]
    held: Mapping[str, float]
    columns: Columns
    rate: float
    resample: float | None
    max_gap: float | None
    cutoff: float
    cutoff_reason: str
    masses: Literal["datasheet", "free"]
    raw: Mapping[Path, Recording]
    notes: tuple[str, ...] = ()
    drive: DriveTable = DEFAULT_DRIVE
    joint_drives: Mapping[str, JointTable] = field(default_factory=dict)
    selection: ModelSelection | None = None
    delay: float | Literal["estimated"] = 0.0
    delay_error: float = 0.0
    standing: StandingDraft | None = None
    early: float = 0.0

    @property
    def bodies(self) -> Literal["identified", "model"]:
        """Whether bodies are identified, or taken from the model."""
        return self.stated.bodies or "identified"

    @property
    def locked(self) -> tuple[str, ...]:
        """Joints between base and tip that are locked."""
        return tuple(self.held)

    @property
    def log(self) -> Path:
        """The first training log."""
        return self.recordings[0].log

    @property
    def training(self) -> tuple[int, int]:
        """The first log's training rows: first and last, from 1."""
        return self.recordings[0].rows

    @property
    def validation(self) -> tuple[int, int]:
        """The validation rows of the first log with such rows."""
        return next(r.rows for r in self.recordings if r.role == "validation")

    @property
    def name(self) -> str:
        """The problem's name: the first log's, in letters that a name may have."""
        return problem_name(self.log)

    def table(self, folder: Path) -> ProblemTable:
        """Return the content of the problem file, for a file in a folder."""
        plain = self._plain(folder)
        return plain if self.selection is None else self.selection.applied(plain)

    def _plain(self, folder: Path) -> ProblemTable:
        """Return the content without the selected model."""
        return ProblemTable(
            name=self.name,
            model=model_table(self.model, folder, self.stated, locked=self.held),
            drive=self.drive,
            joints=dict(self.joint_drives),
            constraints=self._constraints,
            data=self._data(folder),
            excitation=excitation_table(self.stated, folder),
        )

    def _data(self, folder: Path) -> DataTable:
        columns = msgspec.structs.asdict(ColumnsTable())
        columns = {key: getattr(self.columns, key) for key in columns}
        columns["array_joints"] = list(self.columns.array_joints)
        stated, gains = self.stated, self.stated.gains
        gain = list(stated.torque_gain) or [1.0]
        return DataTable(
            recordings=[
                RecordingTable(
                    file=relative_path(entry.log, folder),
                    role=entry.role,
                    rows=list(entry.rows),
                    omit=list(stated.omitted_of(entry.log)),
                )
                for entry in self.recordings
            ],
            columns=ColumnsTable(**columns),
            units={
                channel: unit if isinstance(unit, str) else list(unit)
                for channel, unit in self.columns.units.items()
            },
            topic=stated.topic,
            duplicates=stated.duplicates or "refuse",
            missing=stated.missing or "refuse",
            wraps=stated.wraps or "keep",
            position_scale=dict(stated.position_scale or {}),
            position_offset=dict(stated.position_offset or {}),
            coupled=dict(stated.coupled or {}),
            torque_gain=gain if len(gain) > 1 else gain[0],
            gain_source=stated.gain_source or "drives",
            torque_joints=list(self.columns.torque_joints),
            **beside_tables(self.columns.beside),
            gains=None
            if gains is None
            else gains_table(gains, self.delay, self.delay_error),
            preparation=self._preparation,
        )

    @property
    def _preparation(self) -> PreparationTable:
        standing = self.standing
        delays = PreparationTable().delays.copy()
        if self.early:
            delays["position"] = -self.early
        if standing is not None and standing.late_torque:
            delays["torque"] = "estimated"
        return PreparationTable(
            max_gap=self.max_gap,
            resample=self.resample,
            motion_cutoff=self.cutoff,
            torque_cutoff=self.cutoff,
            delays=delays,
            most_joint_speed=self.stated.most_joint_speed,
            **(standing.preparation if standing else {}),
        )

    @property
    def _constraints(self) -> ConstraintsTable:
        standing = self.standing
        return ConstraintsTable(
            bodies=self.stated.bodies,
            masses=self.masses,
            known_links=list(standing.known_links) if standing else [],
            fixed=dict(standing.rotors) if standing else {},
            drive_signs="dissipative",
        )

    def problem(self, folder: str | Path | None = None) -> Problem:
        """Return the problem itself, without a file of its own."""
        folder = Path.cwd() if folder is None else Path(folder)
        read = {relative_path(file, folder): raw for file, raw in self.raw.items()}
        return problem_of(self.table(folder), folder / "problem.toml", read=read)

    def text(self, folder: Path, *, accepted: Sequence[str] = ()) -> str:
        """Return the text of the problem file, for a file in a folder.

        Parameters
        ----------
        folder : Path
        accepted : sequence of str
            Kinds of findings that the user accepted; a comment lists them.
        """
        names = f"{self.model.name} and {self.log_names}"
        head = (
            f"# Drafted from {one_line(names)}. A comment that\n"
            "# begins with GUESS marks a setting that neither states: check it.\n\n"
        )
        if accepted:
            head += f"# Accepted in spite of the verdict: {', '.join(accepted)}.\n\n"
        return head + toml_text(self.table(folder), comments_of(self))

    @property
    def log_names(self) -> str:
        """Names of the logs' files."""
        return ", ".join(dict.fromkeys(entry.log.name for entry in self.recordings))


DRIVE_COMMENTS = {
    "drive": "GUESS: viscous friction, Coulomb friction, a constant offset.\n"
    "rotor_inertia = true adds the rotors of geared motors.",
    "drive.velocity_scale": "GUESS [rad/s or m/s]: width of the sign change",
}
"""Comments on a drive whose terms are unknown."""

_GAINS_COMMENTS = {
    "data.gains": "GUESS: the delay [s] with which the torque fits best, at most\n"
    "one sample; consistent-id rollout finds a better one.",
    "data.gains.delay": "",
    "data.gains.delay_error": "standard error; intervals contain what it does",
}
ONE_SAMPLE = 0.99
"""Share of a period from which on a delay is one: clocks are not exact."""

_LONGEST_DELAY = (
    "GUESS: the torque fits best with the longest delay that is tried, one sample;\n"
    "commands may be later: consistent-id rollout finds the delay."
)


def comments_of(draft: "Draft") -> dict[str, str]:
    """Return the comments of a draft's problem file, by key."""
    comments = {
        "model": f"{_held_sentence(draft)}Joints: {', '.join(draft.joints)}.",
        **DRIVE_COMMENTS,
        **_of_constraints(draft),
        "data": _of_roles(draft),
        **_of_columns(draft),
        **_GAINS_COMMENTS,
        **_of_preparation(draft),
    }
    if draft.delay != "estimated" and draft.delay * draft.rate > ONE_SAMPLE:
        comments["data.gains"] = _LONGEST_DELAY
    if draft.standing is not None:
        comments |= draft.standing.comments
    if draft.selection is None:
        return comments
    if draft.selection.choice.masses != draft.masses:
        del comments["constraints.masses"]
    del comments["drive.velocity_scale"]
    chosen = draft.selection.comments()
    chosen["data.preparation"] = f"{_rate(draft)}\n{chosen['data.preparation']}"
    return comments | chosen


def _of_constraints(draft: "Draft") -> dict[str, str]:
    if draft.bodies == "model":
        stated, masses = "bodies", ""
    elif draft.masses == "datasheet":
        stated, masses = "masses", '"free" if they are placeholders'
    else:
        stated, masses = "masses", "known masses improve the estimates"
    known = f"GUESS: the {stated} of {draft.model.name} are those of the robot."
    return {
        "constraints": known if draft.masses == "datasheet" else "",
        "constraints.masses": masses,
        "constraints.drive_signs": "drag may be negative up to the speed limit",
    }


def _of_roles(draft: "Draft") -> str:
    """Return the division of one log into training and validation, in words."""
    if len({entry.log for entry in draft.recordings}) == len(draft.recordings):
        return ""
    return (
        "The first 70 % of the motion are for training, or until each joint has moved; "
        "the rest is for validation."
    )


def _of_columns(draft: "Draft") -> dict[str, str]:
    rest = "units are rad, m, N m and N, as no name contradicts this"
    notes = (*draft.notes, f"other {rest}" if draft.columns.units else rest)
    return {
        "data.columns": "\n".join(f"GUESS: {note}." for note in notes),
        "data.columns.time": "",
        "data.columns.position": "",
    }


def _of_preparation(draft: "Draft") -> dict[str, str]:
    return {
        "data.preparation": f"{_rate(draft)}\nGUESS: {draft.cutoff_reason}.",
        "data.preparation.max_gap": "s; longest step between samples",
        "data.preparation.resample": "Hz; the time stamps jitter",
        "data.preparation.motion_cutoff": "Hz",
        "data.preparation.torque_cutoff": "Hz",
        "data.preparation.most_joint_speed": "rows of faster joints are left out",
    }


def _rate(draft: "Draft") -> str:
    return f"The log has {draft.rate:.6g} samples a second."


def _held_sentence(draft: "Draft") -> str:
    """Return the joints that do not move, in words."""
    where, joints = _held(draft)
    return f"{where.capitalize()}: {joints}.\n" if draft.held else ""


def _held(draft: "Draft") -> tuple[str, str]:
    """Return the locked joints, with their positions if not zero, in words."""
    if not any(draft.held.values()):
        return "locked at zero", ", ".join(draft.held)
    return "locked", ", ".join(f"{k} at {v:g}" for k, v in draft.held.items())


def draft_table(draft: "Draft") -> Table:
    """Return the settings from the files, and the guesses, as a table."""
    columns = draft.columns
    channels = ("time", "position", "velocity", "torque", "position_command")
    named = ((c, getattr(columns, c)) for c in channels)
    units = ", ".join(
        f"{channel}: {unit if isinstance(unit, str) else ', '.join(unit)}"
        for channel, unit in columns.units.items()
    )
    rows = [
        ("joints", ", ".join(draft.joints)),
        ("columns", ", ".join(f"{c}: {name}" for c, name in named if name is not None)),
        ("rate", f"{draft.rate:.6g} Hz" + ("; resampled" if draft.resample else "")),
        ("units", units or "s, rad, m, N m, N"),
        *(
            (f"rows of {entry.log.name}", f"{a} to {b} for {entry.role}")
            for entry in draft.recordings
            for a, b in (entry.rows,)
        ),
        ("cut-off", f"{draft.cutoff:g} Hz: {draft.cutoff_reason}"),
        _taken(draft),
        ("friction", "viscous, Coulomb (tanh), offset"),
    ]
    if draft.selection is not None:
        # The table of the selection has them.
        del rows[-3 if draft.bodies == "identified" else -1 :]
    if draft.held:
        rows.insert(1, _held(draft))
    unused = columns.position_command if draft.stated.gains is None else None
    commands = f"{unused} are not used: torque is computed from commands by --gains"
    return Table(
        f"How {draft.model.name} and {draft.log_names} were read",
        ("what", "which"),
        tuple(rows),
        (
            *draft.notes,
            *([] if unused is None else [commands]),
            "consistent-id init writes this to a problem file that you can correct",
        ),
    )


def _taken(draft: "Draft") -> tuple[str, str]:
    """Return the settings from the model, in words."""
    if draft.bodies == "model":
        return "bodies", "the model's"
    if draft.standing is not None:
        return "bodies", "the model's, except that of the base, which is free"
    return "masses", "the model's" if draft.masses == "datasheet" else "free"

"""A problem file for a robot and logs that have none; guesses are marked as such."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import msgspec

from consistent_id._support.files import relative_path
from consistent_id.problems.base_tables import beside_tables
from consistent_id.problems.constraint_tables import ConstraintsTable
from consistent_id.problems.draft_text import comments_of
from consistent_id.problems.file import (
    ColumnsTable,
    DataTable,
    DriveTable,
    JointTable,
    PreparationTable,
    ProblemTable,
    RecordingTable,
)
from consistent_id.problems.floating.standing_draft import StandingDraft
from consistent_id.problems.loading import problem_of
from consistent_id.problems.log_entries import gains_table
from consistent_id.problems.model import DEFAULT_DRIVE, model_table
from consistent_id.problems.problem import Problem
from consistent_id.problems.selection.selection import ModelSelection
from consistent_id.problems.toml_text import problem_name, toml_text
from consistent_id.recordings.readers.columns import Columns
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals import PDGains

Role = Literal["training", "validation"]


@dataclass(frozen=True, slots=True)
class DraftRecording:
    """Rows of a log, and what they are for.

    Parameters
    ----------
    role : {"training", "validation"}
    rows : tuple of int
        First and last, from 1.
    """

    log: Path
    role: Role
    rows: tuple[int, int]


@dataclass(frozen=True, slots=True)
class Draft:
    """The content of a problem file that is to be written, and the reasons for it.

    Parameters
    ----------
    model : Path
    recordings : tuple of DraftRecording
        Those for training first.
    joints : tuple of str
        Joints that move.
    held : dict of str to float
        Other joints between base and tip, and where they are held [rad or m].
    base, tip : str, optional
        Links between which the robot moves.
    columns : Columns
    torque_gain : tuple of float
        One for all joints, or one each; empty for 1.
    rate : float, [Hz]
        Of the log.
    resample, max_gap : float, optional, [Hz], [s]
    cutoff : float, [Hz]
        Of motion and torque.
    cutoff_reason : str
    masses : {"datasheet", "free"}
    raw : mapping of Path to Recording
        The logs, as they were read.
    notes : tuple of str
        What else was guessed.
    drive : DriveTable
        Of all joints, as long as no model was selected.
    joint_drives : mapping of str to JointTable
        What some joints have else.
    selection : ModelSelection, optional
        The model that the training rows ask for.
    gains : PDGains, optional
        Of PD-controlled joints.
    delay : float or "estimated", [s]
        By which their commands are late.
    bodies : {"identified", "model"}
        Whether bodies are identified, or those of the model are the robot's.
    standing : StandingDraft, optional
        What is taken for known of a robot whose base floats.
    """

    model: Path
    recordings: tuple[DraftRecording, ...]
    joints: tuple[str, ...]
    held: Mapping[str, float]
    base: str | None
    tip: str | None
    columns: Columns
    torque_gain: tuple[float, ...]
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
    gains: PDGains | None = None
    delay: float | Literal["estimated"] = 0.0
    bodies: Literal["identified", "model"] = "identified"
    standing: StandingDraft | None = None

    @property
    def locked(self) -> tuple[str, ...]:
        """Joints between base and tip that are held."""
        return tuple(self.held)

    @property
    def log(self) -> Path:
        """The first log to learn from."""
        return self.recordings[0].log

    @property
    def training(self) -> tuple[int, int]:
        """The first log's rows to learn from: first and last, from 1."""
        return self.recordings[0].rows

    @property
    def validation(self) -> tuple[int, int]:
        """The rows to judge by, of the first log that has some."""
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
        """Return the content without a model that was selected."""
        return ProblemTable(
            name=self.name,
            model=model_table(
                self.model, folder, base=self.base, tip=self.tip, locked=self.held
            ),
            drive=self.drive,
            joints=dict(self.joint_drives),
            constraints=self._constraints,
            data=self._data(folder),
        )

    def _data(self, folder: Path) -> DataTable:
        columns = msgspec.structs.asdict(ColumnsTable())
        columns = {key: getattr(self.columns, key) for key in columns}
        columns["array_joints"] = list(self.columns.array_joints)
        gain = list(self.torque_gain) or [1.0]
        return DataTable(
            recordings=[
                RecordingTable(
                    file=relative_path(entry.log, folder),
                    role=entry.role,
                    rows=list(entry.rows),
                )
                for entry in self.recordings
            ],
            columns=ColumnsTable(**columns),
            units={
                channel: unit if isinstance(unit, str) else list(unit)
                for channel, unit in self.columns.units.items()
            },
            torque_gain=gain if len(gain) > 1 else gain[0],
            torque_joints=list(self.columns.torque_joints),
            **beside_tables(self.columns.beside),
            gains=None if self.gains is None else gains_table(self.gains, self.delay),
            preparation=self._preparation,
        )

    @property
    def _preparation(self) -> PreparationTable:
        standing = self.standing
        return PreparationTable(
            max_gap=self.max_gap,
            resample=self.resample,
            motion_cutoff=self.cutoff,
            torque_cutoff=self.cutoff,
            **(standing.preparation if standing else {}),
        )

    @property
    def _constraints(self) -> ConstraintsTable:
        standing = self.standing
        return ConstraintsTable(
            bodies=self.bodies,
            masses=self.masses,
            known_links=list(standing.known_links) if standing else [],
            fixed=dict(standing.rotors) if standing else {},
        )

    def problem(self, folder: Path | None = None) -> Problem:
        """Return the problem itself, without a file of its own."""
        folder = Path.cwd() if folder is None else folder
        read = {relative_path(file, folder): raw for file, raw in self.raw.items()}
        return problem_of(self.table(folder), folder / "problem.toml", read=read)

    def text(self, folder: Path, *, accepted: Sequence[str] = ()) -> str:
        """Return the text of the problem file, for a file in a folder.

        Parameters
        ----------
        folder : Path
        accepted : sequence of str
            Kinds of findings that its user overlooked; a comment says so.
        """
        head = (
            f"# Drafted from {self.model.name} and {self.log_names}. A comment that\n"
            "# begins with GUESS marks what neither of them states: check it.\n\n"
        )
        if accepted:
            head += f"# Accepted in spite of the verdict: {', '.join(accepted)}.\n\n"
        return head + toml_text(self.table(folder), comments_of(self))

    @property
    def log_names(self) -> str:
        """Names of the logs' files."""
        return ", ".join(dict.fromkeys(entry.log.name for entry in self.recordings))

"""A problem file for a robot and logs that have none; guesses are marked as such."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import msgspec

from consistent_id._support.files import relative_path
from consistent_id._support.tables import Table
from consistent_id.problems.base_tables import beside_tables
from consistent_id.problems.file import (
    ColumnsTable,
    ConstraintsTable,
    DataTable,
    DriveTable,
    JointTable,
    ModelTable,
    PreparationTable,
    ProblemTable,
    RecordingTable,
)
from consistent_id.problems.floating.standing_draft import StandingDraft
from consistent_id.problems.log_entries import gains_table
from consistent_id.problems.model import DEFAULT_DRIVE
from consistent_id.problems.problem import Problem, problem_of
from consistent_id.problems.selection.selection import ModelSelection
from consistent_id.problems.toml_text import toml_text
from consistent_id.recordings.readers.columns import Columns
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals import PDGains
from consistent_id.robot.loaders.robot_file import is_mjcf

Role = Literal["training", "validation"]


@dataclass(frozen=True, slots=True)
class DraftRecording:
    """Rows of a log, and what they are for.

    Parameters
    ----------
    log : Path
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
        kept = "".join(c if c.isascii() and c.isalnum() else "-" for c in self.log.stem)
        return kept.strip("-") or "problem"

    def table(self, folder: Path) -> ProblemTable:
        """Return the content of the problem file, for a file in a folder."""
        plain = self._plain(folder)
        return plain if self.selection is None else self.selection.applied(plain)

    def _plain(self, folder: Path) -> ProblemTable:
        """Return the content without a model that was selected."""
        mjcf = is_mjcf(self.model)
        model = relative_path(self.model, folder).replace("$", "$$")
        columns = msgspec.structs.asdict(ColumnsTable())
        columns = {key: getattr(self.columns, key) for key in columns}
        columns["array_joints"] = list(self.columns.array_joints)
        gain = list(self.torque_gain) or [1.0]
        standing = self.standing
        return ProblemTable(
            name=self.name,
            model=ModelTable(
                urdf=None if mjcf else model,
                mjcf=model if mjcf else None,
                base=self.base,
                tip=self.tip,
                locked=dict(self.held),
            ),
            drive=self.drive,
            joints=dict(self.joint_drives),
            constraints=self._constraints,
            data=DataTable(
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
                gains=None
                if self.gains is None
                else gains_table(self.gains, self.delay),
                preparation=PreparationTable(
                    max_gap=self.max_gap,
                    resample=self.resample,
                    motion_cutoff=self.cutoff,
                    torque_cutoff=self.cutoff,
                    **({} if standing is None else standing.preparation),
                ),
            ),
        )

    @property
    def _constraints(self) -> ConstraintsTable:
        if self.standing is None:
            return ConstraintsTable(bodies=self.bodies, masses=self.masses)
        return ConstraintsTable(
            bodies=self.bodies,
            masses=self.masses,
            known_links=list(self.standing.known_links),
            fixed=dict(self.standing.rotors),
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
            f"# Drafted from {self.model.name} and {self._names}. A comment that\n"
            "# begins with GUESS marks what neither of them states: check it.\n\n"
        )
        if accepted:
            head += f"# Accepted in spite of the verdict: {', '.join(accepted)}.\n\n"
        return head + toml_text(self.table(folder), self._comments)

    @property
    def _names(self) -> str:
        return ", ".join(dict.fromkeys(entry.log.name for entry in self.recordings))

    @property
    def _locked(self) -> tuple[str, str]:
        """Say which joints are held, and where if not at zero."""
        if not any(self.held.values()):
            return "locked at zero", ", ".join(self.held)
        return "locked", ", ".join(f"{k} at {v:g}" for k, v in self.held.items())

    @property
    def _is_split(self) -> bool:
        """Whether one log is for both, training and validation."""
        return len({entry.log for entry in self.recordings}) < len(self.recordings)

    @property
    def _comments(self) -> dict[str, str]:
        held = f"{self._locked[0].capitalize()}: {self._locked[1]}.\n"
        rest = "units are rad, m, N m and N, as no name contradicts this"
        masses = {
            "datasheet": '"free" if they are made up',
            "free": "known ones make estimates better",
        }
        stated = "bodies" if self.bodies == "model" else "masses"
        known = f"GUESS: the {stated} of {self.model.name} are those of the robot."
        comments = {
            "model": f"{held if self.held else ''}Joints: {', '.join(self.joints)}.",
            "drive": "GUESS: viscous friction, Coulomb friction, a constant offset.\n"
            "rotor_inertia = true adds the rotors of geared motors.",
            "drive.velocity_scale": "GUESS [rad/s or m/s]: width of the sign change",
            "constraints": known if self.masses == "datasheet" else "",
            "constraints.masses": "" if self.bodies == "model" else masses[self.masses],
            "data": "The first 70 % of the motion are for training, the rest for "
            "validation."
            if self._is_split
            else "",
            "data.columns": "\n".join(
                f"GUESS: {note}."
                for note in (
                    *self.notes,
                    f"other {rest}" if self.columns.units else rest,
                )
            ),
            "data.columns.time": "",
            "data.columns.position": "",
            "data.preparation": f"The log has {self.rate:.6g} samples a second.\n"
            f"GUESS: {self.cutoff_reason}.",
            "data.gains": "GUESS: the delay [s] with which the torque fits best, one\n"
            "sample at the most; consistent-id rollout --choose finds a better one.",
            "data.gains.delay": "",
            "data.preparation.max_gap": "s; longest step between samples",
            "data.preparation.resample": "Hz; the time stamps jitter",
            "data.preparation.motion_cutoff": "Hz",
            "data.preparation.torque_cutoff": "Hz",
        }
        if self.standing is not None:
            comments |= self.standing.comments
        if self.selection is None:
            return comments
        masses_kept = self.selection.choice.masses == self.masses
        chosen = self.selection.comments()
        if not masses_kept:
            del comments["constraints.masses"]
        del comments["drive.velocity_scale"]
        rate = f"The log has {self.rate:.6g} samples a second."
        chosen["data.preparation"] = f"{rate}\n{chosen['data.preparation']}"
        return comments | chosen


def draft_table(draft: Draft) -> Table:
    """Return what was taken from the files, and what was guessed."""
    columns = draft.columns
    channels = ("time", "position", "velocity", "torque", "position_command")
    named = ((c, getattr(columns, c)) for c in channels)
    units = ", ".join(f"{channel}: {u}" for channel, u in columns.units.items())
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
        rows.insert(1, draft._locked)
    return Table(
        f"How {draft.model.name} and {draft._names} were read",
        ("what", "which"),
        tuple(rows),
        (*draft.notes, "consistent-id init writes this down, to be corrected"),
    )


def _taken(draft: Draft) -> tuple[str, str]:
    """Say what is taken from the model."""
    if draft.bodies == "model":
        return "bodies", "the model's"
    if draft.standing is not None:
        return "bodies", "the model's, but for that of the base, which is free"
    return "masses", "the model's" if draft.masses == "datasheet" else "free"

"""A problem file for a robot and a log that have none; guesses are marked as such."""

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import msgspec

from consistent_id._support.tables import Table
from consistent_id.problems.file import (
    ColumnsTable,
    ConstraintsTable,
    DataTable,
    DriveTable,
    ModelTable,
    PreparationTable,
    ProblemTable,
    RecordingTable,
)
from consistent_id.problems.log_entries import gains_table
from consistent_id.problems.model import DEFAULT_DRIVE
from consistent_id.problems.problem import Problem, problem_of
from consistent_id.problems.toml_text import toml_text
from consistent_id.recordings.readers.columns import Columns
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals import PDGains
from consistent_id.robot.loaders.robot_file import is_mjcf


@dataclass(frozen=True, slots=True)
class Draft:
    """The content of a problem file that is to be written, and the reasons for it.

    Parameters
    ----------
    model, log : Path
    joints : tuple of str
        Joints that move.
    locked : tuple of str
        Other joints between base and tip; held at zero.
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
    training, validation : tuple of int
        First and last row, from 1.
    masses : {"datasheet", "free"}
    raw : Recording
        The log, as it was read.
    notes : tuple of str
        What else was guessed.
    gains : PDGains, optional
        Of PD-controlled joints.
    bodies : {"identified", "model"}
    """

    model: Path
    log: Path
    joints: tuple[str, ...]
    locked: tuple[str, ...]
    base: str | None
    tip: str | None
    columns: Columns
    torque_gain: tuple[float, ...]
    rate: float
    resample: float | None
    max_gap: float | None
    cutoff: float
    cutoff_reason: str
    training: tuple[int, int]
    validation: tuple[int, int]
    masses: Literal["datasheet", "free"]
    raw: Recording
    notes: tuple[str, ...] = ()
    gains: PDGains | None = None
    bodies: Literal["identified", "model"] = "identified"

    @property
    def name(self) -> str:
        """The problem's name: the log's, in letters that a name may have."""
        kept = "".join(c if c.isascii() and c.isalnum() else "-" for c in self.log.stem)
        return kept.strip("-") or "problem"

    def table(self, folder: Path) -> ProblemTable:
        """Return the content of the problem file, for a file in a folder."""
        mjcf = is_mjcf(self.model)
        model = _relative(self.model, folder).replace("$", "$$")
        columns = msgspec.structs.asdict(ColumnsTable())
        columns = {key: getattr(self.columns, key) for key in columns}
        columns["array_joints"] = list(self.columns.array_joints)
        gain = list(self.torque_gain) or [1.0]
        return ProblemTable(
            name=self.name,
            model=ModelTable(
                urdf=None if mjcf else model,
                mjcf=model if mjcf else None,
                base=self.base,
                tip=self.tip,
                joints=list(self.joints) if self.locked else None,
            ),
            drive=self._drive,
            constraints=ConstraintsTable(bodies=self.bodies, masses=self.masses),
            data=DataTable(
                recordings=[
                    RecordingTable(
                        file=_relative(self.log, folder), role=role, rows=list(rows)
                    )
                    for role, rows in self._rows.items()
                ],
                columns=ColumnsTable(**columns),
                torque_gain=gain if len(gain) > 1 else gain[0],
                torque_joints=list(self.columns.torque_joints),
                gains=None if self.gains is None else gains_table(self.gains),
                preparation=PreparationTable(
                    max_gap=self.max_gap,
                    resample=self.resample,
                    motion_cutoff=self.cutoff,
                    torque_cutoff=self.cutoff,
                ),
            ),
        )

    def problem(self, folder: Path | None = None) -> Problem:
        """Return the problem itself, without a file of its own."""
        folder = Path.cwd() if folder is None else folder
        read = {_relative(self.log, folder): self.raw}
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
            f"# Drafted from {self.model.name} and {self.log.name}. A comment that\n"
            "# begins with GUESS marks what neither of them states: check it.\n\n"
        )
        if accepted:
            head += f"# Accepted in spite of the verdict: {', '.join(accepted)}.\n\n"
        return head + toml_text(self.table(folder), self._comments)

    @property
    def _drive(self) -> DriveTable:
        """Drive terms; joints that follow commands have geared motors."""
        if self.gains is None:
            return DEFAULT_DRIVE
        return msgspec.structs.replace(DEFAULT_DRIVE, rotor_inertia=True)

    @property
    def _rows(self) -> dict[Literal["training", "validation"], tuple[int, int]]:
        return {"training": self.training, "validation": self.validation}

    @property
    def _comments(self) -> dict[str, str]:
        held = f"Locked at zero: {', '.join(self.locked)}.\n" if self.locked else ""
        masses = {
            "datasheet": '"free" if they are made up',
            "free": "known ones make estimates better",
        }
        known = f"GUESS: the masses of {self.model.name} are those of the robot."
        return {
            "model": f"{held}Joints: {', '.join(self.joints)}.",
            "drive": "GUESS: viscous friction, Coulomb friction, a constant offset.\n"
            "rotor_inertia = true adds the rotors of geared motors.",
            "drive.velocity_scale": "GUESS [rad/s or m/s]: width of the sign change",
            "constraints": known if self.masses == "datasheet" else "",
            "constraints.masses": masses[self.masses],
            "data": "The first 70 % of the motion are for training, the rest for "
            "validation.",
            "data.columns": "\n".join(
                f"GUESS: {note}."
                for note in (
                    *self.notes,
                    "units are rad, m, N m and N, as no name contradicts this",
                )
            ),
            "data.columns.time": "",
            "data.columns.position": "",
            "data.preparation": f"The log has {self.rate:.6g} samples a second.\n"
            f"GUESS: {self.cutoff_reason}.",
            "data.preparation.max_gap": "s; longest step between samples",
            "data.preparation.resample": "Hz; the time stamps jitter",
            "data.preparation.motion_cutoff": "Hz",
            "data.preparation.torque_cutoff": "Hz",
        }


def draft_table(draft: Draft) -> Table:
    """Return what was taken from the files, and what was guessed."""
    columns = draft.columns
    channels = ("time", "position", "velocity", "torque", "position_command")
    named = ((c, getattr(columns, c)) for c in channels)
    (a, b), (c, d) = draft.training, draft.validation
    rows = [
        ("joints", ", ".join(draft.joints)),
        ("columns", ", ".join(f"{c}: {name}" for c, name in named if name is not None)),
        ("rate", f"{draft.rate:.6g} Hz" + ("; resampled" if draft.resample else "")),
        ("rows", f"{a} to {b} for training, {c} to {d} for validation"),
        ("cut-off", f"{draft.cutoff:g} Hz: {draft.cutoff_reason}"),
        ("masses", "the model's" if draft.masses == "datasheet" else "free"),
        ("friction", "viscous, Coulomb (tanh), offset"),
    ]
    if draft.locked:
        rows.insert(1, ("locked at zero", ", ".join(draft.locked)))
    return Table(
        f"How {draft.model.name} and {draft.log.name} were read",
        ("what", "which"),
        tuple(rows),
        (*draft.notes, "consistent-id init writes this down, to be corrected"),
    )


def _relative(file: Path, folder: Path) -> str:
    return Path(os.path.relpath(file.resolve(), folder.resolve())).as_posix()

"""A problem file for a robot and a log that have none; what is a guess says so."""

import json
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from consistent_id._support.tables import Table
from consistent_id.problems.file import problem_table
from consistent_id.problems.problem import Problem, problem_of
from consistent_id.recordings.readers.columns import Columns

VELOCITY_SCALE = 0.02  # rad/s or m/s


@dataclass(frozen=True, slots=True)
class Draft:
    """What a problem file is going to say, and why.

    Parameters
    ----------
    model, log : Path
    joints : tuple of str
        Those that move.
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
    notes : tuple of str
        What else was guessed.
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
    notes: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """The problem's name: the log's, in letters that a name may have."""
        kept = "".join(c if c.isascii() and c.isalnum() else "-" for c in self.log.stem)
        return kept.strip("-") or "problem"

    def problem(self, folder: Path | None = None) -> Problem:
        """Return the problem itself, without a file of its own."""
        folder = Path.cwd() if folder is None else folder
        file = folder / "problem.toml"
        return problem_of(problem_table(self.text(folder), file), file)

    def text(self, folder: Path) -> str:
        """Return the file's content, for a file in a folder."""
        lines = [
            f"# Drafted from {self.model.name} and {self.log.name}. A comment that",
            "# begins with GUESS says what neither of them states: look at it.",
            "",
            f"name = {_said(self.name)}",
            "",
            *_model_lines(self, folder),
            "",
            "# GUESS: friction that grows with speed, dry friction, a constant offset.",
            "[drive]",
            "viscous = true",
            'coulomb = "tanh"',
            f"velocity_scale = {VELOCITY_SCALE}  # GUESS [rad/s or m/s]: where dry "
            "friction turns",
            "offset = true",
            "# rotor_inertia = true  # of geared motors, where the log tells it",
            "",
            *_constraint_lines(self),
            "",
            *_data_lines(self, folder),
        ]
        return "\n".join(lines) + "\n"


def draft_table(draft: Draft) -> Table:
    """Return what was taken from the files, and what was guessed."""
    columns = draft.columns
    channels = ("time", "position", "velocity", "torque")
    named = ((c, getattr(columns, c)) for c in channels)
    (a, b), (c, d) = draft.training, draft.validation
    rows = [
        ("joints", ", ".join(draft.joints)),
        ("columns", ", ".join(f"{c}: {name}" for c, name in named if name is not None)),
        ("rate", f"{draft.rate:.6g} Hz" + ("; resampled" if draft.resample else "")),
        ("rows", f"{a} to {b} to learn from, {c} to {d} to judge by"),
        ("cut-off", f"{draft.cutoff:g} Hz: {draft.cutoff_reason}"),
        ("masses", "the model's" if draft.masses == "datasheet" else "free"),
        ("friction", "viscous, dry (tanh), offset"),
    ]
    if draft.locked:
        rows.insert(1, ("held at zero", ", ".join(draft.locked)))
    return Table(
        f"What {draft.model.name} and {draft.log.name} were taken for",
        ("what", "which"),
        tuple(rows),
        (*draft.notes, "consistent-id init writes this down, to be corrected"),
    )


def _model_lines(draft: Draft, folder: Path) -> list[str]:
    form = "urdf" if draft.model.suffix.lower() == ".urdf" else "mjcf"
    file = _relative(draft.model, folder).replace("$", "$$")
    lines = ["[model]", f"{form} = {_said(file)}"]
    ends = (("base", draft.base), ("tip", draft.tip))
    lines += [f"{key} = {_said(link)}" for key, link in ends if link is not None]
    if draft.locked:
        lines += [
            f"# Held at zero, as if they never moved: {', '.join(draft.locked)}.",
            f"joints = {_list(draft.joints)}",
        ]
    else:
        lines.append(f"# joints: {', '.join(draft.joints)}")
    return lines


def _constraint_lines(draft: Draft) -> list[str]:
    if draft.masses == "free":
        return ["[constraints]", 'masses = "free"  # known ones make estimates better']
    return [
        f"# GUESS: the masses of {draft.model.name} are those of the robot.",
        "[constraints]",
        'masses = "datasheet"  # "free" if they are made up',
    ]


def _data_lines(draft: Draft, folder: Path) -> list[str]:
    lines = ["[data]", 'folder = "."']
    if draft.torque_gain:
        gain = draft.torque_gain
        several = f"[{', '.join(map(repr, gain))}]"
        lines.append(f"torque_gain = {several if len(gain) > 1 else repr(gain[0])}")
    if draft.columns.torque_joints:
        lines.append(f"torque_joints = {_list(draft.columns.torque_joints)}")
    lines += ["", *_column_lines(draft), "", *_preparation_lines(draft)]
    file = _said(_relative(draft.log, folder))
    for role, rows in (("training", draft.training), ("validation", draft.validation)):
        lines += [
            "",
            *(["# The last 30 % of the motion judge."] if role == "validation" else ()),
            "[[data.recordings]]",
            f"file = {file}",
            f'role = "{role}"',
            f"rows = {list(rows)}",
        ]
    return lines


def _column_lines(draft: Draft) -> list[str]:
    columns = draft.columns
    lines = [f"# GUESS: {note}." for note in draft.notes]
    lines += ["# GUESS: rad, m, N m and N, as the names do not say otherwise."]
    lines.append("[data.columns]")
    for channel in ("time", "position", "velocity", "acceleration", "torque"):
        if (pattern := getattr(columns, channel)) is not None:
            lines.append(f"{channel} = {_said(pattern)}")
    if columns.names:
        pairs = ", ".join(f"{_said(a)} = {_said(b)}" for a, b in columns.names.items())
        lines.append(f"names = {{{pairs}}}")
    if columns.array_joints:
        lines.append(f"array_joints = {_list(columns.array_joints)}")
    return lines


def _preparation_lines(draft: Draft) -> list[str]:
    lines = [f"# The log has {draft.rate:.6g} samples a second.", "[data.preparation]"]
    if draft.max_gap is not None:
        lines.append(f"max_gap = {draft.max_gap!r}  # s; cut where stamps are missing")
    if draft.resample is not None:
        lines.append(f"resample = {draft.resample!r}  # Hz; the stamps jitter")
    return [
        *lines,
        f"# GUESS: {draft.cutoff_reason}.",
        f"motion_cutoff = {draft.cutoff!r}  # Hz",
        f"torque_cutoff = {draft.cutoff!r}  # Hz",
    ]


def _relative(file: Path, folder: Path) -> str:
    return Path(os.path.relpath(file.resolve(), folder.resolve())).as_posix()


def _said(text: str) -> str:
    return json.dumps(text, ensure_ascii=False)


def _list(names: Sequence[str]) -> str:
    return f"[{', '.join(map(_said, names))}]"

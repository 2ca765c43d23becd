"""A study written to a folder, complete, and opened again without computing.

``results.json`` lists the inputs and outputs of the study, each with its digest, and
contains the tables of every command.  A folder is used without computing as long as the
digests agree.
"""

import hashlib
from collections.abc import Collection
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from shutil import rmtree
from tempfile import mkdtemp
from typing import TYPE_CHECKING, Any, Literal, Protocol
from weakref import finalize

import msgspec

from consistent_id._support.files import LARGEST_MODEL, read_input
from consistent_id._support.tables import Table, brief
from consistent_id.errors import ProblemError
from consistent_id.estimation.verdict import Reason, Verdict, Word
from consistent_id.problems.loading import RESULTS

if TYPE_CHECKING:
    from consistent_id.estimation.estimate import Estimate
    from consistent_id.problems.problem import Problem
    from consistent_id.recordings.signals import PDGains

ModelForm = Literal["urdf", "mjcf"]

FORMAT = "consistent_id results 1"
INDEX = RESULTS
PROBLEM = "problem.toml"
REPORT = "report.html"
DELIVERED = "delivered.json"
_READ = (PROBLEM, DELIVERED, "comparison.json", REPORT)


def file_of(method: str) -> str:
    """Return the name of the file with the estimate of a method."""
    return f"{method.replace(' ', '_')}.json"


PRINTED = ("info", "check", "identify", "uncertainty", "compare")
"""Commands whose tables are kept."""


_LARGE = 64 * 2**20  # bytes: a smaller file is read again, which takes 0.2 s at most


class FileRecord(msgspec.Struct, frozen=True):
    """A file as it was: its digest, its size and its time stamps.

    A large file with the same size and stamps is not read again.  Anybody can set
    `changed`, but not `status`, which is the system's.  Both are 0 if the file had
    changed just before: it could change again within the same step of the clock.
    """

    sha256: str
    size: int
    changed: int = 0
    status: int = 0

    def fits(self, path: Path) -> bool:
        """Return whether a file is still the same."""
        found = path.stat()
        if found.st_size != self.size:
            return False
        stamps = (found.st_mtime_ns, found.st_ctime_ns)
        if self.size > _LARGE and self.status and stamps == (self.changed, self.status):
            return True
        return digest(path) == self.sha256


class DriveRecord(msgspec.Struct, frozen=True):
    """Gains of PD-controlled joints as they were found, and the delay of commands."""

    kp: list[float]
    kd: list[float]
    torque_limit: list[float | None]
    stiffness: list[float | None]
    delay: float

    @property
    def gains(self) -> "PDGains":
        """The gains."""
        import numpy as np

        from consistent_id.recordings.signals import PDGains

        limit, stiffness = (
            np.array([np.inf if v is None else v for v in values])
            for values in (self.torque_limit, self.stiffness)
        )
        return PDGains(np.array(self.kp), np.array(self.kd), limit, stiffness)


class ModelRecord(msgspec.Struct, frozen=True):
    """The robot's file, as it was: a letter for each byte."""

    form: ModelForm
    name: str
    text: str


class TableRecord(msgspec.Struct, frozen=True):
    """A table as it is printed."""

    title: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    notes: tuple[str, ...]

    def table(self) -> Table:
        """Return the table."""
        return Table(self.title, self.header, self.rows, self.notes)


class _SavedFinding(msgspec.Struct, frozen=True):
    kind: str
    severity: Literal["note", "warning", "fault"]


class _SavedFindings(msgspec.Struct, frozen=True):
    findings: list[_SavedFinding] = []


class _SavedAnswer(msgspec.Struct, frozen=True):
    verdict: Word
    method: str
    reasons: list[Reason]
    accepted: list[str]
    held_out_error: float | None
    held_out_recordings: list[str] = []


class _Parameter(msgspec.Struct, frozen=True):
    value: float
    unit: str


class _Delivered(msgspec.Struct, frozen=True):
    parameters: dict[str, _Parameter]


class _StudyRecord(msgspec.Struct, frozen=True):
    """The parts of ``comparison.json`` that are used; all of it is handed on."""

    problem: str
    delivered: _Delivered


class Index(msgspec.Struct, frozen=True, kw_only=True):
    """The content of ``results.json``."""

    format: str
    version: str
    problem: str
    seed: int
    accepted: list[str]
    answer: dict[str, Any]
    findings: dict[str, Any]
    tables: dict[str, list[TableRecord]]
    inputs: dict[str, FileRecord]
    files: dict[str, FileRecord]
    model: ModelRecord | None = None
    drives: DriveRecord | None = None


class StudyOutcome(Protocol):
    """The content of a study that commands print, computed in this run or opened."""

    @property
    def name(self) -> str:
        """The problem's name."""

    @property
    def verdict(self) -> Verdict:
        """Whether the recommended estimate may be used, and why."""

    @property
    def answer(self) -> dict[str, Any]:
        """Verdict, reasons, recommended estimate."""

    @property
    def record(self) -> dict[str, Any]:
        """The study as plain numbers and text."""

    @property
    def page(self) -> str:
        """The report."""

    def tables(self, name: str) -> list[Table]:
        """Return the tables of a command: ``identify``, ``compare``, ..."""


@brief
@dataclass(frozen=True)
class Results:
    """A folder of results, opened: a `StudyOutcome`.

    Parameters
    ----------
    folder : Path
    index : Index

    Examples
    --------
    >>> import consistent_id as ci
    >>> import tempfile
    >>> folder = tempfile.mkdtemp()
    >>> from consistent_id.cli import main
    >>> main(["identify", "problems/rx60", "--output", folder, "--quiet"])
    0
    >>> ci.open_results(folder).verdict.word
    'use'
    """

    folder: Path
    index: Index

    @property
    def verdict(self) -> Verdict:
        """Whether the recommended estimate may be used, and why."""
        return Verdict.from_dict(self.index.answer)

    def tables(self, name: str) -> list[Table]:
        """Return the tables of a command: ``identify``, ``compare``, ..."""
        return [record.table() for record in self.index.tables[name]]

    @property
    def name(self) -> str:
        """The problem's name."""
        return self.index.problem

    @property
    def answer(self) -> dict[str, Any]:
        """Verdict, reasons, recommended estimate."""
        return self.index.answer

    @cached_property
    def page(self) -> str:
        """The report."""
        return (self.folder / REPORT).read_text(encoding="utf-8", errors="replace")

    @cached_property
    def record(self) -> dict[str, Any]:
        """The study as plain numbers and text.

        Raises
        ------
        ProblemError
            If the file is none that `write_results` wrote.
        """
        file = self.folder / "comparison.json"
        content = read_input(file, ProblemError, LARGEST_MODEL)
        try:
            record = msgspec.json.decode(content, type=dict[str, Any])
            msgspec.convert(record, type=_StudyRecord)
        except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as cause:
            raise ProblemError(
                f"{file}: not the record of a study: {cause} ($ is the file). Compute "
                f"it again: consistent-id compare {self.folder / PROBLEM}"
            ) from None
        return record

    @cached_property
    def problem(self) -> "Problem":
        """The problem, with the robot as it was."""
        from consistent_id.problems.file import read_problem_table
        from consistent_id.problems.loading import problem_of

        file, model = self.folder / PROBLEM, self.index.model
        table = read_problem_table(file)
        if model is not None and self.model_file is not None:
            named = str(self.model_file.resolve()).replace("$", "$$")
            robot = msgspec.structs.replace(table.model, **{model.form: named})
            table = msgspec.structs.replace(table, model=robot)
        return problem_of(table, file)

    @cached_property
    def model_file(self) -> Path | None:
        """The robot's file as it was: itself, or a copy if it changed or is gone."""
        model = self.index.model
        if model is None:
            return None
        for place, record in self.index.inputs.items():
            path = self.folder / place
            if path.name == model.name and path.is_file() and record.fits(path):
                return path
        folder = mkdtemp(prefix="consistent-id-")
        finalize(self, rmtree, folder, ignore_errors=True)
        copy = Path(folder, model.name)
        copy.write_bytes(model.text.encode("latin-1"))
        return copy

    @cached_property
    def delivered(self) -> "Estimate":
        """The delivered estimate, fitted to all recordings."""
        return self._estimate(DELIVERED)

    @cached_property
    def recommended(self) -> "Estimate":
        """The recommended estimate, fitted to the training data alone."""
        return self._estimate(file_of(self.answer["method"]))

    def _estimate(self, file: str) -> "Estimate":
        from consistent_id.estimation.estimate import Estimate
        from consistent_id.regression.base import base_parameters

        model = self.problem.model
        return Estimate.load(self.folder / file, model, base_parameters(model))

    def changes(self) -> list[str]:
        """Return the inputs that changed since the results were computed, in sentences.

        Inputs that have been removed do not matter.
        """
        from consistent_id import __version__

        found = [
            f"{path} has changed since"
            for path, record in self.index.inputs.items()
            if (self.folder / path).is_file() and not record.fits(self.folder / path)
        ]
        for name, record in self.index.files.items():
            path = self.folder / name
            if not path.is_file():
                found.append(f"{name} is missing")
            elif not record.fits(path):
                found.append(f"{name} has been edited since")
        if self.index.version != __version__:
            found.append(
                f"version {self.index.version} wrote it, this is {__version__}"
            )
        return found


def open_results(folder: str | Path) -> Results:
    """Open what `write_results` wrote.

    Raises
    ------
    ProblemError
        If the folder has no results, or they have another form.

    Examples
    --------
    >>> from consistent_id import open_results
    >>> open_results("problems/rx60")
    Traceback (most recent call last):
    consistent_id.errors.ProblemError: problems/rx60 has no results.json; ...
    """
    folder = Path(folder)
    file = folder / INDEX
    if not file.is_file():
        raise ProblemError(
            f"{folder} has no {INDEX}; expected a folder that identify or compare "
            f"wrote with --output"
        )
    content = read_input(file, ProblemError, LARGEST_MODEL)
    try:
        index = msgspec.json.decode(content, type=Index)
    except msgspec.DecodeError as cause:
        raise ProblemError(f"{file}: not results: {cause} ($ is the file)") from None
    if index.format != FORMAT:
        raise ProblemError(f"{file}: format {index.format!r}, expected {FORMAT!r}")
    inside = [*index.files, *([index.model.name] if index.model else [])]
    if outside := [n for n in inside if Path(n).name != n or n in ("", "..")]:
        raise ProblemError(f"{file}: {outside[0]!r} is not a file of this folder")
    results = Results(folder, index)
    if fault := _fault(results):
        raise ProblemError(f"{file}: not results: {fault}")
    return results


def _fault(results: Results) -> str:
    """Return the entries for commands that the index lacks, or nothing."""
    index = results.index
    needed: list[tuple[str, Collection[str], str]]
    needed = [(name, index.tables, "tables of") for name in PRINTED]
    needed += [(name, index.files, "digest of") for name in _READ]
    for name, given, what in needed:
        if name not in given:
            return f"it has no {what} {name}"
    for name, tables in index.tables.items():
        if any(len(row) != len(t.header) for t in tables for row in t.rows):
            return f"a table of {name} has rows that do not fit its header"
    kinds: list[tuple[str, Any]] = [
        ("findings", _SavedFindings),
        ("answer", _SavedAnswer),
    ]
    for name, kind in kinds:
        try:
            msgspec.convert(getattr(index, name), type=kind)
        except msgspec.ValidationError as cause:
            return f"{name}: {cause}"
    return ""


def digest(path: Path) -> str:
    """Return the SHA-256 digest of a file."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()

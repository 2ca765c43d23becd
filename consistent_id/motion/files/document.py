"""Exact trajectories as a document of plain values, in JSON or NPZ.

    format   "consistent_id trajectory 1"
    kind     "fourier", "polynomial" or "move"
    pieces   one, or those of a move in the order of time

A piece of kind "fourier" has the keys of `FourierTrajectory.to_dict`, one of kind
"polynomial" joints, control, duration_s and start_s.  NPZ has an array ``piece0_sine``
for ``pieces[0].sine``.
"""

import io
import json
import zipfile
from pathlib import Path
from typing import Any, Literal

import msgspec
import numpy as np

from consistent_id._support.arrays import Matrix
from consistent_id._support.files import read_input, require_regular
from consistent_id.errors import ProblemError
from consistent_id.motion.bernstein import PolynomialPath
from consistent_id.motion.moves import Move
from consistent_id.recordings.joint_paths import FourierTrajectory, JointPath
from consistent_id.recordings.readers.named_arrays import Arrays
from consistent_id.recordings.readers.npz import read_arrays

FORMAT = "consistent_id trajectory 1"

_LARGEST = 256 * 2**20  # bytes; an hour of seven joints at 500 Hz is larger
_STILL = 1e-6  # velocity at rest, relative to the largest

ExactPath = FourierTrajectory | PolynomialPath | Move
_Piece = FourierTrajectory | PolynomialPath


class _PieceRecord(msgspec.Struct, forbid_unknown_fields=True, tag_field="kind"):
    """Keys that pieces of both kinds have."""

    joints: list[str]
    duration_s: float
    start_s: float


class _Fourier(_PieceRecord, tag="fourier"):
    frequencies_hz: list[float]
    offset: list[float]
    sine: list[list[float]]
    cosine: list[list[float]]

    def path(self) -> FourierTrajectory:
        n = len(self.joints)
        return FourierTrajectory(
            tuple(self.joints),
            self.frequencies_hz,  # type: ignore[arg-type]
            self.offset,  # type: ignore[arg-type]
            _rows(self.sine, n),
            _rows(self.cosine, n),
            self.duration_s,
            self.start_s,
        )


class _Polynomial(_PieceRecord, tag="polynomial"):
    control: list[list[float]]

    def path(self) -> PolynomialPath:
        control = _rows(self.control, len(self.joints))
        return PolynomialPath(
            tuple(self.joints), control, self.duration_s, self.start_s
        )


class _Header(msgspec.Struct):
    format: str


class _TrajectoryRecord(msgspec.Struct, forbid_unknown_fields=True):
    format: str
    kind: Literal["fourier", "polynomial", "move"]
    pieces: list[_Fourier | _Polynomial]
    digest: str = ""  # of the file's mark


def json_of(path: ExactPath) -> str:
    """Return a trajectory as JSON; numbers come back to the last bit."""
    return json.dumps(_record(path), indent=1, allow_nan=False) + "\n"


def path_of_json(content: bytes, where: Path) -> ExactPath:
    """Return the trajectory in JSON.

    Raises
    ------
    ProblemError
        With the key of the first fault.
    """
    try:
        _check_format(msgspec.json.decode(content, type=_Header).format, where)
        document = msgspec.json.decode(content, type=_TrajectoryRecord)
    except msgspec.ValidationError as cause:
        raise ProblemError(f"{where}: {cause} ($ is the file)") from None
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as cause:
        raise ProblemError(f"{where}: not JSON: {cause}") from None
    return _path(document, where)


def npz_of(path: ExactPath, samples: Arrays) -> bytes:
    """Return a trajectory and samples of it as the content of an NPZ file."""
    record = _record(path)
    arrays: dict[str, Any] = {"format": record["format"], "kind": record["kind"]}
    for number, piece in enumerate(record["pieces"]):
        arrays |= {f"piece{number}_{key}": value for key, value in piece.items()}
    file = io.BytesIO()
    np.savez(file, **(arrays | dict(samples)))
    return file.getvalue()


def path_of_npz(where: Path) -> ExactPath:
    """Return the trajectory in an NPZ file; nothing is unpickled.

    Raises
    ------
    ProblemError
        With the key of the first fault.
    RecordingError
        If the file, or an array in it, cannot be read.
    """
    require_regular(where, ProblemError)
    names = [name for name in _members(where) if name.startswith("piece")]
    arrays = read_arrays(where, ["format", "kind", *names])
    _check_format(str(arrays["format"]), where)
    pieces: dict[int, dict[str, Any]] = {}
    for name in names:
        number, _, key = name.removeprefix("piece").partition("_")
        if not (number.isascii() and number.isdigit() and len(number) < 4):
            raise ProblemError(f"{where}: an array {name!r}, expected pieceN_...")
        pieces.setdefault(int(number), {})[key] = arrays[name].tolist()
    record = {
        "format": arrays["format"].tolist(),
        "kind": arrays["kind"].tolist(),
        "pieces": [pieces[number] for number in sorted(pieces)],
    }
    try:
        document = msgspec.convert(record, type=_TrajectoryRecord)
    except msgspec.ValidationError as cause:
        raise ProblemError(f"{where}: {cause} ($ is the file)") from None
    return _path(document, where)


def _check_format(seen: str, where: Path) -> None:
    if seen != FORMAT:
        raise ProblemError(
            f"{where}: format is {seen!r}, expected {FORMAT!r}; if another version of "
            "consistent_id wrote it, read it with that"
        )


def _members(where: Path) -> list[str]:
    """Return the names of the arrays; refuse arrays that expand too much."""
    try:
        with zipfile.ZipFile(where) as file:
            members = file.infolist()
    except (zipfile.BadZipFile, OSError, ValueError) as cause:
        raise ProblemError(f"{where}: not readable as NPZ: {cause}") from None
    require_size(where, sum(member.file_size for member in members))
    return [member.filename.removesuffix(".npy") for member in members]


def _record(path: ExactPath) -> dict[str, Any]:
    pieces = path.pieces if isinstance(path, Move) else (path,)
    return {
        "format": FORMAT,
        "kind": "move" if isinstance(path, Move) else _piece(path)["kind"],
        "pieces": [_piece(piece) for piece in pieces],
    }


def _piece(piece: _Piece) -> dict[str, Any]:
    if isinstance(piece, FourierTrajectory):
        record = {"kind": "fourier"} | piece.to_dict()
    else:
        record = {
            "kind": "polynomial",
            "joints": list(piece.joints),
            "control": piece.control.tolist(),
            "duration_s": piece.duration,
            "start_s": piece.start,
        }
    # A duration may be any number type.
    times = {key: float(record[key]) for key in ("duration_s", "start_s")}
    return record | times


def _path(document: _TrajectoryRecord, where: Path) -> ExactPath:
    kinds = [piece.__struct_config__.tag for piece in document.pieces]
    of_move = document.kind == "move" and kinds.count("fourier") == 1
    if not of_move and kinds != [document.kind]:
        raise ProblemError(
            f"{where}: kind {document.kind!r} with pieces {kinds}, expected one of its "
            "own kind or, of a move, one 'fourier' between 'polynomial' ones"
        )
    try:
        return _assembled(document)
    except ProblemError as cause:
        raise ProblemError(f"{where}: {cause}") from None


def _rows(rows: list[list[float]], width: int) -> Matrix:
    """Return rows; for no rows, an empty matrix of the right width."""
    return rows if rows else np.zeros((0, width))  # type: ignore[return-value]


def _assembled(document: _TrajectoryRecord) -> ExactPath:
    paths = [piece.path() for piece in document.pieces]
    if document.kind != "move":
        return paths[0]
    at = [isinstance(piece, _Fourier) for piece in document.pieces].index(True)
    run_in, run_out = tuple(paths[:at]), tuple(paths[at + 1 :])
    return Move(run_in, paths[at], run_out)  # type: ignore[arg-type]


def content_of(path: Path) -> bytes:
    """Return the content of a file.

    Raises
    ------
    ProblemError
        If it cannot be read, or is too large to be a trajectory.
    """
    require_size(path, require_regular(path, ProblemError))
    return read_input(path, ProblemError, _LARGEST)


def require_size(path: Path, size: int) -> None:
    """Refuse files larger than trajectories."""
    if size > _LARGEST:
        raise ProblemError(
            f"{path}: {size / 2**20:.0f} MiB, expected a trajectory of at most "
            f"{_LARGEST // 2**20} MiB; use read_recording for a log"
        )


def require_names(joints: tuple[str, ...], where: Path) -> None:
    """Refuse names of joints that cannot be read back from a text file."""
    for name in joints:
        if not name or not name.isprintable() or name != name.strip():
            raise ProblemError(
                f"{where}: joint {name!r}: expected a name of printable characters "
                "without space around it; rename the joint"
            )


def require_rest(path: JointPath, where: Path) -> None:
    """Refuse a path that does not begin and end at rest, as a robot does."""
    ends = [path.start, path.start + path.duration]
    velocity = path.evaluate(ends, derivatives=1)[1]
    moving = abs(velocity) > _STILL * path.derivative_bound(1)
    if moving.any():
        k, j = (int(i) for i in np.argwhere(moving)[0])
        raise ProblemError(
            f"{where}: joint {path.joints[j]!r} moves at {velocity[k, j]:.4g} per "
            f"second at its {('start', 'end')[k]}, expected a motion from rest to "
            "rest, which a robot can follow; write move_along(trajectory, limits)"
        )

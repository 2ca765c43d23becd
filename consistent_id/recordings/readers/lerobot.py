"""LeRobot data sets: a folder with ``meta/info.json`` and Parquet files of data.

Elements of list columns get the names that the data set gives them, such as
``observation.state.shoulder_pan.pos``.  Episodes follow each other with a break between
them, at which preparation cuts.
"""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from consistent_id.errors import RecordingError
from consistent_id.recordings.log_formats import files_of
from consistent_id.recordings.readers import parquet
from consistent_id.recordings.readers.columns import require
from consistent_id.recordings.readers.named_arrays import Arrays
from consistent_id.recordings.readers.used_rows import BREAK

INFO = Path("meta", "info.json")
_EPISODE, _CLOCK = parquet.EPISODE, "timestamp"
_MOST_RADIANS = 2.2 * np.pi  # a turn, and a margin: joints of arms turn no further
_MOST_NORMALISED = 101.0  # of -100 to 100, rounded


def read_arrays(path: Path, names: Sequence[str]) -> Arrays:
    """Return the named columns, and elements of list columns, of all episodes.

    Raises
    ------
    RecordingError
        If the data set has no such column, or a file is missing or not Parquet.
    """
    elements = _elements(path)
    require(str(path), names, array_names(path))
    stored = list(dict.fromkeys(elements.get(n, (n, 0))[0] for n in names))
    wanted = list(dict.fromkeys([*stored, _EPISODE]))
    parts = [parquet.read_columns(file, wanted) for file in _files(path)]
    whole = {name: np.concatenate([part[name] for part in parts]) for name in wanted}
    if _CLOCK in whole:
        whole[_CLOCK] = parquet.apart(whole[_CLOCK], whole[_EPISODE])
    return {
        name: whole[name] if name not in elements else _element(whole, elements[name])
        for name in names
    }


def array_names(path: Path) -> tuple[str, ...]:
    """Return the names of numeric columns, list columns by their elements."""
    elements = _elements(path)
    lists = {column for column, _ in elements.values()}
    columns = [n for n, f in _features(path).items() if _is_numeric(f)]
    single = [name for name in columns if name not in lists]
    return (*dict.fromkeys((_CLOCK, *single)), *elements)


def notes(path: Path) -> tuple[str, ...]:
    """Return sentences on the episodes, and on states whose names are unknown."""
    info = _info(path)
    robot = info.get("robot_type") or "a robot that is not named"
    said = (
        f"{path.name} is a LeRobot data set {info.get('codebase_version', '')} of "
        f"{robot}: {info.get('total_episodes')} episodes, {info.get('fps')} samples a "
        f"second; the episodes are read one after another, {BREAK:g} s apart"
    )
    return (said,)


def require_units(path: Path, names: Sequence[str]) -> None:
    """Refuse positions that cannot be radians.

    Raises
    ------
    RecordingError
        With the units that they may have.
    """
    read = read_arrays(path, names)
    largest = {n: float(np.fmax.reduce(abs(read[n]), initial=0.0)) for n in names}
    which = max(largest, key=lambda name: largest[name])
    most = largest[which]
    if most <= _MOST_RADIANS:
        return
    said = f"{path}: {which} reaches {most:.4g}, which is no angle in radians. "
    if most > _MOST_NORMALISED:
        raise RecordingError(
            f"{said}If it is in degrees: --units deg", options="--units deg"
        )
    raise RecordingError(
        f"{said}LeRobot writes degrees (use_degrees) or normalised positions, -100 to "
        "100 between the ends of a joint's calibrated range, and the data set does not "
        "say which. If degrees: --units deg. Normalised positions need the calibration "
        "file of the arm: (range_max - range_min) of its 4096 steps a turn are 200",
        options="--units deg",
    )


def _info(path: Path) -> Mapping[str, Any]:
    file = folder_of(path) / INFO
    try:
        info = json.loads(file.read_text(encoding="utf-8"))
        features = info["features"]
        if not isinstance(features, dict):
            raise TypeError(f"features are {type(features).__name__}")
    except (OSError, ValueError, KeyError, TypeError) as cause:
        raise RecordingError(
            f"{file}: not readable as the description of a LeRobot data set: {cause}"
        ) from None
    found: Mapping[str, Any] = info
    return found


def folder_of(path: Path) -> Path:
    """Return the data set's folder, of itself or of one of its Parquet files."""
    if path.is_dir():
        return path
    return next((p for p in path.absolute().parents[:3] if (p / INFO).is_file()), path)


def _files(path: Path) -> list[Path]:
    """Return a file, or all files of data in the order of their episodes."""
    if path.is_file():
        return [path]
    _, *files = files_of(path)
    if not files:
        raise RecordingError(
            f"{path}: no Parquet file under {path / 'data'}; download the data of the "
            "data set, not its description alone"
        )
    return files


def _features(path: Path) -> dict[str, Mapping[str, Any]]:
    return dict(_info(path)["features"])


def _is_numeric(feature: Mapping[str, Any]) -> bool:
    return str(feature.get("dtype")).startswith(("float", "int", "bool"))


def _elements(path: Path) -> dict[str, tuple[str, int]]:
    """Return the column and the place of each element that has a name."""
    found = {}
    for column, feature in _features(path).items():
        if not _is_numeric(feature):
            continue
        names = _flat(feature.get("names"))
        if len(names) > 1 and list(feature.get("shape", ())) == [len(names)]:
            for place, name in enumerate(names):
                found[f"{column}.{name}"] = (column, place)
    return found


def _flat(names: Any) -> list[str]:
    """Return names that are a list, or lists by the kind of part."""
    if isinstance(names, Mapping):
        return [name for part in names.values() for name in _flat(part)]
    return [str(name) for name in names] if isinstance(names, list) else []


def _element(whole: Arrays, element: tuple[str, int]) -> np.ndarray:
    column, place = element
    values = whole[column]
    if values.ndim != 2 or values.shape[1] <= place:
        raise RecordingError(
            f"column {column!r} has shape {values.shape}, but {INFO} names at least "
            f"{place + 1} elements"
        )
    return values[:, place]

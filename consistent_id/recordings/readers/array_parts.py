"""Some columns of an array in a file: ``qpos[7:19]``, counted from 0."""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from consistent_id.errors import RecordingError

_PART = re.compile(r"(?P<name>.+)\[(?P<first>\d*):(?P<end>\d*)\]")


def stored_name(name: str) -> str:
    """Return the name of the array that a name is, or is a part, of."""
    part = _PART.fullmatch(name)
    return name if part is None else part["name"]


def read_parts(
    reader: Any, path: Path, names: Sequence[str]
) -> dict[str, NDArray[Any]]:
    """Return named arrays, and parts of arrays, by the names asked for.

    Parameters
    ----------
    reader : module
        Of a format, see `LogFormat`.

    Raises
    ------
    RecordingError
        If there is no such array, or it has no such columns.
    """
    return parts_of(reader.read_arrays(path, stored_names(names)), names, path)


def stored_names(names: Sequence[str]) -> list[str]:
    """Return the names of the arrays that are asked for, or of which parts are."""
    return list(dict.fromkeys(map(stored_name, names)))


def parts_of(
    arrays: Mapping[str, NDArray[Any]], names: Sequence[str], where: Path | str
) -> dict[str, NDArray[Any]]:
    """Return the arrays that are asked for, and the parts of arrays.

    Raises
    ------
    RecordingError
        If an array has no such columns.
    """
    found: dict[str, NDArray[Any]] = {}
    for name in names:
        part, whole = _PART.fullmatch(name), arrays[stored_name(name)]
        found[name] = (
            whole if part is None else _columns(whole, part, f"{where}: {name}")
        )
    return found


def _columns(whole: NDArray[Any], part: re.Match[str], where: str) -> NDArray[Any]:
    first, end = int(part["first"] or 0), int(part["end"] or 0)
    if whole.ndim != 2:
        raise RecordingError(
            f"{where}: {part['name']} has shape {whole.shape}, expected rows and "
            "columns"
        )
    end = end or whole.shape[1]
    if not first < end <= whole.shape[1]:
        raise RecordingError(
            f"{where}: {part['name']} has {whole.shape[1]} columns, counted from 0"
        )
    return np.asarray(whole[:, first:end])

"""Datasets of an HDF5 file by their paths, and of a MATLAB 7.3 file, which is one."""

import math
from collections import deque
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from consistent_id._support.files import require_unpacked
from consistent_id.errors import RecordingError
from consistent_id.recordings.readers.named_arrays import Arrays
from consistent_id.robot.parameters import did_you_mean

_NUMBERS = (
    "double",
    "single",
    *(f"{u}int{n}" for u in ("", "u") for n in (8, 16, 32, 64)),
)

_ROWS = 2**15  # samples of a batch
_MOST_LABELS = 1000
_LINKS = 64  # groups and links on the way to a dataset; logs have 2 or 3

# Exceptions of h5py for files that are cut or overwritten.
_UNREADABLE = (OSError, RuntimeError, KeyError, ValueError, TypeError, MemoryError)


def array_names(path: Path) -> tuple[str, ...]:
    """Return the paths of the datasets; not those to which MATLAB's cells refer."""
    import h5py

    try:
        with h5py.File(path, "r") as file:
            return tuple(p for p in _paths(file) if not p.startswith("#"))
    except _UNREADABLE as cause:
        raise RecordingError(f"{path}: not readable as HDF5: {cause}") from None


def read_arrays(path: Path, names: Sequence[str]) -> Arrays:
    """Return the datasets at the named paths, such as ``run/q``.

    Raises
    ------
    RecordingError
        If the file is not HDF5, or a path is missing or leads to something else.
    """
    return _datasets(path, {name: name for name in names})


def labels(path: Path, name: str) -> tuple[str, ...]:
    """Return the texts of a dataset; none of one that has no texts."""
    import h5py

    try:
        with h5py.File(path) as file:
            found = file[name]
            texts = h5py.check_string_dtype(found.dtype) is not None
            if not texts or found.size > _MOST_LABELS:
                return ()
            return tuple(map(str, found.asstr()[()].reshape(-1)))
    except _UNREADABLE as cause:
        raise RecordingError(f"{path}: {name} is not readable: {cause}") from None


def matlab_texts(path: Path, name: str) -> tuple[str, ...]:
    """Return the texts of a cell array of MATLAB 7.3; none of one with other cells."""
    import h5py

    try:
        with h5py.File(path) as file:
            found = file[name.replace(".", "/")]
            kind = found.attrs.get("MATLAB_class", b"")
            if kind not in (b"cell", "cell") or found.size > _MOST_LABELS:
                return ()
            cells = [file[place] for place in np.asarray(found[()]).T.reshape(-1)]
            if any(
                c.attrs.get("MATLAB_class", b"") not in (b"char", "char") for c in cells
            ):
                return ()
            codes = [np.asarray(c[()]).reshape(-1).tolist() for c in cells]
            return tuple("".join(map(chr, text)) for text in codes)
    except _UNREADABLE as cause:
        raise RecordingError(f"{path}: {name} is not readable: {cause}") from None


def array_units(path: Path, names: Sequence[str]) -> dict[str, str]:
    """Return the units of the named datasets from their attributes.

    Raises
    ------
    RecordingError
        As `read_arrays`.
    """
    import h5py

    said: dict[str, str] = {}
    try:
        with h5py.File(path, "r") as file:
            for name in names:
                whole, key = _column(file, name) or (name, None)
                dataset = _dataset(path, file, name, whole, columns=key is not None)
                attributes = dataset.attrs
                for key in ("units", "unit"):
                    unit = attributes.get(key)
                    if isinstance(unit, bytes):
                        unit = unit.decode(errors="replace")
                    if isinstance(unit, str):
                        said[name] = unit
    except _UNREADABLE as cause:
        raise RecordingError(f"{path}: not readable as HDF5: {cause}") from None
    return said


def read_batches(path: Path, names: Sequence[str], first: int) -> Iterator[Arrays]:
    """Yield the datasets from a sample on, in pieces.

    Parameters
    ----------
    names : sequence of str
        The first is that of time, whose length determines the axis of samples.

    Raises
    ------
    RecordingError
        As `read_arrays`.
    """
    import h5py

    try:
        with h5py.File(path, "r") as file:
            found = {
                name: _array(path, file, name, name)
                if _column(file, name)
                else _dataset(path, file, name, name)
                for name in names
            }
            samples = found[names[0]].size
            for start in range(first, samples, _ROWS):
                part = slice(start, start + _ROWS)
                yield {n: _samples(d, samples, part) for n, d in found.items()}
    except _UNREADABLE as cause:
        raise RecordingError(f"{path}: not readable as HDF5: {cause}") from None


def _samples(dataset: Any, samples: int, part: slice) -> NDArray[Any]:
    """Return some samples of a dataset, along its first axis."""
    lying = dataset.ndim == 2 and dataset.shape[0] != samples == dataset.shape[1]
    found = np.asarray(dataset[:, part].T if lying else dataset[part])
    return found[:, 0] if found.ndim == 2 and found.shape[1] == 1 else found


def read_matlab_73(path: Path, names: Sequence[str]) -> Arrays:
    """Return the variables, or the fields of structures, such as ``log.q``.

    Raises
    ------
    RecordingError
        As `read_arrays`; and if a variable is not an array of numbers in MATLAB.
    """
    return _datasets(path, {name: name.replace(".", "/") for name in names})


def _datasets(path: Path, places: dict[str, str]) -> Arrays:
    import h5py

    try:
        with h5py.File(path, "r") as file:
            return {name: _array(path, file, name, at) for name, at in places.items()}
    except _UNREADABLE as cause:
        raise RecordingError(f"{path}: not readable as HDF5: {cause}") from None


def _array(path: Path, file: Any, name: str, place: str) -> NDArray[Any]:
    whole, key = _column(file, place) or (place, None)
    found = _dataset(path, file, name, whole, columns=key is not None)
    unpacked = max(8, found.dtype.itemsize) * math.prod(found.shape)
    stored = path.stat().st_size
    require_unpacked(f"{path}: column {name!r}", unpacked, stored, RecordingError)
    if isinstance(key, int):
        return np.asarray(found[:, key])
    return np.asarray(found[()] if key is None else found[key])


def _column(file: Any, place: str) -> tuple[str, str | int] | None:
    """Return the dataset that has a column, and its field or number; None of others.

    Fields of records, and columns of frames that pandas wrote: ``df/block0_values``
    beside their names in ``df/block0_items``.
    """
    group, _, last = place.rpartition("/")
    if not group or place in file or group not in file:
        return None
    if (getattr(file[group], "dtype", None) or np.dtype(float)).names:
        return (group, last) if last in file[group].dtype.names else None
    for values, names in _frames(file, group).items():
        if last in names:
            return values, names.index(last)
    return None


def _frames(file: Any, group: str) -> dict[str, list[str]]:
    """Return the names of columns of each table that pandas wrote into a group."""
    import h5py

    found = dict[str, list[str]]()
    if not isinstance(file[group], h5py.Group):
        return found
    for key, item in file[group].items():
        names = file[group].get(f"{key.removesuffix('_values')}_items")
        datasets = all(isinstance(one, h5py.Dataset) for one in (item, names))
        if not key.endswith("_values") or not datasets:
            continue
        if names.dtype.kind == "S" and item.shape[1:] == names.shape:
            texts = [text.decode(errors="replace") for text in names[()].tolist()]
            found[f"{group}/{key}"] = texts
    return found


def _dataset(
    path: Path, file: Any, name: str, place: str, *, columns: bool = False
) -> Any:
    import h5py

    where = f"{path}: column {name!r}"
    _require_inside(where, file, place)
    found = file.get(place)
    if found is None:
        near = did_you_mean(place, _paths(file))
        raise RecordingError(f"{path}: no column {name!r}; {near}")
    if not isinstance(found, h5py.Dataset):
        near = did_you_mean(place, (f"{place}/{key}" for key in found))
        raise RecordingError(f"{where} is a group, expected a dataset; {near}")
    kind = found.attrs.get("MATLAB_class", b"double")
    kind = kind.decode(errors="replace") if isinstance(kind, bytes) else str(kind)
    if kind not in _NUMBERS or found.attrs.get("MATLAB_empty", 0):
        raise RecordingError(
            f"{where} is an empty array or a {kind} of MATLAB, expected an array of "
            "numbers. Save tables, timeseries and the like as such arrays"
        )
    kinds = "iufV" if columns else "iuf"
    if found.shape is None or found.dtype.kind not in kinds:
        raise RecordingError(
            f"{where} holds {found.dtype}, expected numbers in SI units"
        )
    if found.is_virtual or found.external:
        raise RecordingError(
            f"{where} is stored in other files, which are not opened; store its data "
            f"in this one"
        )
    return found


def _require_inside(where: str, file: Any, place: str) -> None:
    """Refuse a path that leads through a link into another file."""
    import h5py

    waiting, group = deque(place.strip("/").split("/")), ""
    for _ in range(_LINKS):
        if not waiting:
            return
        step = waiting.popleft()
        link = file.get(f"{group}/{step}", getlink=True) if step else None
        if isinstance(link, h5py.ExternalLink):
            raise RecordingError(
                f"{where} is a link into another file, {link.filename!r}, which is "
                f"not opened; copy the data into this one"
            )
        if isinstance(link, h5py.SoftLink):
            target = str(link.path)
            group = "" if target.startswith("/") else group
            waiting.extendleft(reversed(target.strip("/").split("/")))
        elif step not in ("", "."):
            group = f"{group}/{step}"
    raise RecordingError(f"{where} is reached by more than {_LINKS} links and groups")


def _paths(file: Any) -> list[str]:
    import h5py

    found: list[str] = []
    frames: dict[str, dict[str, list[str]]] = {}

    def note(name: str, item: Any) -> None:
        if not isinstance(item, h5py.Dataset):
            return
        group, _, _ = name.rpartition("/")
        if group not in frames:
            frames[group] = _frames(file, group) if group else {}
        fields = [f"{name}/{field}" for field in item.dtype.names or ()]
        columns = [f"{group}/{column}" for column in frames[group].get(name, ())]
        found.extend(columns or fields or [name])

    file.visititems(note)
    return found

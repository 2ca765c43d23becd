"""The formats of logs that can be read: one entry each.

An entry names a module of `consistent_id.recordings.readers`, imported when a file is
read.  The module of a format of arrays has ``read_arrays(path, names)`` and, unless the
entry says otherwise, ``array_names(path)``; that of a format of joint states has
``read_messages(path, topic, names, joints)`` and
``chosen_topic(path, topic, joints)``; one that can be read piece by piece has
``read_batches(path, names, first)`` and, if that depends on the file,
``in_pieces(path)``; one whose files leave something open has ``notes(path)``, and
``require_units(path, names)`` if that is the unit of the position; one in which an
array may be texts, and ``read_arrays`` has numbers alone, has ``labels(path, name)``.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, Literal

from consistent_id._support.extras import needed
from consistent_id.errors import RecordingError


@dataclass(frozen=True, slots=True)
class LogFormat:
    """A format of logs.

    Parameters
    ----------
    suffixes : tuple of str
        With the dot, in lower case.
    module : str
        The module that reads it.
    library, extra : str
        The library that it needs, and the package's extra that installs it.
    holds : {"arrays", "joint states"}
        Named arrays or columns; or messages of joint states, which have topics.
    lists_names : bool
        Whether the names of its arrays can be listed.
    folders : bool
        Whether a log may be a folder.
    streams : bool
        Whether it can be read piece by piece, in constant memory; for a single file,
        see `in_pieces`.
    states_units : bool
        Whether arrays may state units: its module has ``array_units(path, names)``.
    is_text : bool
        Whether a row may hold what is no number: its functions also take the rows that
        will be left out.
    """

    name: str
    suffixes: tuple[str, ...]
    module: str
    library: str = ""
    extra: str = ""
    holds: Literal["arrays", "joint states"] = "arrays"
    lists_names: bool = True
    folders: bool = False
    streams: bool = False
    states_units: bool = False
    is_text: bool = False

    def in_pieces(self, path: Path) -> bool:
        """Return whether a file can be read piece by piece."""
        if not self.streams:
            return False
        in_pieces = getattr(self.reader(path), "in_pieces", None)
        return in_pieces is None or bool(in_pieces(path))

    def notes(self, path: Path) -> tuple[str, ...]:
        """Return sentences on assumptions with which a file is read, if there are."""
        notes = getattr(self.reader(path), "notes", None)
        return () if notes is None else tuple(notes(path))

    def require_units(self, path: Path, names: Sequence[str]) -> None:
        """Refuse positions of these names that cannot be in the usual units."""
        require = getattr(self.reader(path), "require_units", None)
        if require is not None:
            require(path, names)

    def reader(self, where: object) -> Any:
        """Return the module that reads the format.

        Raises
        ------
        RecordingError
            If the library that it needs is not installed; `where` is the file.
        """
        if self.library:
            what = f"{where}: reading {self.name}"
            needed(self.library, self.extra, what, RecordingError)
        return import_module(f"consistent_id.recordings.readers.{self.module}")


HDF5 = LogFormat(
    "HDF5",
    (".h5", ".hdf5"),
    "hdf5",
    "h5py",
    extra="hdf5",
    streams=True,
    states_units=True,
)

_ARROW = ("pyarrow", "parquet")  # the library, and the extra that installs it

LEROBOT = LogFormat("LeRobot", (), "lerobot", *_ARROW, folders=True)
_LEROBOT_INFO = ("meta", "info.json")  # of its folder

TABLES = LogFormat("folder of tables", (), "table_folder", folders=True)
_TEXTS = (".csv", ".tsv", ".txt", ".dat", ".asc", ".log", ".lvm", ".prn")
MESSAGES = (".yaml", ".yml", ".xml")
"""Suffixes of messages that are printed as text."""
_TABLES = (*_TEXTS, ".parquet", ".feather", ".arrow")
_BAG_INFO = "metadata.yaml"
_BAGS = (".mcap", ".db3", ".bag")

ROS_BAG = LogFormat(
    "ROS bag",
    (".mcap", ".db3", ".bag"),
    "bag",
    "rosbags",
    extra="ros",
    holds="joint states",
    lists_names=False,
    folders=True,
)

LOG_FORMATS = (
    LogFormat("CSV", (*_TEXTS, *MESSAGES), "csv", streams=True, is_text=True),
    LogFormat("Parquet", (".parquet",), "parquet", *_ARROW, streams=True),
    LEROBOT,
    LogFormat("Feather", (".feather", ".arrow"), "feather", *_ARROW, streams=True),
    LogFormat("NPZ", (".npz", ".npy"), "npz"),
    LogFormat("JSON", (".json", ".jsonl", ".ndjson"), "json_records"),
    HDF5,
    LogFormat("MATLAB", (".mat",), "mat", streams=True),
    LogFormat("PyTorch", (".pt", ".pth"), "pytorch"),
    TABLES,
    ROS_BAG,
)

_PICKLED = "a pickle can run any code and is not read; save the arrays with numpy.savez"
_UNREAD = {  # suffixes of logs that people have, and what to do
    **dict.fromkeys((".pkl", ".pickle"), f"{_PICKLED}, or a frame with to_parquet"),
    ".joblib": _PICKLED,
    **dict.fromkeys((".gz", ".zip", ".xz", ".bz2", ".7z"), "unpack it first"),
    **dict.fromkeys((".xlsx", ".xls", ".ods"), "save the sheet as CSV"),
}


def log_format(path: Path) -> LogFormat:
    """Return the format of a log, by its suffix.

    Raises
    ------
    RecordingError
        If no format has this suffix.
    """
    suffix = path.suffix.lower()
    if _is_lerobot(path):
        return LEROBOT
    if path.is_dir():
        return _folder_format(path)
    for known in LOG_FORMATS:
        if suffix in known.suffixes:
            return known
    if advice := _UNREAD.get(suffix):
        raise RecordingError(f"{path}: {advice}")
    suffixes = (suffix for known in LOG_FORMATS for suffix in known.suffixes)
    folders = (f"the folder of a {k.name}" for k in (LEROBOT, ROS_BAG))
    raise RecordingError(
        f"{path}: cannot read {path.suffix or 'files without a suffix'}, expected one "
        f"of {', '.join([*suffixes, *folders])}, a folder of tables"
    )


def _folder_format(path: Path) -> LogFormat:
    """Return the format of a folder that is no LeRobot data set."""
    if len(tables_in(path)) > 1:
        return TABLES
    files = sorted(file for file in path.iterdir() if file.is_file())
    if any(f.name == _BAG_INFO or f.suffix.lower() in _BAGS for f in files):
        return ROS_BAG
    suffixes = {suffix for known in LOG_FORMATS for suffix in known.suffixes}
    logs = [f.name for f in files if f.suffix.lower() in suffixes - {*MESSAGES}]
    said = f"give the logs {', '.join(logs)} one by one"
    if len(logs) == 1:
        said = f"give {logs[0]} in place of the folder"
    raise RecordingError(
        f"{path}: a folder without {_BAG_INFO} is not a bag, and without several "
        f"tables no recording; {said if logs else 'there is no log in it'}"
    )


def files_of(path: Path) -> tuple[Path, ...]:
    """Return the files of a log: itself, or those in its folder that are read."""
    if not path.is_dir():
        return (path,)
    if not _is_lerobot(path):
        return tuple(sorted(file for file in path.iterdir() if file.is_file()))
    data = sorted((path / "data").rglob("*.parquet"))
    return (path.joinpath(*_LEROBOT_INFO), *data)


def has_no_arrays(path: Path, names: Sequence[str]) -> bool:
    """Return whether each column belongs to one joint: in text, or of a named list."""
    form = log_format(path)
    elements = (name.startswith("observation.state.") for name in names)
    if form is TABLES:
        return all(log_format(file).name == "CSV" for file in tables_in(path))
    return form.name == "CSV" or (form is LEROBOT and any(elements))


def tables_in(folder: Path) -> tuple[Path, ...]:
    """Return the tables in a folder by name; none if it contains a bag."""
    files = sorted(file for file in folder.iterdir() if file.is_file())
    if any(file.suffix.lower() in _BAGS for file in files):
        return ()
    return tuple(file for file in files if file.suffix.lower() in _TABLES)


def _is_lerobot(path: Path) -> bool:
    """Return whether a path is a LeRobot data set, or a file of its data."""
    if path.is_dir():
        return path.joinpath(*_LEROBOT_INFO).is_file()
    if path.suffix.lower() != ".parquet":
        return False
    folders = path.absolute().parents
    return any(f.joinpath(*_LEROBOT_INFO).is_file() for f in folders[1:3])

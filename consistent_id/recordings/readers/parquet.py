"""Columns of a Parquet file."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from consistent_id.errors import RecordingError
from consistent_id.recordings.readers.arrays import Arrays
from consistent_id.recordings.readers.columns import missing_library, require


def read_parquet(path: Path, names: Sequence[str]) -> Arrays:
    """Return the named columns; what is missing in one becomes NaN.

    Raises
    ------
    RecordingError
        If the file is not Parquet, or a column is missing or holds no numbers.
    """
    try:
        import pyarrow as pa
        import pyarrow.parquet as pq
    except ImportError:
        raise missing_library(str(path), "Parquet", "pyarrow", "parquet") from None
    try:
        require(str(path), names, pq.read_schema(path).names)
        table = pq.read_table(path, columns=list(names))
    except (pa.ArrowException, OSError) as cause:
        raise RecordingError(f"{path}: not readable as Parquet: {cause}") from None
    columns = {}
    for name in names:
        kind = table[name].type
        if not (pa.types.is_floating(kind) or pa.types.is_integer(kind)):
            raise RecordingError(
                f"{path}: column {name!r} holds {kind}, expected numbers in SI units"
            )
        columns[name] = table[name].to_numpy().astype(np.float64)
    return columns

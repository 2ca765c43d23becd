"""Rows of the regressor of which only some columns are kept, ready for a QR."""

from collections.abc import Sequence
from typing import Any, Self

import numpy as np

from consistent_id._support.arrays import Array, IntArray, Matrix

_DROPPED = -1


class KeptColumns:
    """Written to like an array of shape (rows, parameters, samples).

    What is written to a column that is not kept is dropped.

    Parameters
    ----------
    kept : sequence of tuple of int
        Columns that are kept of each row.
    width : int
        Parameters.
    blocks : sequence of ndarray, each shape (samples, columns kept + 1)
        Each column contiguous, the last one left for the torque.

    Examples
    --------
    >>> rows = KeptColumns.empty([(2, 0)], width=3, samples=2)
    >>> rows[0, 0], rows[0, 1], rows[0, 2] = 5.0, 6.0, 7.0
    >>> rows.blocks[0][:, :-1].tolist()
    [[7.0, 5.0], [7.0, 5.0]]
    """

    __slots__ = ("_place", "blocks", "kept")

    def __init__(
        self, kept: Sequence[tuple[int, ...]], width: int, blocks: Sequence[Matrix]
    ) -> None:
        self.kept = tuple(kept)
        self.blocks = blocks
        self._place = np.full((len(self.kept), width), _DROPPED)
        for row, columns in enumerate(self.kept):
            self._place[row, list(columns)] = range(len(columns))

    @classmethod
    def empty(
        cls, kept: Sequence[tuple[int, ...]], width: int, samples: int
    ) -> "KeptColumns":
        """Return rows that are to be written to."""
        shapes = [(samples, len(columns) + 1) for columns in kept]
        return cls(kept, width, [np.empty(shape, order="F") for shape in shapes])

    @property
    def shape(self) -> tuple[int, int, int]:
        """Rows, parameters and samples."""
        return (*self._place.shape, len(self.blocks[0]))

    def __getitem__(self, part: tuple[slice, slice, slice]) -> "KeptColumns":
        """Return some samples of all rows and columns, as a view."""
        blocks = [block[part[2]] for block in self.blocks]
        return KeptColumns(self.kept, self._place.shape[1], blocks)

    def __setitem__(self, place: tuple[int, int], values: Any) -> None:
        row, column = place
        at = self._place[row, column]
        if at != _DROPPED:
            self.blocks[row][:, at] = values

    def copy(self) -> Self:
        """Return the rows themselves; their columns are contiguous as they are."""
        return self

    def addresses(self, row: IntArray, column: IntArray) -> IntArray:
        """Return where in memory kept columns begin."""
        first = np.array([block.ctypes.data for block in self.blocks])
        stride = np.array([block.strides[1] for block in self.blocks])
        return np.asarray(first[row] + self._place[row, column] * stride[row])


def addresses(out: Array | KeptColumns, row: IntArray, column: IntArray) -> IntArray:
    """Return where in memory the samples of entries begin."""
    if isinstance(out, KeptColumns):
        return out.addresses(row, column)
    return np.asarray(out.ctypes.data + row * out.strides[0] + column * out.strides[1])

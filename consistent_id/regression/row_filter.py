"""Rows of the regressor and their torque, filtered alike and thinned out.

A filter on motion and torque leaves the equations only nearly true: the regressor is
not linear in the motion, least of all where a joint turns back and friction jumps.  A
filter on the rows themselves and on the torque leaves them exactly true,
``sum_k h_k Y_k x = sum_k h_k tau_k``, whatever the weights of the rows.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from consistent_id._support.arrays import Array, Matrix, Vector
from consistent_id.errors import ProblemError, RecordingError
from consistent_id.regression.regressor import CHUNK

_REACH = 8  # kept samples on either side that one is mixed from
_PIECE = 4 * CHUNK  # samples that one worker compresses before factors are merged
_PASSED = 0.8  # cut-off over the new Nyquist frequency


@dataclass(frozen=True)
class RowFilter:
    """Keeps every `factor`-th row, each mixed from those around it, without lag.

    Parameters
    ----------
    factor : int
        1 keeps the rows as they are.
    """

    factor: int = 1

    def __post_init__(self) -> None:
        if not isinstance(self.factor, int) or self.factor < 1:
            raise ProblemError(
                f"decimation factor is {self.factor!r}, expected 1, 2, 3, ..."
            )

    @property
    def reach(self) -> int:
        """Samples on either side of a row that have a part in it."""
        return 0 if self.factor == 1 else _REACH * self.factor

    @cached_property
    def kernel(self) -> Vector:
        """Symmetric, of sum 1: a windowed sinc at 0.8 of the new Nyquist frequency."""
        from scipy.signal import firwin

        return np.asarray(firwin(2 * self.reach + 1, _PASSED / self.factor))

    def centres(self, samples: int, name: str) -> range:
        """Return the samples whose rows are kept, all with their full reach.

        Raises
        ------
        RecordingError
            If there is none.
        """
        kept = range(self.reach, samples - self.reach, self.factor)
        if len(kept) == 0:
            raise RecordingError(
                f"{name}: {samples} samples, of which the filter for a decimation by "
                f"{self.factor} takes {2 * self.reach + 1} for one row"
            )
        return kept

    def pieces(self, centres: range) -> Iterator[slice]:
        """Yield samples that are compressed in one go, with a reach on either side."""
        if self.factor == 1:
            size = _PIECE
        else:
            size = max((CHUNK - 2 * self.reach) // self.factor, 4 * _REACH)
        for first in range(0, len(centres), size):
            some = centres[first : first + size]
            yield slice(some[0] - self.reach, some[-1] + self.reach + 1)

    def __call__(self, rows: Matrix) -> Array:
        """Return the kept rows of a piece that begins and ends a reach beyond them."""
        if self.factor == 1:
            return rows
        from scipy.signal import upfirdn

        mixed = upfirdn(self.kernel, rows, down=self.factor, axis=0)
        first = 2 * _REACH
        last = (len(rows) - 1) // self.factor
        return np.asarray(mixed[first : last + 1])

"""The regressor's rigid-body entries, by NumPy or by compiled code, bit by bit alike.

A robot's recursion is compiled when it has been through so many samples that compiling
pays, so short recordings never wait for a compiler.  What was compiled in the past is
loaded earlier.
"""

import ctypes
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import count
from typing import Any

import numpy as np

from consistent_id._support.arrays import Array, IntArray
from consistent_id.regression.compiled.compiler import compiled, loaded, switched_on
from consistent_id.regression.compiled.straight_line import LANES, Tape
from consistent_id.regression.kept_columns import KeptColumns, addresses
from consistent_id.regression.newton_euler import (
    FreeMotion,
    JointGeometry,
    JointMotion,
    Vec,
    regressor_entries,
)

# Looking for compiled code costs about as much as the recursion of so many samples in
# NumPy, compiling it as much as that of so many: `benchmarks/compiled.py`.
LOOK_AFTER = 20_000
COMPILE_AFTER = 300_000

_LARGEST = 2000  # entries; the time to compile grows faster than what is saved
_NAME = "entries"
_ALIKE = 1e-12  # relative difference to NumPy's numbers that compiled code may have
_CHECKED = 3 * LANES + 1  # samples on which it is compared


def fill_entries(
    out: Array | KeptColumns,
    rows: Mapping[int, int],
    joints: Sequence[JointGeometry],
    gravity: Vec,
    motion: Sequence[JointMotion | FreeMotion],
) -> None:
    """Write the entries of `regressor_entries` of the coordinates that have a row.

    Parameters
    ----------
    out : ndarray or KeptColumns, shape (rows, parameters, samples)
        An array has zeros where an entry is zero for every motion.
    rows : mapping of int to int
        Row of each generalised coordinate that has one.
    joints, gravity, motion
        As `regressor_entries` takes them; the motion's scalars are arrays.
    """
    samples = out.shape[2]
    if samples >= LANES and switched_on():
        arrays: list[Array] = []
        structure = _parted(motion, arrays)
        kept = out.kept if isinstance(out, KeptColumns) else None
        recursion = _recursion(
            tuple(rows.items()), tuple(joints), gravity, structure, kept
        )
        kernel = recursion.kernel(samples)
        if kernel is not None:
            kernel(out, arrays)
            return
    _by_numpy(out, rows, joints, gravity, motion)


def _by_numpy(
    out: Array | KeptColumns,
    rows: Mapping[int, int],
    joints: Sequence[JointGeometry],
    gravity: Vec,
    motion: Sequence[JointMotion | FreeMotion],
) -> None:
    for j, k, entries in regressor_entries(joints, gravity, motion):
        if j in rows:
            for i, entry in enumerate(entries, start=10 * k):
                out[rows[j], i] = entry


@dataclass(frozen=True, slots=True)
class _Kernel:
    """Compiled code, and the places in `out` that it writes to."""

    function: Any
    places: tuple[IntArray, IntArray]

    def __call__(self, out: Array | KeptColumns, arrays: Sequence[Array]) -> None:
        given = [np.ascontiguousarray(x, dtype=np.float64) for x in arrays]
        sources = np.array([x.ctypes.data for x in given], dtype=np.uintp)
        targets = addresses(out, *self.places).astype(np.uintp)
        self.function(
            ctypes.c_void_p(sources.ctypes.data),
            ctypes.c_void_p(targets.ctypes.data),
            ctypes.c_long(out.shape[2]),
        )


@dataclass(slots=True, eq=False)
class _Recursion:
    """One robot's recursion: how much it has been used, and its compiled code."""

    rows: Mapping[int, int]
    joints: Sequence[JointGeometry]
    gravity: Vec
    structure: Any
    kept: Sequence[tuple[int, ...]] | None
    used: int = 0
    found: _Kernel | None = None
    steps: list[Callable[[str, str], Any]] = field(
        default_factory=lambda: [loaded, compiled]
    )
    lock: threading.Lock = field(default_factory=threading.Lock)

    def kernel(self, samples: int) -> _Kernel | None:
        """Return compiled code if there is some, or if it is time for it.

        While one thread compiles, others go on without.
        """
        self.used += samples
        after = {2: LOOK_AFTER, 1: COMPILE_AFTER}.get(len(self.steps))
        if (
            self.found is None
            and after is not None
            and self.used >= after
            and self.lock.acquire(blocking=False)
        ):
            try:
                self.found = self._made(self.steps.pop(0)) if self.steps else None
            finally:
                self.lock.release()
        return self.found

    def _made(self, step: Callable[[str, str], Any]) -> _Kernel | None:
        outputs, places, tape = self._traced()
        if len(outputs) > _LARGEST:
            self.steps.clear()
            return None
        function = step(tape.source(_NAME, outputs), _NAME)
        if function is None:
            return None
        kernel = _Kernel(function, places)
        return kernel if self._is_right(kernel) else None

    def _traced(self) -> tuple[list[Any], tuple[IntArray, IntArray], Tape]:
        """Return entries, their rows and columns, and how they are computed."""
        tape = Tape()
        motion = _filled(self.structure, map(tape.input, count()))
        outputs, places = [], []
        for j, k, entries in regressor_entries(self.joints, self.gravity, motion):
            if j not in self.rows:
                continue
            row = self.rows[j]
            for i, entry in enumerate(entries, start=10 * k):
                zero = isinstance(entry, float) and entry == 0.0
                if i in self.kept[row] if self.kept is not None else not zero:
                    outputs.append(entry)
                    places.append((row, i))
        at, column = np.array(places, dtype=np.intp).reshape(-1, 2).T
        return outputs, (at, column), tape

    def _is_right(self, kernel: _Kernel) -> bool:
        """Return whether the code computes what NumPy does, on random numbers."""
        rng = np.random.default_rng(0)
        motion = _filled(self.structure, (rng.normal(size=_CHECKED) for _ in count()))
        shape = max(self.rows.values()) + 1, 10 * len(self.joints), _CHECKED
        truth, found = np.zeros(shape), np.zeros(shape)
        _by_numpy(truth, self.rows, self.joints, self.gravity, motion)
        arrays: list[Array] = []
        _parted(motion, arrays)
        kernel(found, arrays)
        row, column = kernel.places
        error = abs(found[row, column] - truth[row, column]).max(initial=0.0)
        return bool(error <= _ALIKE * abs(truth).max())


@lru_cache(maxsize=32)
def _recursion(
    rows: tuple[tuple[int, int], ...],
    joints: tuple[JointGeometry, ...],
    gravity: Vec,
    structure: Any,
    kept: tuple[tuple[int, ...], ...] | None,
) -> _Recursion:
    return _Recursion(dict(rows), joints, gravity, structure, kept)


def _parted(value: Any, arrays: list[Array]) -> Any:
    """Return nested tuples with None for each array, and append the arrays."""
    if isinstance(value, np.ndarray):
        arrays.append(value)
        return None
    if isinstance(value, list | tuple):
        return _like(value, [_parted(x, arrays) for x in value])
    return value


def _filled(structure: Any, scalars: Iterator[Any]) -> Any:
    """Return nested tuples with scalars where `_parted` has taken arrays out."""
    if structure is None:
        return next(scalars)
    if isinstance(structure, tuple):
        return _like(structure, [_filled(x, scalars) for x in structure])
    return structure


def _like(value: Sequence[Any], content: Sequence[Any]) -> Any:
    make = getattr(value, "_make", tuple)  # of named tuples
    return make(content)

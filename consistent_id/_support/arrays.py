"""Array aliases, and the one place where a value's arrays are copied and frozen."""

from collections.abc import Iterator, Mapping
from dataclasses import field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from consistent_id.errors import ProblemError

Array = NDArray[np.float64]
Vector = Array
Matrix = Array
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.intp]


def frozen(
    values: ArrayLike,
    shape: tuple[int | None, ...],
    what: str,
    error: type[Exception] = ProblemError,
    finite: bool = True,
) -> Array:
    """Return a read-only float64 copy of `values`, of the given shape and finite.

    A ``None`` in `shape` stands for any length.
    """
    array = checked(values, shape, what, error, finite).copy()
    array.setflags(write=False)
    return array


def freeze(value: object, **fields: object) -> None:
    """Set fields of a frozen dataclass; called from its ``__post_init__`` alone."""
    for name, content in fields.items():
        object.__setattr__(value, name, content)


def freeze_arrays(
    value: object,
    shapes: Mapping[str, tuple[int | None, ...]],
    where: str = "",
    error: type[Exception] = ProblemError,
    finite: bool = True,
) -> None:
    """Replace array fields of a frozen dataclass by what `frozen` makes of them.

    Parameters
    ----------
    shapes : mapping of str to tuple
        By field.
    where : str
        The beginning of messages.
    error, finite
        See `frozen`.
    """
    for name, shape in shapes.items():
        what = f"{where}: {name}" if where else name
        array = frozen(getattr(value, name), shape, what, error, finite)
        freeze(value, **{name: array})


def chunks(samples: int, size: int) -> Iterator[slice]:
    """Yield slices of `size` consecutive samples each; the last may be shorter."""
    for start in range(0, samples, max(size, 1)):
        yield slice(start, min(start + size, samples))


def array_default(values: ArrayLike) -> Any:
    """Return the dataclass field of an array whose default is `values`."""
    return field(default_factory=lambda: np.array(values, dtype=np.float64))


def number(value: object, what: str) -> float:
    """Return one number as a float, finite or not.

    Raises
    ------
    ProblemError
        If it is none; a text of digits is none either.
    """
    if isinstance(value, str | bytes | bool | np.bool_):
        raise ProblemError(f"{what} is {value!r}, expected a number")
    try:
        return float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        raise ProblemError(f"{what} is {value!r}, expected a number") from None


def checked(
    values: ArrayLike,
    shape: tuple[int | None, ...],
    what: str,
    error: type[Exception] = ProblemError,
    finite: bool = True,
) -> Array:
    """Return `values` as float64, checked like `frozen`, without a copy if possible."""
    if np.ma.isMaskedArray(values):
        raise error(f"{what}: a masked array, expected plain numbers without gaps")
    try:
        array = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError) as cause:
        raise error(f"{what}: expected numbers of shape {shape}, got {cause}") from None
    fits = array.ndim == len(shape) and all(
        want is None or want == have
        for want, have in zip(shape, array.shape, strict=True)
    )
    if not fits:
        wanted = "(" + ", ".join("any" if n is None else str(n) for n in shape) + ")"
        raise error(f"{what}: expected shape {wanted}, got {array.shape}")
    if finite and not np.isfinite(array).all():
        place = tuple(int(i) for i in np.argwhere(~np.isfinite(array))[0])
        raise error(f"{what}: entry {place} is {array[place]}, expected finite numbers")
    return array

"""Caches of computed values: while an object exists, or for arrays of equal numbers."""

from collections import OrderedDict
from collections.abc import Callable, Hashable
from functools import wraps
from hashlib import blake2b
from math import inf
from sys import getsizeof
from threading import RLock
from typing import Any, ParamSpec, TypeVar
from weakref import ref

import numpy as np

from consistent_id._support.arrays import Array

_P = ParamSpec("_P")
_R = TypeVar("_R")


def kept_for_equal(
    most: int,
) -> Callable[[Callable[[Array], _R]], Callable[[Array], _R]]:
    """Keep results of a function of one array, for arrays of equal numbers.

    Arrays themselves are not kept, only their digests.

    Parameters
    ----------
    most : int
        Results that are kept; the oldest go first.

    Examples
    --------
    >>> @kept_for_equal(most=2)
    ... def largest(values):
    ...     print("computed")
    ...     return float(values.max())
    >>> largest(np.arange(3.0)), largest(np.arange(3.0))
    computed
    (2.0, 2.0)
    """

    def decorated(function: Callable[[Array], _R]) -> Callable[[Array], _R]:
        found: dict[Hashable, _R] = {}
        held = RLock()

        @wraps(function)
        def run(values: Array) -> _R:
            digest = blake2b(np.ascontiguousarray(values).data).digest()
            key = (digest, values.shape, values.dtype.str)
            with held:
                if key in found:
                    return found[key]
            result = function(values)
            with held:
                found[key] = result
                if len(found) > most:
                    del found[next(iter(found))]
            return result

        return run

    return decorated


def kept_with(
    place: int | None,
    most: int,
    *,
    room: float = inf,
    size: Callable[[Any], int] = getsizeof,
) -> Callable[[Callable[_P, _R]], Callable[_P, _R]]:
    """Keep results of a function while one of its arguments is alive.

    Unlike `functools.lru_cache`, which keeps its arguments alive, too: logs would stay
    in memory when nobody needs them any more.  Threads may call the function; two of
    them may compute the same result.

    Parameters
    ----------
    place : int, optional
        The argument's place; arguments are distinguished by identity.  None: results
        are kept for equal arguments, until others need the room.
    most : int
        Results that are kept; those not used for the longest time go first.
    room : float, [bytes]
        Memory for all kept results; the newest is kept in any case.
    size : callable
        The bytes of a result.

    Examples
    --------
    >>> @kept_with(0, most=2)
    ... def sized(values):
    ...     print("computed")
    ...     return len(values)
    >>> values = frozenset("abc")
    >>> sized(values), sized(values)
    computed
    (3, 3)
    """

    def decorated(function: Callable[_P, _R]) -> Callable[_P, _R]:
        found: OrderedDict[Hashable, tuple[ref[Any], _R]] = OrderedDict()
        held = (
            RLock()
        )  # an object may end, and its results go, in the thread that has it

        def taken() -> float:
            kept = list(found.values()) if room < inf else []
            return sum(size(result) for _, result in kept)

        def forget(key: Hashable) -> None:
            with held:
                found.pop(key, None)

        @wraps(function)
        def run(*args: _P.args, **kwargs: _P.kwargs) -> _R:
            owner: Any = run if place is None else args[place]
            others = args if place is None else (*args[:place], *args[place + 1 :])
            key = (id(owner), *others)
            with held:
                before = found.get(key)
                if before is not None and before[0]() is owner:
                    found.move_to_end(key)  # the last that goes
                    return before[1]
            result = function(*args, **kwargs)
            with held:
                found[key] = ref(owner, lambda _: forget(key)), result
                while len(found) > most or (len(found) > 1 and taken() > room):
                    found.popitem(last=False)
            return result

        return run

    return decorated

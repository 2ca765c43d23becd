"""What is left when each part is left out, without joining all others each time."""

from collections.abc import Callable, Sequence
from itertools import accumulate
from typing import TypeVar

_T = TypeVar("_T")


def all_but_each(parts: Sequence[_T], joined: Callable[[_T, _T], _T]) -> list[_T]:
    """Return, for each of two parts or more, all others joined in their order.

    Examples
    --------
    >>> all_but_each(["a", "b", "c"], lambda first, second: first + second)
    ['bc', 'ac', 'ab']
    """
    before = list(accumulate(parts[:-1], joined))
    after = list(accumulate(reversed(parts[1:]), lambda a, b: joined(b, a)))[::-1]
    middle = [joined(a, b) for a, b in zip(before, after[1:], strict=False)]
    return [after[0], *middle, before[-1]]

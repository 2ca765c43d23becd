"""The progress of long work, on the standard error, for users who want to see it.

A terminal shows a bar; a file or a pipe gets a line now and then.
"""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from time import monotonic
from typing import Protocol

_PAUSE = 5.0  # s: between lines of work that is counted


class Counter(Protocol):
    """Takes how much is done, and what else to say."""

    def __call__(self, done: int, says: str = "") -> None: ...


@contextmanager
def stages(total: int, shown: bool) -> Iterator[Callable[[str], None]]:
    """Yield a function to call with the name of each stage as it begins.

    Parameters
    ----------
    total : int
        Number of stages.
    shown : bool
        Whether anything is written.
    """
    begun = 0
    with _display(
        total, shown, "{n_fmt}/{total_fmt} {bar:20} {desc} [{elapsed}]"
    ) as show:

        def begin(stage: str) -> None:
            nonlocal begun
            show(begun, stage)
            begun += 1

        yield begin


@contextmanager
def counted(total: int, what: str, shown: bool) -> Iterator[Counter]:
    """Yield a function to call as work proceeds.

    Parameters
    ----------
    total : int
        The number of items in all.
    what : str
        The noun for the items, in the plural.
    shown : bool
        Whether anything is written.
    """
    form = "{n_fmt}/{total_fmt} {bar:20} {desc} [{elapsed}<{remaining}]"
    with _display(total, shown, form) as show:
        written = monotonic()

        def count(done: int, says: str = "") -> None:
            nonlocal written
            now = monotonic()
            if _is_terminal() or now - written >= _PAUSE:
                show(done, f"{what} {says}".rstrip())
                written = now

        show(0, what)
        yield count


@contextmanager
def _display(
    total: int, shown: bool, form: str
) -> Iterator[Callable[[int, str], None]]:
    if not shown:
        yield lambda done, says: None
        return
    if not _is_terminal():
        started = monotonic()

        def write(done: int, says: str) -> None:
            seconds = monotonic() - started
            sys.stderr.write(f"{done}/{total} {says} [{seconds:.0f} s]\n")
            sys.stderr.flush()

        yield write
        return
    from tqdm import tqdm

    with tqdm(total=total, leave=False, bar_format=form) as bar:

        def draw(done: int, says: str) -> None:
            bar.set_description_str(says, refresh=False)
            bar.update(done - bar.n)
            bar.refresh()

        yield draw


def _is_terminal() -> bool:
    return sys.stderr.isatty()

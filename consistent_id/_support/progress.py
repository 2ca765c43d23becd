"""The progress of long work, on the standard error, for users who want to see it.

A terminal shows a bar; a file or a pipe gets one line at the start and one at the end.
What is read is said before that, at once.
"""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from time import monotonic
from typing import Protocol


class Counter(Protocol):
    """Takes how much is done, and what else to say."""

    def __call__(self, done: int, says: str = "") -> None: ...


def begun(words: str, shown: bool) -> None:
    """Say what begins, before the libraries are imported that do it.

    Parameters
    ----------
    words : str
        Such as ``reading log.csv``.
    shown : bool
        Whether anything is written.
    """
    if shown:
        sys.stderr.write(f"{words} ...\n")
        sys.stderr.flush()


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
            show(min(begun, total - 1), stage)  # work that is done again is one stage
            begun += 1

        yield begin
        show(total, "done")


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
    last = 0, ""
    with _display(total, shown, form) as show:

        def count(done: int, says: str = "") -> None:
            nonlocal last
            last = done, says
            show(done, f"{what} {says}".rstrip())

        show(0, what)
        yield count
        done, says = last
        show(done, f"{what} done {says}".rstrip())


@contextmanager
def _display(
    total: int, shown: bool, form: str
) -> Iterator[Callable[[int, str], None]]:
    if not shown:
        yield lambda done, says: None
        return
    if not _is_terminal():
        started, last = monotonic(), (-1, "")

        def write(done: int, says: str) -> None:
            nonlocal last
            if last[0] < 0:
                _line(done, total, says, 0.0)
            last = done, says

        yield write
        if last[0] >= 0:
            _line(last[0], total, last[1], monotonic() - started)
        return
    from tqdm import tqdm

    with tqdm(total=total, leave=False, bar_format=form) as bar:

        def draw(done: int, says: str) -> None:
            bar.set_description_str(says, refresh=False)
            bar.update(done - bar.n)
            bar.refresh()

        yield draw


def _line(done: int, total: int, says: str, seconds: float) -> None:
    sys.stderr.write(f"{done}/{total} {says} [{seconds:.0f} s]\n")
    sys.stderr.flush()


def _is_terminal() -> bool:
    return sys.stderr.isatty()

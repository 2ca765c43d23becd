"""How far long work is, on the standard error, for whoever asked to see it."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager


@contextmanager
def stages(total: int, shown: bool) -> Iterator[Callable[[str], None]]:
    """Yield a function to call with the name of each stage as it begins.

    Parameters
    ----------
    total : int
        Number of stages.
    shown : bool
        Whether a bar is drawn.
    """
    if not shown:
        yield lambda stage: None
        return
    from tqdm import tqdm

    form = "{n_fmt}/{total_fmt} {bar:20} {desc} [{elapsed}]"
    with tqdm(total=total, leave=False, bar_format=form) as bar:
        begun = False

        def begin(stage: str) -> None:
            nonlocal begun
            bar.update(int(begun))
            bar.set_description_str(stage)
            begun = True

        yield begin

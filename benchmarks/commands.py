"""CPU seconds of commands, as multiples of a fixed reference of the same minute.

``python benchmarks/commands.py [--repeat 3] [--only WORD ...] [--against FOLDER]
[--write docs/benchmarks.md]``.  Each command and each reference runs in a fresh process
with one thread for BLAS, and with compiled bytecode.  A multiple divides the command's
seconds by the mean of the references just before and after it; the median of the
repetitions is shown.  "Answer after" are seconds of a clock until the verdict is on the
screen.  Needs the recordings, see ``CONSISTENT_ID_DATASETS`` in README.
"""

import argparse
import os
import resource
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory, TemporaryFile
from time import perf_counter, process_time
from typing import NamedTuple

import numpy as np
from pages import written_to

HERE = Path(__file__).resolve().parents[1]
DATA = Path(os.environ.get("CONSISTENT_ID_DATASETS", "datasets"))
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


class Timed(NamedTuple):
    """A command whose processor seconds are counted.

    Parameters
    ----------
    name : str
    words : tuple of str
        Arguments of ``consistent-id``; ``OUT`` is a folder of its own.
    target : float
        Most multiples of the reference.
    before : tuple of str
        Arguments of a command that runs before, whose seconds do not count.
    """

    name: str
    words: tuple[str, ...]
    target: float
    before: tuple[str, ...] = ()


_LOG = (
    str(DATA / "ur10e/ur10e.urdf"),
    str(DATA / "ur10e/identification/ur-20_02_10-30sec_12harm.parquet"),
    *("--torque", "current{number}", "--torque-gain"),
    *("10.0", "10.6956", "8.4566", "9.0029", "9.48", "10.1232"),
)
_KUKA = ("problems/kuka_kr300/robot.urdf", "problems/kuka_kr300/FF_A.csv")
_COMPARE = ("compare", "problems/ur10e", "--output", "OUT")
TIMED = (
    Timed("compare ur10e", _COMPARE, 4.0),
    Timed("report ur10e", ("report", "problems/ur10e", "--output", "OUT/a.html"), 5.5),
    Timed("identify, log of the KUKA", ("identify", *_KUKA), 7.0),
    Timed("identify, 30 s of six joints", ("identify", *_LOG), 7.0),
    Timed("check ur10e", ("check", "problems/ur10e"), 1.8),
    Timed("results opened again", ("compare", "OUT"), 1.0, _COMPARE),
    Timed("check staubli_tx40", ("check", "problems/staubli_tx40"), 0.0),
    Timed("check unitree_go2", ("check", "problems/unitree_go2"), 0.0),
)


def reference() -> float:
    """Return the processor seconds of fixed work: QR, Python's loop, eigenvalues."""
    rng = np.random.default_rng(0)
    tall, square = rng.normal(size=(4096, 60)), rng.normal(size=(40, 40))
    start = process_time()
    for _ in range(60):
        np.linalg.qr(tall)
    x = 0.0
    for i in range(3_000_000):
        x = x * 0.5 + i
    for _ in range(300):
        np.linalg.eigh(square + square.T)
    return process_time() - start


def main() -> None:
    """Print the table, of this checkout and perhaps of another."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeat", type=int, default=3)
    parser.add_argument("--only", nargs="+", metavar="WORD", help="of commands' names")
    parser.add_argument("--against", type=Path, metavar="FOLDER", help="other checkout")
    parser.add_argument("--write", type=Path, help="page whose part is renewed")
    parser.add_argument("--reference", action="store_true", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.reference:
        print(reference())
        return
    with TemporaryDirectory() as cache:
        os.environ["PYTHONPYCACHEPREFIX"] = cache
        os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
        os.environ.update(dict.fromkeys(THREADS, "1"))
        trees = [HERE, *([given.against.resolve()] if given.against else [])]
        with written_to(given.write, "commands"):
            _print_table(trees, given.only or [""], given.repeat)


def _print_table(trees: Sequence[Path], words: Sequence[str], repeat: int) -> None:
    names = ["", *(" of the other checkout" for _ in trees[1:])]
    print(
        "| command |"
        + "".join(f" s{n} | multiple{n} | answer after{n} |" for n in names)
        + " target |"
    )
    print("|---|" + "---:|---:|---:|" * len(trees) + "---:|")
    references = []
    for tree in trees:
        for warm in (_COMPARE, ("info", "problems/unitree_go2")):  # compile modules
            with TemporaryDirectory() as folder:
                _seconds(tree, warm, folder)
    for timed in TIMED:
        if not any(word in timed.name for word in words):
            continue
        cells = ""
        for tree in trees:
            runs = [_multiple(tree, timed) for _ in range(repeat)]
            references += [run[1] for run in runs]
            cells += f" {median(run[0] for run in runs):.2f} |"
            cells += f" {median(run[0] / run[1] for run in runs):.1f} |"
            cells += f" {median(run[2] for run in runs):.1f} s |"
        target = f"{timed.target:g}" if timed.target else ""
        print(f"| {timed.name} |{cells} {target} |", flush=True)
    low, middle, high = np.quantile(references, (0, 0.5, 1))
    print(f"\nThe reference took {middle:.2f} s ({low:.2f} to {high:.2f}); ", end="")
    print(f"medians of {repeat} run(s).")


def _multiple(tree: Path, timed: Timed) -> tuple[float, float, float]:
    """Return what a command costs, and seconds of the references around it."""
    with TemporaryDirectory() as folder:
        if timed.before:
            _seconds(tree, timed.before, folder)
        first = _reference(tree)
        spent, answered = _seconds(tree, timed.words, folder)
        return spent, 0.5 * (first + _reference(tree)), answered


def _reference(tree: Path) -> float:
    return float(_run(tree, [str(Path(__file__).resolve()), "--reference"])[0])


def _seconds(tree: Path, words: Sequence[str], folder: str = "") -> tuple[float, float]:
    """Return a command's processor seconds, and those of a clock until it answers."""
    given = [word.replace("OUT", folder, 1) for word in words]
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    _, answered = _run(tree, ["-m", "consistent_id", *given])
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    spent = after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime
    return spent, answered


def _run(tree: Path, words: Sequence[str]) -> tuple[str, float]:
    """Return what a process prints, and the seconds until its first line."""
    environment = {**os.environ, "PYTHONPATH": str(tree), "PYTHONUNBUFFERED": "1"}
    begun = perf_counter()
    with TemporaryFile("w+") as errors:
        with subprocess.Popen(
            [sys.executable, *words],
            cwd=tree,
            env=environment,
            stdout=subprocess.PIPE,
            stderr=errors,
            text=True,
        ) as process:
            first = process.stdout.readline()
            answered = perf_counter() - begun
            printed = first + process.stdout.read()
        if process.returncode not in (0, 1):  # 1: what is not to be used
            errors.seek(0)
            raise SystemExit(f"{tree}: {' '.join(words)}: {errors.read()}")
    return printed, answered


if __name__ == "__main__":
    main()

"""What commands do more than once, and the CPU seconds they take.

``python benchmarks/calls.py [--against FOLDER]``: the folder is another checkout,
which is counted and timed in the same run, command by command.  Needs the
recordings, see ``CONSISTENT_ID_DATASETS`` in README.
"""

import argparse
import importlib
import os
import pkgutil
import resource
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parents[1]
DATA = Path(os.environ.get("CONSISTENT_ID_DATASETS", "datasets"))
COUNTED = {
    "file reads": ("read_recording",),
    "filters": ("low_passed",),
    "differentiations": (
        "differentiated",
        "kalman_differentiated",
        "savitzky_golay_differentiated",
    ),
    "regressions built": ("build_regression",),
    "cone programmes": ("solve_cones", "solve_costs"),
    "quadratic programmes over one set, solved together": (
        "minimisers",
        "solve_squares",
    ),
    "constraints lowered": ("lowered",),
}
LOG = (
    "identify",
    str(DATA / "ur10e/ur10e.urdf"),
    str(DATA / "ur10e/identification/ur-20_02_10-30sec_12harm.parquet"),
    "--torque",
    "current{number}",
    "--torque-gain",
    *("10.0", "10.6956", "8.4566", "9.0029", "9.48", "10.1232"),
)
KUKA = (  # the other checkout may not have these files yet
    "identify",
    str(HERE / "problems/kuka_kr300/robot.urdf"),
    str(HERE / "problems/kuka_kr300/FF_A.csv"),
)
PLAIN = "--no-select"  # of checkouts that select models
TIMED = (
    ("compare", "problems/rx60", "--output", "OUT"),
    ("compare", "problems/ur10e", "--output", "OUT"),
    ("report", "problems/ur10e", "--output", "OUT/report.html"),
    KUKA,
    (*KUKA, PLAIN),
    LOG,
    (*LOG, PLAIN),
    ("check", "problems/ur10e"),
)


def main() -> None:
    """Print counts and CPU seconds, of this checkout and of another."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--against", type=Path, metavar="FOLDER")
    parser.add_argument("--count", nargs=argparse.REMAINDER, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.count is not None:
        _print_counts(options.count)
        return
    with tempfile.TemporaryDirectory() as cache:
        # Counting imports, and so compiles, every module before anything is timed.
        os.environ["PYTHONPYCACHEPREFIX"] = cache
        os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
        _print_tables([HERE, *([options.against.resolve()] if options.against else [])])


def _print_tables(trees: Sequence[Path]) -> None:
    header = ["this checkout", *(str(tree) for tree in trees[1:])]
    print(f"{_shown(LOG)}: number of calls")
    columns = [_counts(tree) for tree in trees]
    _line("", header)
    for what in COUNTED:
        _line(what, [str(column.get(what, 0)) for column in columns])
    print("\nCPU seconds of a process, user and system")
    _line("", [*header, "ratio"][: len(header) + len(trees) - 1])
    for tree in trees:
        _seconds(tree, TIMED[1])  # compiles the libraries
    for command in TIMED:
        seconds = [_seconds(tree, command) for tree in trees]
        ratio = [f"{seconds[0] / s:.2f}" for s in seconds[1:]]
        _line(_shown(command), [*(f"{s:.1f}" for s in seconds), *ratio])


def _shown(command: Sequence[str]) -> str:
    words = [Path(word).name if word.startswith("/") else word for word in command]
    shown = " ".join(words).split(" --")[0]
    return f"{shown} {PLAIN}" if PLAIN in command else shown


def _line(name: str, cells: Sequence[str]) -> None:
    print(f"  {name:58s}" + "".join(f"{cell:>16s}" for cell in cells), flush=True)


def _seconds(tree: Path, command: Sequence[str]) -> float:
    """Return the CPU seconds of a command in a process of its own."""
    with tempfile.TemporaryDirectory() as folder:
        words = [word.replace("OUT", folder, 1) for word in command]
        if PLAIN in words and not _selects(tree):
            words.remove(PLAIN)
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        _run(tree, ["-m", "consistent_id", *words])
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
    user, system = after.ru_utime - before.ru_utime, after.ru_stime - before.ru_stime
    return user + system


def _selects(tree: Path) -> bool:
    return (tree / "consistent_id/problems/selection").is_dir()


def _counts(tree: Path) -> dict[str, int]:
    output = _run(tree, [str(Path(__file__).resolve()), "--count", *LOG])
    lines = (line.rsplit(" ", 1) for line in output.splitlines())
    return {name: int(number) for name, number in lines}


def _run(tree: Path, words: Sequence[str]) -> str:
    done = subprocess.run(
        [sys.executable, *words],
        cwd=tree,
        env={**os.environ, "PYTHONPATH": str(tree)},
        check=False,
        capture_output=True,
        text=True,
    )
    if done.returncode not in (0, 1):  # 1: no estimate, or a faulty log
        raise SystemExit(f"{tree}: {' '.join(words)}: {done.stderr}")
    return done.stdout


def _print_counts(command: Sequence[str]) -> None:
    """Run a command in this process and print how often functions were called."""
    import consistent_id

    modules = [
        importlib.import_module(found.name)
        for found in pkgutil.walk_packages(consistent_id.__path__, "consistent_id.")
        if not found.name.endswith("__main__")
    ]
    counts: Counter[str] = Counter()
    for what, names in COUNTED.items():
        for module in modules:
            for name in names:
                if callable(work := vars(module).get(name)):
                    setattr(module, name, _counting(work, what, counts))
    from consistent_id.cli import main as shell

    with open(os.devnull, "w") as nowhere, redirect_stdout(nowhere):
        code = shell(list(command))
    for what in COUNTED:
        print(what, counts[what])
    raise SystemExit(code)


def _counting(
    work: Callable[..., Any], what: str, counts: Counter[str]
) -> Callable[..., Any]:
    def run(*args: Any, **options: Any) -> Any:
        counts[what] += 1
        return work(*args, **options)

    return run


if __name__ == "__main__":
    main()

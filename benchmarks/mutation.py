"""Do the tests notice a wrong token? Changes one token of the core at a time.

``python benchmarks/mutation.py --count 60 --seed 0`` copies the repository to a
temporary folder, changes one operator, sign, comparison or constant, and runs the fast
tests: first those of the room that the token is in, then of the room next to it, then
all others. A mutant that no test notices is printed with its line. Mutants that cannot
be noticed, because the program does the same, are listed in ``mutation.toml`` with the
reason.

The sample is ordered by a hash of seed, file and line, so that a change elsewhere in
the code does not draw another one.
"""

from __future__ import annotations

import argparse
import ast
import hashlib
import importlib
import multiprocessing
import os
import random
import re
import shutil
import sys
import tempfile
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parent.parent
PACKAGE = "consistent_id"

#: What is changed: folders and files of the package, all that decides a number; of
#: these, not the figures (``*_plot.py``).
CORE = "regression constraints estimation comparison recordings/signals".split()
CORE += [f"robot/{n}.py" for n in "inertia log_cholesky model scaling solids".split()]
#: Folders of tests that a room's mutants meet first, in this order.
TESTS = {
    "robot": ("robot", "regression"),
    "recordings": ("recordings", "estimation"),
    "regression": ("regression", "estimation"),
    "constraints": ("constraints", "estimation"),
    "estimation": ("estimation", "comparison"),
    "comparison": ("comparison", "estimation"),
}
#: Operator, how it is written, and what it becomes.
TABLE = """Add + -, Sub - +, Mult * /, Div / *, Pow ** *, FloorDiv // *, Mod % *,
BitAnd & |, BitOr | &, Lt < <= >, LtE <= < >=, Gt > >= <, GtE >= > <=, Eq == !=,
NotEq != ==, And and or, Or or and"""
SWAPS = {
    getattr(ast, n): (old, new) for n, old, *new in map(str.split, TABLE.split(","))
}
SWAPS |= {ast.USub: ("-", [""]), ast.Not: ("not", ["not not"])}
#: Mutated lines that no test can notice, each with the reason.
EQUIVALENT = tomllib.loads((ROOT / "benchmarks/mutation.toml").read_text())


#: Arguments that only refuse what is never given: lengths of zip, numbers of SciPy.
GUARDS = ("strict", "check_finite")

#: Forked processes need not import these again.
LIBRARIES = ("scipy.linalg", "scipy.optimize", "scipy.interpolate")
LIBRARIES += ("pinocchio", "casadi", "clarabel", "cvxpy", "pytest")
FORK = multiprocessing.get_context("fork")


@dataclass(frozen=True, slots=True)
class Mutant:
    """One changed token: bytes `start` to `end` of a file become `new`."""

    path: str
    line: int
    start: int
    end: int
    new: str
    source: bytes

    @property
    def content(self) -> bytes:
        """The whole file with the change."""
        return self.source[: self.start] + self.new.encode() + self.source[self.end :]

    @property
    def changed(self) -> str:
        """The changed line."""
        return self.content.decode().splitlines()[self.line - 1].strip()

    def rank(self, seed: int) -> bytes:
        """Return a place in the sample, independent of all other lines."""
        line = self.source.splitlines()[self.line - 1].strip()
        key = f"{seed} {self.path} {line.decode()} {self.changed}"
        return hashlib.sha256(key.encode()).digest()


def mutants_of(path: Path, rng: random.Random) -> Iterator[Mutant]:
    """All mutants of a file, one for each token that can be changed."""
    source = path.read_bytes()
    starts = [0]
    for line in source.splitlines(keepends=True):
        starts.append(starts[-1] + len(line))

    def begin(node: ast.expr) -> int:
        return starts[node.lineno - 1] + node.col_offset

    def end(node: ast.expr) -> int:
        return starts[(node.end_lineno or 0) - 1] + (node.end_col_offset or 0)

    def mutant(start: int, stop: int, new: str) -> Mutant:
        line = source.count(b"\n", 0, start) + 1
        name = path.relative_to(ROOT / PACKAGE).as_posix()
        return Mutant(name, line, start, stop, new, source)

    def swapped(op: ast.AST, low: int, high: int) -> Iterator[Mutant]:
        if type(op) in SWAPS:
            old, new = SWAPS[type(op)]
            between = re.sub(rb"#.*", lambda m: b" " * len(m[0]), source[low:high])
            place = between.find(old.encode())
            yield mutant(low + place, low + place + len(old), rng.choice(new))

    tree = ast.parse(source)
    # NumPy takes any negative length for an unknown one.
    lengths = {
        id(length.operand)
        for call in ast.walk(tree)
        if isinstance(call, ast.Call) and getattr(call.func, "attr", "") == "reshape"
        for length in call.args
        if isinstance(length, ast.UnaryOp)
    }
    for node in _code(tree):
        if id(node) in lengths:
            continue
        match node:
            case (
                ast.BinOp(left=left, op=op, right=right)
                | ast.AugAssign(target=left, op=op, value=right)
            ):
                yield from swapped(op, end(left), begin(right))
            case ast.Compare(left=left, ops=ops, comparators=rights):
                for op, right in zip(ops, rights, strict=True):
                    yield from swapped(op, end(left), begin(right))
                    left = right
            case ast.BoolOp(op=op, values=values):
                yield from swapped(op, end(values[0]), begin(values[1]))
            case ast.UnaryOp(op=op, operand=operand):
                yield from swapped(op, begin(node), begin(operand))
            case ast.Constant(value=bool() as value):
                yield mutant(begin(node), end(node), str(not value))
            case ast.Constant(value=int() | float() as value):
                yield mutant(begin(node), end(node), repr(value + 1))


def _code(node: ast.AST) -> Iterator[ast.AST]:
    """Nodes that do something: no annotations, decorators, imports or error text."""
    if isinstance(node, ast.Raise | ast.Import | ast.ImportFrom | ast.JoinedStr):
        return
    if isinstance(node, ast.keyword) and node.arg in GUARDS:
        return
    yield node
    for name, value in ast.iter_fields(node):
        if name in ("annotation", "returns", "decorator_list"):
            continue
        for child in value if isinstance(value, list) else [value]:
            if isinstance(child, ast.AST):
                yield from _code(child)


def sample(seed: int, count: int) -> list[Mutant]:
    """Return the first `count` mutants of the core in the order of the seed."""
    files = [ROOT / PACKAGE / name for name in CORE]
    paths = [p for f in files for p in ([f] if f.suffix else sorted(f.rglob("*.py")))]
    paths = [path for path in paths if not path.stem.endswith("_plot")]
    found = [m for p in paths for m in mutants_of(p, random.Random(f"{seed} {p.name}"))]
    return sorted(found, key=lambda mutant: mutant.rank(seed))[:count]


def stages(folder: Path, mutant: Mutant) -> Iterator[list[str]]:
    """Yield tests of a mutant, first those that name what its module defines."""
    module = folder / PACKAGE / mutant.path
    rooms = TESTS[Path(mutant.path).parts[0]]
    tests = folder / "tests"
    files = [f for r in rooms for f in sorted((tests / r).rglob("test_*.py"))]
    names = {
        node.name
        for node in ast.parse(mutant.source).body
        if isinstance(node, ast.FunctionDef | ast.ClassDef)
    }
    near = [f for f in files if names & set(re.findall(r"\w+", f.read_text()))]
    yield [str(module), *map(str, near)]
    yield [str(f) for f in files if f not in near]
    every = sorted(tests.rglob("test_*.py"))
    yield [str(f) for f in every if f not in files]


def fate(folder: Path, mutant: Mutant, timeout: float) -> str:
    """``killed``, ``survived`` or ``timeout`` (which is killed too)."""
    target = folder / PACKAGE / mutant.path
    target.write_bytes(mutant.content)
    try:
        for tests in stages(folder, mutant):
            code = _ends_with(folder, tests, timeout) if tests else 0
            if code not in (0, 5):
                return "timeout" if code is None else "killed"
    finally:
        target.write_bytes(mutant.source)
    return "survived"


def _ends_with(folder: Path, tests: list[str], timeout: float) -> int | None:
    """Exit code of pytest in a forked process, None if the time is over."""
    process = FORK.Process(target=_run, args=(folder, tests))
    process.start()
    process.join(timeout)
    process.kill()
    return process.exitcode


def _run(folder: Path, tests: list[str]) -> None:
    import pytest

    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    os.dup2(nowhere, 2)
    os.chdir(folder)
    os.environ["PYTHONPATH"] = sys.path[0] = str(folder)
    sys.dont_write_bytecode = True
    os._exit(pytest.main(["-x", "-q", "-n0", "-p", "no:cacheprovider", *tests]))


def main() -> None:
    """Print the fate of each mutant, and the score."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--count", type=int, default=60)
    parser.add_argument("--timeout", type=float, default=600.0, help="[s] per mutant")
    parser.add_argument("--list", action="store_true", help="print mutants, run none")
    options = parser.parse_args()
    mutants, fates = sample(options.seed, options.count), []
    for library in LIBRARIES:
        importlib.import_module(library)
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place) / "repository"
        ignored = shutil.ignore_patterns(".*", "__pycache__", "results", "build")
        shutil.copytree(ROOT, folder, ignore=ignored)
        tests = [str(folder / "tests")]
        if not options.list and _ends_with(folder, tests, 10 * options.timeout):
            parser.exit(1, "the tests fail already without a mutant\n")
        for mutant in mutants:
            known = mutant.changed in EQUIVALENT
            if options.list or known:
                outcome = "equivalent" if known else "listed"
            else:
                outcome = fate(folder, mutant, options.timeout)
            fates.append(outcome)
            print(
                f"{outcome:10} {mutant.path}:{mutant.line}: {mutant.changed}",
                flush=True,
            )
    killed = sum(outcome in ("killed", "timeout") for outcome in fates)
    other = len(fates) - fates.count("equivalent")
    print(f"{killed} of {other} killed; {len(fates) - other} equivalent")


if __name__ == "__main__":
    main()

"""Damaged files of every format: none may crash, hang, or raise a foreign exception.

    python benchmarks/fuzz.py --files 10000 --seed 0 --keep build/fuzz

Each file is a valid one with a change or two: bits, bytes, parts that are missing,
doubled or exchanged, numbers replaced by extreme ones.  A process reads it within 2 GB
beyond what its libraries take, and within 10 s; what it raises must be an error of the
package.  Exit code 1 if a file did worse; `--keep` keeps these files.
"""

import argparse
import logging
import multiprocessing
import re
import resource
import sys
import tempfile
import time
import warnings
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np
from fuzz_samples import Sample, samples

from consistent_id import ConsistentIdError
from consistent_id._support.tables import Table

MEMORY = 2 * 2**30  # bytes beyond those of the libraries
SECONDS = 10.0
_GRACE = 3.0  # s; a machine that does other work is not our fault
_EXTREME = (
    *(b"0", b"-1", b"1e308", b"-1e308", b"1e-320", b"nan", b"inf", b"1e999", b""),
    *(b"99999999999999999999", b"0x10", b"[1]", b'"1"', b"true", b"<a>", b"\xff\xfe"),
)
_NUMBER = re.compile(rb"-?\d+(?:\.\d*)?(?:e-?\d+)?")


@dataclass(frozen=True)
class Outcome:
    """What became of one damaged file; `kind` is "read" or "refused" if all is well."""

    name: str
    kind: str
    detail: str
    content: bytes


def damaged(content: bytes, rng: np.random.Generator) -> bytes:
    """Return the content with a change or two, of numbers most often."""
    changes = (_bits, _bytes, _cut, _missing, _doubled, _exchanged, _word)
    changes += (_number, _number)
    for _ in range(rng.choice([1, 1, 2])):
        content = changes[rng.integers(len(changes))](content, rng)
    return content


def _place(content: bytes, rng: np.random.Generator) -> int:
    return int(rng.integers(max(1, len(content))))


def _part(content: bytes, rng: np.random.Generator) -> tuple[int, int]:
    start = _place(content, rng)
    return start, start + int(rng.integers(1, 64))


def _bits(content: bytes, rng: np.random.Generator) -> bytes:
    data = bytearray(content)
    for _ in range(rng.integers(1, 9) if data else 0):
        data[_place(content, rng)] ^= 1 << int(rng.integers(8))
    return bytes(data)


def _bytes(content: bytes, rng: np.random.Generator) -> bytes:
    start, _ = _part(content, rng)
    return content[:start] + rng.bytes(int(rng.integers(1, 9))) + content[start:]


def _cut(content: bytes, rng: np.random.Generator) -> bytes:
    return content[: _place(content, rng)]


def _missing(content: bytes, rng: np.random.Generator) -> bytes:
    start, stop = _part(content, rng)
    return content[:start] + content[stop:]


def _doubled(content: bytes, rng: np.random.Generator) -> bytes:
    start, stop = _part(content, rng)
    return (
        content[:start]
        + content[start:stop] * int(rng.integers(2, 200))
        + (content[stop:])
    )


def _exchanged(content: bytes, rng: np.random.Generator) -> bytes:
    (a, b), (c, d) = sorted((_part(content, rng), _part(content, rng)))
    c, d = max(b, c), max(b, d)
    return content[:a] + content[c:d] + content[b:c] + content[a:b] + content[d:]


def _word(content: bytes, rng: np.random.Generator) -> bytes:
    """Put an extreme integer where a size may stand."""
    start, width = _place(content, rng), int(rng.choice([2, 4, 8]))
    value = (b"\xff" * width, b"\0" * width, b"\xff" * (width - 1) + b"\x7f")
    return content[:start] + value[rng.integers(3)] + content[start + width :]


def _number(content: bytes, rng: np.random.Generator) -> bytes:
    """Replace a number of a text."""
    found = list(_NUMBER.finditer(content[:100_000]))
    if not found:
        return content
    one = found[rng.integers(len(found))]
    extreme = _EXTREME[rng.integers(len(_EXTREME))]
    return content[: one.start()] + extreme + content[one.end() :]


def outcomes(count: int, seed: int) -> Iterator[Outcome]:
    """Yield what became of so many damaged files, format by format in turn."""
    rng = np.random.default_rng(seed)
    with tempfile.TemporaryDirectory(prefix="fuzz-") as name:
        folder = Path(name)
        known = samples(folder)
        reader = Reader(known, folder)
        for number in range(count):
            sample = known[number % len(known)]
            content = damaged(sample.content, rng)
            (folder / sample.name).write_bytes(content)
            kind, detail = reader.read(number % len(known))
            yield Outcome(sample.name, kind, detail, content)
        reader.end()


class Reader:
    """A process that reads files, and another one when it ends."""

    def __init__(self, known: list[Sample], folder: Path) -> None:
        self._known, self._folder = known, folder
        self._start()

    def _start(self) -> None:
        context = multiprocessing.get_context("fork")
        self._here, there = context.Pipe()
        arguments = (there, self._known, self._folder)
        self._process = context.Process(target=_serve, args=arguments, daemon=True)
        with warnings.catch_warnings():  # threads, which hold nothing that is needed
            warnings.simplefilter("ignore", DeprecationWarning)
            self._process.start()
        there.close()

    def read(self, place: int) -> tuple[str, str]:
        """Read the file of a sample; return the kind of outcome, and a detail."""
        self._here.send(place)
        try:
            if self._here.poll(SECONDS + _GRACE):
                kind, detail, seconds = self._here.recv()
                return ("slow", detail) if seconds > SECONDS else (kind, detail)
            found = "hangs", f"more than {SECONDS:g} s"
        except (EOFError, ConnectionResetError):
            self._process.join()
            found = "crash", f"exit code {self._process.exitcode}"
        self.end()
        self._start()
        return found

    def end(self) -> None:
        """End the process."""
        self._process.kill()
        self._process.join()


def _serve(pipe: Connection, known: list[Sample], folder: Path) -> None:
    logging.disable(logging.WARNING)
    warnings.simplefilter("ignore")
    _warm_up(known, folder)
    held = int(Path("/proc/self/statm").read_text().split()[0]) * 4096
    resource.setrlimit(resource.RLIMIT_AS, (held + MEMORY,) * 2)
    while True:
        sample = known[pipe.recv()]
        began = time.process_time()
        try:
            sample.read(folder / sample.name)
            kind, detail = "read", ""
        except ConsistentIdError as error:
            kind, detail = "refused", str(error)
        except BaseException as error:
            kind, detail = "foreign", f"{type(error).__name__}: {error}"[:300]
        pipe.send((kind, detail, time.process_time() - began))


def _warm_up(known: list[Sample], folder: Path) -> None:
    """Let all libraries be loaded before memory is counted."""
    with tempfile.TemporaryDirectory(dir=folder) as name:
        for sample in known:
            (Path(name) / sample.name).write_bytes(sample.content)
            sample.read(Path(name) / sample.name)


def table(found: list[Outcome]) -> Table:
    """Return how many files of each format were read, refused, or did worse."""
    kinds = ("read", "refused", "foreign", "crash", "hangs", "slow")
    counts = Counter((outcome.name, outcome.kind) for outcome in found)
    return Table(
        f"{len(found)} damaged files",
        ("format", *kinds),
        tuple(
            (name, *(str(counts[name, kind]) for kind in kinds))
            for name in dict.fromkeys(outcome.name for outcome in found)
        ),
        (f"at most {MEMORY // 2**30} GB and {SECONDS:g} s of computing for each file",),
    )


def bad(outcome: Outcome) -> bool:
    """Return whether a file did what none may do."""
    return outcome.kind not in ("read", "refused")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--files", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--keep", type=Path)
    options = parser.parse_args()
    found = list(outcomes(options.files, options.seed))
    print(table(found).text())
    for number, outcome in enumerate(filter(bad, found)):
        print(f"{outcome.name}: {outcome.kind}: {outcome.detail}", file=sys.stderr)
        if options.keep is not None:
            options.keep.mkdir(parents=True, exist_ok=True)
            (options.keep / f"{number}-{outcome.name}").write_bytes(outcome.content)
    return int(any(map(bad, found)))


if __name__ == "__main__":
    sys.exit(main())

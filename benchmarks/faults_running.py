"""Faults while running: killed, terminated, no room, no leave, thousands of fits.

    python benchmarks/faults_running.py --kills 200 --fits 2000

Prints one table, which ``--write SECURITY.md`` puts between the page's marks; exit code
1 if a row is not "good".  Needs Linux, and half a minute of computing, most of it for
the fits.  Full and read-only disks are tried where file systems may be mounted, as root
or in a container; elsewhere their rows say that they were not.
"""

import argparse
import os
import resource
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

import consistent_id as ci
from consistent_id._support.files import together
from consistent_id._support.tables import Table

ROOT = Path(__file__).resolve().parent.parent
PROBLEM = "problems/rx60"
LEAK = 30 * 2**20  # bytes that a process may grow by after its first tenth of fits
_NOBODY = 65534
_DISK = 16 * 2**20  # bytes of a small disk
BEGIN, END = "<!-- faults: begin -->", "<!-- faults: end -->"
_UNTIL_ALL_END = 10.0  # s, for processes that notice by themselves


@dataclass(frozen=True)
class Row:
    """What was tried, how often, and what went wrong."""

    fault: str
    times: int
    faults: tuple[str, ...]
    note: str = ""


def writers() -> dict[str, Callable[[Path, int], object]]:
    """Return what writes files into a folder: one of two versions of each."""
    from consistent_id.problems.opening import Opened
    from consistent_id.report.page import write_report
    from consistent_id.report.results import PRINTED
    from consistent_id.report.results_writing import tables_of, write_results

    study = ci.run_study(ci.load_problem(ROOT / PROBLEM))
    versions = [e for e in study.estimates if e.certificate.verdict == "certified"]
    first, source = versions[0], Opened(study.problem)
    other = replace(source, notes=("stated: nothing",))
    tables = {name: tables_of(name, source, study) for name in PRINTED}

    def compare(folder: Path, version: int) -> None:
        with together():
            chosen = [source, other][version]
            write_results(chosen, study, folder, page="a page", tables=tables)

    return {
        "save": lambda folder, version: ci.Estimate.save(
            [first, study.constrained][version], folder / "estimate.json"
        ),
        "export": lambda folder, version: (ci.to_urdf if version else ci.to_mjcf)(
            study.constrained
        ).save(folder / "robot"),
        "report": lambda folder, version: write_report(
            study, folder / "report.html", command=str(version)
        ),
        "compare": compare,
    }


def contents(folder: Path) -> dict[str, bytes]:
    """Return the files of a folder; those in the making are none yet."""
    return {p.name: p.read_bytes() for p in folder.iterdir() if p.is_file()}


def killed(
    name: str, write: Callable[[Path, int], object], kills: int, folder: Path
) -> Row:
    """Kill a process again and again while it writes one version over the other."""
    whole = []
    for version in (0, 1):
        write(folder / f"whole{version}", version)
        whole.append(contents(folder / f"whole{version}"))
    began = time.monotonic()
    write(folder / "out", 0)
    usual = time.monotonic() - began
    rng, found, mixed = np.random.default_rng(0), [], 0
    for number in range(kills):
        process = os.fork()
        if process == 0:
            for version in range(10**9):
                write(folder / "out", version % 2)
        time.sleep(float(rng.uniform(0.0, 3.0 * usual)))
        os.kill(process, signal.SIGKILL)
        os.waitpid(process, 0)
        seen = contents(folder / "out")
        for file, content in seen.items():
            if content not in [known.get(file) for known in whole]:
                found.append(f"kill {number}: {file} is neither the old nor the new")
        if set(seen) != set(whole[0]):
            found.append(f"kill {number}: files are {sorted(seen)}")
        mixed += seen not in whole
    write(folder / "out", 0)
    strays = [p.name for p in (folder / "out").iterdir() if p.name not in whole[0]]
    found += [f"left behind: {name}" for name in strays]
    if mixed:
        found.append(f"{mixed} times files of both versions")
    return Row(f"kill -9 during {name}", kills, tuple(found))


def _in_child(work: Callable[[], object]) -> str:
    """Do work in a process of its own; return the error's text."""
    here, there = os.pipe()
    process = os.fork()
    if process == 0:
        text = "no error"
        try:
            work()
        except ci.ProblemError as error:
            text = str(error)
        except BaseException as error:
            text = f"foreign {type(error).__name__}: {error}"
        os.write(there, text.encode())
        os._exit(0)
    os.close(there)
    os.waitpid(process, 0)
    with os.fdopen(here) as answer:
        return answer.read()


def refused(
    fault: str,
    prepare: Callable[[Path], object],
    writers: dict,
    folder: Path,
    disk: bool = False,
) -> Row:
    """Write where nothing can be written: an own error, and the old files stay."""
    found = []
    for name, write in writers.items():
        place = folder / name
        with mounted(folder) if disk else nullcontext():
            write(place, 0)
            before = contents(place)
            os.chmod(place, 0o755)

            def work(write=write, place=place) -> None:
                prepare(folder)
                write(place, 1)

            answer = _in_child(work)
            if "cannot be written" not in answer:
                found.append(f"{name}: {answer}")
            if contents(place) != before or len(list(place.iterdir())) != len(before):
                found.append(f"{name}: files changed")
    return Row(fault, len(writers), tuple(found))


def _no_room(_: Path) -> None:
    """No file may grow beyond 1 kB, which fails in the middle as a full disk does."""
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))


def _nobody(_: Path) -> None:
    if os.geteuid() == 0:
        os.setuid(_NOBODY)


@contextmanager
def mounted(folder: Path) -> Iterator[None]:
    """Make a folder a small disk of its own, in memory."""
    folder.mkdir(parents=True, exist_ok=True)
    _mount("-t", "tmpfs", "-o", f"size={_DISK}", "none", str(folder))
    try:
        yield
    finally:
        subprocess.run(["umount", str(folder)], check=True)


def _mount(*arguments: str) -> None:
    subprocess.run(["mount", *arguments], check=True, capture_output=True)


def may_mount(folder: Path) -> bool:
    """Return whether this process may mount file systems."""
    try:
        with mounted(folder):
            return True
    except (OSError, subprocess.CalledProcessError):
        return False


def _full(disk: Path) -> None:
    """Fill a disk to its last byte."""
    with (disk / "filler").open("wb", buffering=0) as file, suppress(OSError):
        while file.write(bytes(2**20)):  # at the end, as much as there is room for
            pass


def _read_only(disk: Path) -> None:
    _mount("-o", "remount,ro", str(disk))


def no_room_or_leave(known: dict, folder: Path) -> list[Row]:
    """Write where there is no room, and where there is no leave to."""
    rows = [
        refused("files of at most 1 kB", _no_room, known, folder / "short"),
        refused("a folder of others", _nobody, known, folder / "only"),
    ]
    disks = (("a full disk", _full), ("a read-only disk", _read_only))
    if not may_mount(folder / "mount"):
        return rows + [Row(fault, 0, (), "not tried: no mounts") for fault, _ in disks]
    return rows + [
        refused(fault, prepare, known, folder / fault.split()[1], disk=True)
        for fault, prepare in disks
    ]


@contextmanager
def searching(folder: Path) -> Iterator[subprocess.Popen]:
    """Run a long search with two processes, and wait until both search."""
    command = ["excite", PROBLEM, "--time-limit", "600", "--starts", "5000"]
    command += ["--workers", "2", "--output", str(folder / "out")]
    process = subprocess.Popen(
        [sys.executable, "-m", "consistent_id", *command],
        cwd=ROOT,
        env=os.environ | {"TMPDIR": str(folder)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    try:
        while len(list(folder.glob("excitation-*/*.npz"))) < 2:
            if process.poll() is not None:
                raise RuntimeError(process.communicate()[1])
            time.sleep(0.05)
        yield process
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)


def descendants(process: int) -> list[int]:
    """Return the processes that a process has started, and those that these have."""
    found = []
    for entry in Path("/proc").glob("[0-9]*"):
        try:
            parent = int((entry / "stat").read_text().rpartition(")")[2].split()[1])
        except OSError:
            continue  # it has ended
        if parent == process:
            found += [int(entry.name), *descendants(int(entry.name))]
    return found


def _worker(process: int) -> int:
    """Return a process that searches for another one."""
    for one in descendants(process):
        if b"popen_loky_posix" in Path(f"/proc/{one}/cmdline").read_bytes():
            return one
    raise RuntimeError("no worker")


def ended(fault: str, end: Callable[[int], None], code: int, folder: Path) -> Row:
    """Disturb a search: it ends by its rule, with all that it has started."""
    folder.mkdir()
    found = []
    with searching(folder) as process:
        started = descendants(process.pid)
        end(process.pid)
        _, err = process.communicate(timeout=60)  # until all have closed their ends
        if process.returncode != code or "bug" in err or "Traceback" in err:
            found.append(f"exit code {process.returncode}, expected {code}: {err}")
    deadline = time.monotonic() + _UNTIL_ALL_END
    while any(map(_goes_on, started)) and time.monotonic() < deadline:
        time.sleep(0.1)
    found += [f"process {one} goes on" for one in started if _goes_on(one)]
    if code > 0:  # who is killed cannot tidy up
        found += [f"left behind: {p.name}" for p in folder.glob("excitation-*")]
    return Row(fault, 1, tuple(found), f"exit code {process.returncode}")


def _goes_on(process: int) -> bool:
    try:
        state = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return False
    return state not in "ZX"


def many_fits(count: int) -> Row:
    """Fit again and again in this process, and see what it holds in the end."""
    problem = ci.load_problem(ROOT / PROBLEM)
    study = ci.Study(problem)
    regression = ci.build_regression(problem.model, study.training)
    begun, found = (0, 0, 0), []
    for number in range(count):
        fit = ci.constrained_least_squares(problem.model, regression, base=study.base)
        if fit.certificate.verdict == "refused":
            found.append(f"fit {number}: {fit.certificate.reason}")
        if number == count // 10:
            begun = _held()
    held = _held()
    growth = held[0] - begun[0]
    if growth > LEAK:
        found.append(f"memory grew by {growth / 2**20:.0f} MiB")
    if held[1:] != begun[1:]:
        found.append(f"files and threads were {begun[1:]} and are {held[1:]}")
    return Row("fits in one process", count, tuple(found), f"{growth / 2**20:+.1f} MiB")


def _held() -> tuple[int, int, int]:
    """Return resident memory [bytes], open files and threads."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    files = len(os.listdir("/proc/self/fd"))
    return pages * resource.getpagesize(), files, len(os.listdir("/proc/self/task"))


def measure(kills: int, fits: int) -> list[Row]:
    """Try everything."""
    with tempfile.TemporaryDirectory(prefix="faults-") as name:
        folder = Path(name)
        os.chmod(folder, 0o755)
        known = writers()
        rows = [
            killed(name, write, kills // len(known), folder / f"kill-{name}")
            for name, write in known.items()
        ]
        rows += no_room_or_leave(known, folder)
        kill, term = signal.SIGKILL, signal.SIGTERM
        disturbances = (
            ("a worker killed", lambda main: os.kill(_worker(main), kill), 3),
            ("SIGTERM", lambda main: os.kill(main, term), 143),
            ("kill -9 during a search", lambda main: os.kill(main, kill), -kill),
        )
        for place, (fault, end, code) in enumerate(disturbances):
            rows.append(ended(fault, end, code, folder / f"search{place}"))
        rows.append(many_fits(fits))
    return rows


def result(row: Row) -> str:
    """Return what a table says of a row."""
    if row.faults:
        return row.faults[0]
    return "good" if row.times else "-"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--fits", type=int, default=2000)
    parser.add_argument("--write", type=Path, help="page to write the table into")
    options = parser.parse_args()
    rows = measure(options.kills, options.fits)
    table = Table(
        "Faults while running",
        ("fault", "times", "result", "note"),
        tuple((row.fault, str(row.times), result(row), row.note) for row in rows),
    )
    print(table.text())
    if options.write:
        text = options.write.read_text()
        head, _, rest = text.partition(BEGIN)
        _, _, tail = rest.partition(END)
        lines = ["| fault | times | result | note |", "|---|---:|---|---|"]
        lines += [f"| {' | '.join(row)} |" for row in table.rows]
        body = "\n".join(lines)
        options.write.write_text(f"{head}{BEGIN}\n\n{body}\n\n{END}{tail}")
    return int(any(row.faults for row in rows))


if __name__ == "__main__":
    sys.exit(main())

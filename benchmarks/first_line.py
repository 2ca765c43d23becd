"""How long a user of the shell waits for the first line, and for the whole.

``python benchmarks/first_line.py [PROBLEM ...] [--whole]``.  Output goes to a pipe.
Processor seconds of the command's own process until its first line, and what that is;
a command is ended then, unless the whole is asked for.
"""

import argparse
import os
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from time import sleep

COMMANDS = ("check", "identify", "compare", "report", "select", "excite")
_TICK = os.sysconf("SC_CLK_TCK")


def spent(process: int) -> float:
    """Return a process's processor seconds so far."""
    fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / _TICK


def measured(command: str, problem: Path, folder: Path, whole: bool) -> str:
    """Return a row of the table."""
    call = [sys.executable, "-m", "consistent_id", command, str(problem.resolve())]
    log = folder / "log.txt"
    with log.open("wb") as stream:
        own = os.environ | {"XDG_STATE_HOME": str(folder)}  # records nothing
        run = subprocess.Popen(call, cwd=folder, env=own, stdout=stream, stderr=stream)
        used = 0.0
        while not log.stat().st_size and run.poll() is None:
            used = spent(run.pid)
            sleep(0.005)
        if not whole:
            run.terminate()
        before = sum(os.times()[2:4])
        run.wait()
        total = f"{sum(os.times()[2:4]) - before:.1f}" if whole else ""
    lines = log.read_text(errors="replace").splitlines()
    first = lines[0].replace("|", "/")[:50] if lines else "nothing"
    return f"| {command} | {problem.name} | {used:.2f} | {total} | {first} |"


def main() -> None:
    """Print a table of commands and problems."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("problems", type=Path, nargs="*")
    parser.add_argument("--whole", action="store_true", help="wait for the end, too")
    options = parser.parse_args()
    of_this = Path(__file__).parents[1] / "problems"
    problems = options.problems or [of_this / "kuka_kr300", of_this / "ur10e"]
    print("| command | problem | first line, s | whole, s | first line |")
    print("|---|---|--:|--:|---|")
    for problem in problems:
        for command in COMMANDS:
            with TemporaryDirectory() as folder:
                row = measured(command, problem, Path(folder), options.whole)
            print(row, flush=True)


if __name__ == "__main__":
    main()

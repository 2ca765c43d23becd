"""The most memory that this process has had, as Linux counts it."""

from pathlib import Path


def peak() -> float:
    """Return the peak of resident memory in MB.

    Not ``ru_maxrss``: of a process that was started by another one that is at least the
    peak of the other one.
    """
    status = Path("/proc/self/status").read_text()
    (line,) = [row for row in status.splitlines() if row.startswith("VmHWM")]
    return int(line.split()[1]) / 1024

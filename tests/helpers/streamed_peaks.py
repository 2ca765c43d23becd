"""Peaks of memory while a log is streamed: ``python streamed_peaks.py SHORT LONG``.

The logs of the two problems have unlike lengths.  The peaks are printed as JSON, in MB:
after the short log was looked through, after the long one was, after a quarter of its
windows was compressed, and at the end.  Windows are short, and rows for noise few, so
that what is in use at once is small beside a log that is kept.
"""

import json
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))
from memory import peak

import consistent_id as ci
from consistent_id._support.executors import Executor
from consistent_id.fleet import stream, windows

_WINDOW, _SHOWN = 2**13, 2**8  # samples


def peaks(short: str, long: str) -> list[float]:
    """Look through a log, and stream another one."""
    windows.WINDOW, windows.SHOWN = _WINDOW, _SHOWN
    recordings, found, seen = windows.KeptWindows.recordings, [], 0

    def watched(task):
        nonlocal seen
        if not seen:
            found.append(peak())
        for part in recordings(task):
            yield part
            seen += 1
            if seen == len(task.rows.cuts) // 4:
                found.append(peak())

    with TemporaryDirectory() as folder:
        looked = stream._parts(
            ci.load_problem(short), "training", Executor.named("serial"), Path(folder)
        )
        assert list(looked)
    found.append(peak())
    windows.KeptWindows.recordings = watched
    stream.stream_regression(ci.load_problem(long))
    return [*found, peak()]


if __name__ == "__main__":
    print(json.dumps(peaks(*sys.argv[1:])))

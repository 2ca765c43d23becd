"""Acceleration at both ends of a filtered log, where a filter does not know the motion.

``python benchmarks/filter_ends.py [--write docs/differentiation.md] [--choose]``

Four tones of 0.1 to 1 Hz are read by encoders, or as a noisy velocity.  The error is
that of the first and the last 0.1 s, over the acceleration's standard deviation, with
ends that are continued oddly, with those of `low_passed`, and in the middle of the log.
``--choose`` prints what the window's length and the shrinking by noise do.
"""

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from pages import stamp

import consistent_id as ci
from consistent_id.recordings.signals import filters

RATE, SECONDS, LOGS, END = 100.0, 6.0, 12, 0.1
CUTOFFS = (3.0, 5.0, 10.0, 20.0)  # Hz
BITS = (19, 14, 12)  # of a turn
NOISES = (1e-4, 1e-2, 5e-2)  # of a velocity, over its standard deviation
BEGIN, STOP = "<!-- ends: begin -->", "<!-- ends: end -->"


@contextmanager
def setting(**values: object) -> Iterator[None]:
    """Give the filter's constants other values for a while."""
    before = {name: getattr(filters, name) for name in values}
    try:
        for name, value in values.items():
            setattr(filters, name, value)
        yield
    finally:
        for name, value in before.items():
            setattr(filters, name, value)


def errors(cutoff: float, *, bits: int = 0, noise: float = 0.0) -> tuple[float, float]:
    """Return the errors at both ends and in the middle."""
    ends, middle = [], []
    for seed in range(LOGS):
        rng = np.random.default_rng(seed)
        time = np.arange(round(RATE * SECONDS)) / RATE
        rates = 2.0 * np.pi * rng.uniform(0.1, 1.0, 4)
        sizes, phases = 0.3 * rng.normal(size=4), rng.uniform(0.0, 6.28, 4)
        angle = np.outer(time, rates) + phases
        q, dq = np.sin(angle) @ sizes, np.cos(angle) @ (sizes * rates)
        true = -np.sin(angle) @ (sizes * rates**2)
        seen = None
        if bits:
            q = np.round(q * 2**bits / (2.0 * np.pi)) * 2.0 * np.pi / 2**bits
        else:
            seen = (dq + noise * dq.std() * rng.normal(size=len(dq)))[:, None]
        log = ci.Recording(("elbow",), time, q[:, None], seen)
        ready = ci.differentiated(ci.low_passed(log, motion_cutoff=cutoff))
        error = (ready.acceleration[:, 0] - true) / true.std()
        few = round(END * RATE)
        ends += [error[:few], error[-few:]]
        middle.append(error[len(error) // 3 : 2 * len(error) // 3])
    return tuple(float(np.sqrt(np.mean(np.square(e)))) for e in (ends, middle))


def table() -> str:
    """Measure the table."""
    lines = [
        f"`python benchmarks/filter_ends.py`{stamp()}:",
        "",
        "| read | cut-off | continued oddly | `low_passed` | middle |",
        "|---|--:|--:|--:|--:|",
    ]
    reads = [(f"position, {b} bits", {"bits": b}) for b in BITS]
    reads += [(f"velocity, noise {n:g}", {"noise": n}) for n in NOISES]
    for name, read in reads:
        for cutoff in CUTOFFS:
            with setting(_bend=lambda end: np.zeros(end.shape[1])):
                odd, _ = errors(cutoff, **read)
            kept, middle = errors(cutoff, **read)
            cells = " | ".join(f"{100.0 * e:.3g}%" for e in (odd, kept, middle))
            lines.append(f"| {name} | {cutoff:g} Hz | {cells} |")
    return "\n".join(lines)


def section(lines: str) -> str:
    """Return a table between the marks at which it is replaced."""
    return f"{BEGIN}\n\n{lines}\n\n{STOP}"


def choices() -> None:
    """Print geometric means of the errors at both ends."""
    reads = [*({"bits": b} for b in BITS), *({"noise": n} for n in NOISES)]
    for periods in (0.75, 1.0, 1.5, 2.0):
        for sure in (0.0, 1.0, 3.0, 9.0):
            with setting(_ENDS=periods, _SURE=sure):
                all_ends = [errors(c, **r)[0] for r in reads for c in CUTOFFS]
            mean = np.exp(np.mean(np.log(all_ends)))
            print(f"{periods:g} periods, {sure:g} standard errors: {mean:.4f}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", type=Path)
    parser.add_argument("--choose", action="store_true")
    options = parser.parse_args()
    if options.choose:
        choices()
        return
    lines = table()
    print(lines)
    if options.write:
        before, _, rest = options.write.read_text().partition(BEGIN)
        _, _, after = rest.partition(STOP)
        options.write.write_text(f"{before}{section(lines)}{after}")


if __name__ == "__main__":
    main()

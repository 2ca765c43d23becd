"""How well velocity and acceleration are found from what an encoder read.

``python benchmarks/differentiation.py [--write docs/differentiation.md]`` takes some
minutes.  Motions are given by formulas, so their derivatives are known.
"""

import argparse
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import filter_ends
import numpy as np

import consistent_id as ci

DURATION, PERIOD, JOINTS = 30.0, 10.0, 3
SEEDS = range(3)
CUTOFFS = (1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0, 24.0, 32.0)  # [Hz]
WINDOWS = (0.04, 0.06, 0.09, 0.13, 0.2, 0.3, 0.45, 0.7, 1.0)  # [s]
ENDS = 0.02  # of the recording, left out at both ends
NAMES = ("j1", "j2", "j3")


@dataclass(frozen=True)
class Encoder:
    """Sampling rate [Hz], step [rad] and noise before rounding [rad]."""

    title: str
    rate: float
    step: float
    noise: float


ENCODERS = (
    Encoder("1 kHz, 17 bit", 1000.0, 2 * np.pi / 2**17, 0.0),
    Encoder("1 kHz, 12 bit", 1000.0, 2 * np.pi / 2**12, 0.0),
    Encoder("250 Hz, 17 bit, noise 2e-4", 250.0, 2 * np.pi / 2**17, 2e-4),
)


def periodic(time: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Five harmonics of 0.1 Hz: position, velocity, acceleration."""
    return _tones(time, np.arange(1, 6)[:, None] / PERIOD * np.ones(JOINTS), rng)


def tones(time: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Eight tones up to 2 Hz that do not repeat together."""
    return _tones(time, rng.uniform(0.05, 2.0, (8, JOINTS)), rng)


def moves(time: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return quintic moves of 1 s from rest to rest, with rests of 0.5 s between."""
    q = np.zeros((3, len(time), JOINTS))
    for j in range(JOINTS):
        for start in np.arange(0.3, DURATION, 1.5):
            u = np.clip(time - start, 0.0, 1.0)
            inside = (u > 0.0) & (u < 1.0)
            size = rng.uniform(-1.0, 1.0)
            q[0, :, j] += size * (10 * u**3 - 15 * u**4 + 6 * u**5)
            q[1, :, j] += size * (30 * u**2 - 60 * u**3 + 30 * u**4) * inside
            q[2, :, j] += size * (60 * u - 180 * u**2 + 120 * u**3) * inside
    return q


MOTIONS = {
    "periodic, 10 s, five harmonics": periodic,
    "eight tones up to 2 Hz": tones,
    "quintic moves with rests": moves,
}


def _tones(time: np.ndarray, f: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    size, phase = rng.uniform(0.1, 0.5, f.shape) / f / 4, rng.uniform(0, 6, f.shape)
    w = 2 * np.pi * f
    angle = w * time[:, None, None] + phase
    return np.array(
        [
            (size * np.sin(angle)).sum(axis=1),
            (size * w * np.cos(angle)).sum(axis=1),
            (-size * w**2 * np.sin(angle)).sum(axis=1),
        ]
    )


def read(q: np.ndarray, encoder: Encoder, rng: np.random.Generator) -> np.ndarray:
    """Return what the encoder makes of a position."""
    noisy = q + encoder.noise * rng.normal(size=q.shape)
    return np.round(noisy / encoder.step) * encoder.step


def smoother(log: ci.Recording, order: int | None) -> ci.Recording:
    return ci.signals.kalman_differentiated(
        log, ci.signals.motion_noise(log, order=order)
    )


def filtered(log: ci.Recording, cutoff: float) -> ci.Recording:
    return ci.differentiated(ci.low_passed(log, motion_cutoff=cutoff))


def fourier(log: ci.Recording, period: float | None) -> ci.Recording:
    return ci.signals.fourier_differentiated(
        log, ci.signals.estimated_period(log) if period is None else period
    )


# Of several ways the one with the least error of acceleration counts.
Way = Callable[[ci.Recording], ci.Recording]
METHODS: dict[str, list[Way]] = {
    "Butterworth, 10 Hz": [partial(filtered, cutoff=10.0)],
    "Butterworth, best of 11 cut-offs*": [
        partial(filtered, cutoff=cutoff) for cutoff in CUTOFFS
    ],
    "Savitzky-Golay, best of 9 windows*": [
        partial(ci.signals.savitzky_golay_differentiated, window=window)
        for window in WINDOWS
    ],
    "smoother, white jerk": [partial(smoother, order=3)],
    "smoother": [partial(smoother, order=None)],
    "Fourier, period known": [partial(fourier, period=PERIOD)],
    "Fourier, period estimated": [partial(fourier, period=None)],
}


def error(way: Way, log: ci.Recording, truth: np.ndarray) -> np.ndarray:
    """Return the relative errors of velocity and acceleration, of all joints."""
    found = way(log)
    cut = slice(round(ENDS * len(log)), -round(ENDS * len(log)))
    pairs = ((found.velocity, truth[1]), (found.acceleration, truth[2]))
    return np.array(
        [
            np.linalg.norm(ours[cut] - known[cut]) / np.linalg.norm(known[cut])
            for ours, known in pairs
        ]
    )


def cell(motion: str, method: str, encoder: Encoder) -> str:
    """Return the median errors over seeds."""
    errors = []
    for seed in SEEDS:
        rng = np.random.default_rng(seed)
        time = np.arange(round(DURATION * encoder.rate)) / encoder.rate
        truth = MOTIONS[motion](time, rng)
        log = ci.Recording(NAMES, time, read(truth[0], encoder, rng))
        tried = [error(way, log, truth) for way in METHODS[method]]
        errors.append(min(tried, key=lambda pair: pair[1]))
    velocity, acceleration = np.median(errors, axis=0)
    return f"{100 * velocity:.2g}% / {100 * acceleration:.2g}%"


def table(motions: tuple[str, ...] = tuple(MOTIONS)) -> str:
    rows = [
        "| motion | method | " + " | ".join(e.title for e in ENCODERS) + " |",
        "|---|---|" + "---:|" * len(ENCODERS),
    ]
    for motion in motions:
        for method in METHODS:
            if method.startswith("Fourier") and MOTIONS[motion] is not periodic:
                continue
            cells = [cell(motion, method, encoder) for encoder in ENCODERS]
            rows.append(f"| {motion} | {method} | " + " | ".join(cells) + " |")
    return "\n".join(rows)


TEXT = f"""# From position to velocity and acceleration

Measured by `python benchmarks/differentiation.py`: motions given by formulas,
{DURATION:g} s of {JOINTS} joints, measured by three encoders. Errors are
root-mean-square, velocity / acceleration, relative to the true ones; {ENDS:.0%} of
the samples at each end are left out. The table shows medians over {len(SEEDS)} seeds.

{{table}}

\\* The best cut-off and the best window are those with the least true error, which
cannot be known from a log; all other rows use the log alone.

- Periodic motion: use the Fourier series. It averages all periods, and its
  derivatives are exact.
- Otherwise use the smoother. It needs no setting, and is almost as accurate as the
  Butterworth filter with the best cut-off: equally accurate on moves, with at most a
  few times its error on tones. Maximum likelihood chooses its noise levels, which are
  at least the encoder's own step, and the derivative of the position that is modelled
  as white noise. If this is always the jerk (the common choice), accelerations are
  several times worse.
- If you want a filter, choose its cut-off by the torque that it predicts:
  `best_cutoff`.

## Ends of a log

A filter does not know how the motion goes on at the ends of a log. A continuation
that is odd about the last sample, as is usual, has no acceleration there.
`low_passed` keeps the bend of the motion: a cubic through one period of the cut-off
shows it, and the less it stands out of its own noise, the less of it is kept. The
table shows the error of the acceleration in the first and the last 0.1 s, over the
acceleration's standard deviation, for four tones up to 1 Hz at 100 Hz. Where a
velocity is measured, an odd continuation keeps its slope, so that less is gained
there, and with much noise a tenth is lost. `--choose` compares lengths of the window
and weights of its noise. Both values were chosen on this simulation: among them no
length is best at every cut-off, because long windows blur the bend and short ones
show noise.

{{ends}}
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--write", type=Path)
    arguments = parser.parse_args()
    text = TEXT.format(table=table(), ends=filter_ends.section(filter_ends.table()))
    if arguments.write:
        arguments.write.write_text(text)
    else:
        print(text)


if __name__ == "__main__":
    main()

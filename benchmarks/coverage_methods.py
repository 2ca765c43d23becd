"""How often ``+-`` of other estimates than least squares holds the truth.

``python benchmarks/coverage_methods.py [--replicates 200] [--write docs/coverage.md]``

A payload, drive gains, delays, instruments, Huber's loss on the three-jointed arm of
`coverage`, and what `coverage_drives` and `coverage_bodies` have, from raw logs (see
`coverage_raw`): each under four kinds of noise, predicted errors of designs under two,
whose correlation is stated.  Too wide intervals are wrong, too.
"""

import argparse
import re
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from scipy import signal, stats
from scipy.interpolate import make_interp_spline

sys.path.insert(0, str(Path(__file__).parent))
from coverage_arm import LEVEL, arm, motion
from coverage_bodies import (
    blocks,
    factors_of_all,
    fleets,
    radii,
    sensor_designs,
    single_gains,
    slopes,
    standing_designs,
    walks,
    zeros,
)
from coverage_drives import calibrations, command_delays, springs
from coverage_raw import STEP, Preparation, encoded
from pages import stamp

import consistent_id as ci
from consistent_id.estimation.loaded_robot import loaded_robot
from consistent_id.recordings.signals.tracks import Track, estimate_delay

KINDS = ("white", "AR(1) 0.9", "pink", "changing level")
COARSE = 2.0 * np.pi / 2**16  # rad, steps of encoders
COMMAND = "python benchmarks/coverage_methods.py --write docs/coverage.md"
BEGIN, END = "<!-- methods: begin -->", "<!-- methods: end -->"
LOAD = ci.InertialParameters.from_central(
    2.0, [0.05, -0.02, 0.08], np.diag([0.01, 0.015, 0.012])
)


def noise(kind: str, shape: tuple[int, int], rng: np.random.Generator) -> np.ndarray:
    """Return noise of unit variance, shape (samples, joints)."""
    white = rng.normal(size=(shape[0] + 400, shape[1]))
    if kind == "AR(1) 0.9":
        return signal.lfilter([np.sqrt(0.19)], [1.0, -0.9], white, axis=0)[400:]
    if kind == "pink":
        spectrum = np.fft.rfft(white, axis=0)
        spectrum /= np.sqrt(np.maximum(np.arange(len(spectrum)), 1.0))[:, None]
        slow = np.fft.irfft(spectrum, len(white), axis=0)[200:-200]
        return slow / slow.std()
    if kind == "changing level":  # between a half and twice the mean, along the log
        level = np.linspace(0.5, 2.0, shape[0])[:, None]
        return white[400:] * level / np.sqrt(np.mean(level**2))
    return white[400:]


def payloads(kind: str, replicates: int) -> Iterator[np.ndarray]:
    """Yield the errors of a load's parameters over their standard errors."""
    model, *runs = runs_with_load()
    for shaken in noisy(model, runs, kind, replicates, seed=2):
        found = ci.estimation.identify_payload(model, *shaken)
        known = np.isfinite(found.standard_errors)
        error = found.free.vector - LOAD.vector
        yield error[known] / found.standard_errors[known]


def drive_gains(kind: str, replicates: int) -> Iterator[np.ndarray]:
    """Yield the same of gains from torque to current, with the load's mass known."""
    model, *runs = runs_with_load()
    gains = np.array([9.0, 11.0, 7.0])
    currents = [replace(run, torque=run.torque / gains) for run in runs]
    for shaken in noisy(model, currents, kind, replicates, seed=5):
        known = {"load.m": LOAD.mass}
        found = ci.estimation.identify_gains(model, *shaken, known=known)
        yield (found.gains - gains) / found.standard_errors


def noisy(
    model: ci.TorqueModel,
    runs: Sequence[ci.Recording],
    kind: str,
    replicates: int,
    *,
    seed: int,
) -> Iterator[list[ci.Recording]]:
    """Yield prepared logs of runs, with noise of `LEVEL` on their torque."""
    rng, prepared = np.random.default_rng(seed), Preparation(model, runs[-1])
    for _ in range(replicates):
        yield [prepared(run, shake(kind, run, rng), rng) for run in runs]


def shake(kind: str, run: ci.Recording, rng: np.random.Generator) -> np.ndarray:
    """Return noise of `LEVEL` of a run's torques."""
    return LEVEL * run.torque.std(axis=0) * noise(kind, run.torque.shape, rng)


def runs_with_load() -> tuple[ci.TorqueModel, ci.Recording, ci.Recording]:
    """Return a model, and the same motion with the load and without."""
    model, truth = arm(3)
    robot = loaded_robot(model, ci.robot.Link("load"))
    both = np.zeros(len(robot.model.layout))
    bodies = len(truth) - 10 * len(model.robot)
    own = 10 * len(model.robot)
    both[:own], both[robot.load_slice] = truth[:own], LOAD.vector
    both[len(both) - bodies :] = truth[own:]
    states = motion(model)
    bare = ci.simulate_torque(model, truth, states)
    torque = robot.predict(both, states, loaded=True)
    return model, replace(bare, torque=torque), bare


def instruments(kind: str, replicates: int) -> Iterator[np.ndarray]:
    """Yield the same of instrumental variables.

    Encoders are coarse, so that the motion has noise as well; the instruments are the
    exact motion, prepared as the log is.
    """
    return of_base_parameters(
        kind, replicates, ci.estimation.instrumental_variables, step=COARSE
    )


def hubers(kind: str, replicates: int) -> Iterator[np.ndarray]:
    """Yield the same of Huber's loss."""
    return of_base_parameters(
        kind, replicates, lambda model, log, _: ci.huber(model, log)
    )


def of_base_parameters(
    kind: str,
    replicates: int,
    estimate: Callable[[ci.TorqueModel, ci.Recording, ci.Recording], ci.Estimate],
    *,
    step: float = STEP,
) -> Iterator[np.ndarray]:
    """Yield errors of base parameters, estimated from a log and the exact motion."""
    model, truth = arm(3)
    true = ci.regression.base_parameters(model).projection @ truth
    exact = ci.simulate_torque(model, truth, motion(model))
    rng, prepared = np.random.default_rng(4), Preparation(model, exact)
    for _ in range(replicates):
        log = prepared(exact, shake(kind, exact, rng), rng, step=step)
        found = estimate(model, log, prepared.alike(exact))
        yield (found.base_values - true) / found.standard_errors


def delays(kind: str, replicates: int) -> Iterator[np.ndarray]:
    """Yield the same of the delay of a velocity, and of a position, behind a position.

    Encoders are coarse; the late signals have the noise.
    """
    states, late = motion(arm(3)[0]), 0.0123
    spline = make_interp_spline(states.time, states.position, k=5)
    moved = (spline(states.time - late), spline.derivative()(states.time - late))
    rng = np.random.default_rng(6)
    for _ in range(replicates):
        seen = encoded(states.position, rng, step=COARSE)
        reference = Track("position", states.joints, states.time, seen)
        found = []
        for channel, exact in zip(("position", "velocity"), moved, strict=True):
            values = exact + LEVEL * exact.std(axis=0) * noise(kind, exact.shape, rng)
            track = Track(channel, states.joints, states.time, values)
            delay = estimate_delay(reference, track)
            found.append((delay.seconds - late) / delay.standard_error)
        yield np.array(found)


def of_drives(
    method: Callable[[Callable[..., np.ndarray], int], Iterator[np.ndarray]],
) -> Callable[[str, int], Iterator[np.ndarray]]:
    """Return a method of `coverage_drives` or `coverage_bodies` by kind of noise."""
    return lambda kind, replicates: method(partial(noise, kind), replicates)


def of_designs(
    method: Callable[..., Iterator[np.ndarray]],
) -> Callable[[str, int], Iterator[np.ndarray]]:
    """Return a method whose predictions are told the noise's correlation."""
    return lambda kind, replicates: method(
        partial(noise, kind), replicates, correlation=CORRELATIONS[kind]
    )


METHODS: dict[str, Callable[[str, int], Iterator[np.ndarray]]] = {
    "payload": payloads,
    "drive gains": drive_gains,
    "delay": delays,
    "delay of commands": of_drives(command_delays),
    "spring of a gear": of_drives(springs),
    "drive calibration": of_drives(calibrations),
    "instrumental variables": instruments,
    "Huber": hubers,
    "zero of a joint": of_drives(zeros),
    "gain of a joint": of_drives(single_gains),
    "clock, gain, lean": of_drives(factors_of_all),
    "slope on nominal torque": of_drives(slopes),
    "blocks of a motion": of_drives(blocks),
    "fleet": of_drives(fleets),
    "robot on its feet": of_drives(walks),
    "radius of feet": of_drives(radii),
    "design on feet": of_designs(standing_designs),
    "design on a wrist sensor": of_designs(sensor_designs),
}
CORRELATIONS = {"white": 1.0, "AR(1) 0.9": 19.0}  # samples, (1 + 0.9) / (1 - 0.9)
DESIGNS = ("design on feet", "design on a wrist sensor")


def share(z: np.ndarray) -> tuple[float, float]:
    """Return the share of errors inside 95 % intervals, and its standard error.

    Parameters
    ----------
    z : ndarray, shape (replicates, parameters)
    """
    inside = np.mean(abs(z) <= stats.norm.ppf(0.975), axis=1)
    return float(inside.mean()), float(inside.std(ddof=1) / np.sqrt(len(inside)))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--replicates", type=int, default=200)
    parser.add_argument("--methods", nargs="*", default=list(METHODS))
    parser.add_argument("--write", type=Path)
    options = parser.parse_args()
    lines = table(options.replicates, options.methods)
    if options.write:
        page = options.write.read_text()
        before, _, rest = page.partition(BEGIN)
        old, _, after = rest.partition(END)
        if options.methods == list(METHODS):
            part = section(lines)
        else:
            head, _, _ = old.strip().partition("\n\n")
            rows = f"Rows of {', '.join(options.methods)}{stamp()}."
            part = f"{BEGIN}\n\n{head}\n{rows}\n\n{with_others(lines, old)}\n\n{END}"
        options.write.write_text(f"{before}{part}{after}")


def section(lines: str) -> str:
    """Return a table with its stamp, between the marks at which it is replaced."""
    head = f"This table alone is measured by\n`{COMMAND}`{stamp()}."
    return f"{BEGIN}\n\n{head}\n\n{lines}\n\n{END}"


def missed(page: str) -> list[str]:
    """Return the rows of a table that are not within 93 to 97 %."""
    row = re.compile(r"\| ([^|]+) \| ([^|]+) \| \d+ \| ([\d.]+)% ± ([\d.]+)% \|")
    return [
        f"{name}, {kind}: {share} ± {error} %, target 93 to 97 %"
        for name, kind, share, error in row.findall(page)
        if not 93.0 <= float(share) <= 97.0
    ]


def with_others(lines: str, old: str) -> str:
    """Return a table with the rows of other methods that it had before."""
    rows: dict[str, list[str]] = {name: [] for name in METHODS}
    for row in (*old.splitlines(), *lines.splitlines()):
        name, _, _ = row.removeprefix("| ").partition(" | ")
        if name in rows:
            rows[name].append(row)
    fresh = set(lines.splitlines())
    kept = [[row for row in own if row in fresh] or own for own in rows.values()]
    head = lines.splitlines()[:2]
    return "\n".join([*head, *(row for own in kept for row in own)])


def table(replicates: int, methods: Sequence[str] = tuple(METHODS)) -> str:
    """Measure the table; its rows are printed as they are found."""
    lines = [
        "| estimate | noise | data sets | 95 % intervals hold | worst parameter |",
        "|---|---|--:|--:|--:|",
    ]
    for name in methods:
        for kind in CORRELATIONS if name in DESIGNS else KINDS:
            z = np.array(list(METHODS[name](kind, replicates)))
            held, error = share(z)
            each = np.mean(abs(z) <= stats.norm.ppf(0.975), axis=0)
            worst = each[np.argmax(abs(each - 0.95))]
            shares = f"{held:.1%} ± {error:.1%} | {worst:.1%}"
            lines.append(f"| {name} | {kind} | {len(z)} | {shares} |")
            print(lines[-1], flush=True)
    return "\n".join(lines)


if __name__ == "__main__":
    main()

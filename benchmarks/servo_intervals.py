"""The 95 % intervals of servos: true values in them, and differences between files.

    python benchmarks/servo_intervals.py [--servos 40] [--friction plain] [--splits 4]
        [--seed 0 ...] [--write PAGE]

Servos with random parameters lift the pendulum of `benchmarks/servos.py` and are
simulated by code that shares nothing with the package: steps of 0.1 ms, a firmware that
reads an encoder of 12 bits each millisecond, duties of 885 steps, 190 Hz with uneven
periods, three logs of 6 s at three gains.  Each servo is identified with its own form
of friction.  Printed is the share of intervals that contain the truth, of all
parameters and of the one with the fewest.  Of the real servo (CONSISTENT_ID_DATASETS),
fits to disjoint halves of the logs, each with the three gains, are compared: printed is
the share of differences within the intervals of both together.  Each parameter's share
goes to stderr.
"""

import argparse
import os
import sys
from collections.abc import Mapping, Sequence
from itertools import combinations, product
from pathlib import Path
from tempfile import TemporaryDirectory
from time import process_time

import numpy as np
from pages import add_write, shown_on
from servos import GAINS, PENDULUM

from consistent_id._support.arrays import Vector
from consistent_id.robot.loaders import load_robot
from consistent_id.robot.model import RobotModel
from consistent_id.rollout import ServoLog, identify_servos, read_servo_logs

FIRMWARE, STEP = 1e-3, 1e-4  # s
TICK = 2.0 * np.pi / 4096.0
SECONDS, RATE = 6.0, 190.0
WEIGHT, INERTIA = 0.49 * 9.81 * 0.1, 0.49 * 0.1**2 + 1e-5
SHARES = (0.5, 1.0, 2.5)  # gains of the three logs, of full duty over 1 rad
SIZES: Mapping[str, tuple[float, float]] = {
    "stall": (0.5, 1.2),
    "viscous": (0.005, 0.06),
    "armature": (0.0005, 0.005),
    "coulomb": (0.01, 0.08),
    "delay": (0.0, 0.02),
    "zero": (-0.05, 0.05),
}
LOADED: Mapping[str, tuple[float, float]] = {
    "coulomb": (0.005, 0.03),
    "stribeck": (0.0, 0.03),
    "stribeck_velocity": (0.1, 0.6),
    "motor_load": (0.05, 0.3),
    "outer_load": (0.05, 0.3),
    "motor_load_stribeck": (0.0, 0.2),
    "outer_load_stribeck": (0.0, 0.2),
}
SIMULATED = (
    "| {} servos each | true values in their 95 % intervals | fewest "
    "| median half width of `stall` | at a border, left out | CPU [s] each |\n"
    "|---|---:|---:|---:|---:|---:|"
)
HALVES = (
    "\n| {} splits of real logs each | differences within both intervals | fewest |\n"
    "|---|---:|---:|"
)
SCALES = ("viscous", "armature", "coulomb")  # drawn by their logarithms


def drawn(form: str, count: int, rng: np.random.Generator) -> dict[str, Vector]:
    """Return the parameters of random servos."""
    sizes = {**SIZES, **(LOADED if form == "load" else {})}
    return {
        name: np.exp(rng.uniform(*np.log([low, high]), count))
        if name in SCALES
        else rng.uniform(low, high, count)
        for name, (low, high) in sizes.items()
    }


def goal_of(time: Vector, rng: np.random.Generator) -> Vector:
    """Return the goals of one log [rad]: sinusoids, a sweep, or moves with rests."""
    kind, size = rng.integers(3), rng.uniform(0.7, 1.5)
    if kind == 0:
        fast, slow, phase = rng.uniform([0.3, 0.1, 0.0], [0.9, 0.4, 2.0 * np.pi])
        wave = np.sin(2.0 * np.pi * fast * time + phase)
        return np.asarray(size * wave * np.sin(2.0 * np.pi * slow * time))
    if kind == 1:
        return np.asarray(size * np.sin(2.0 * np.pi * (0.15 + 0.12 * time) * time))
    places = rng.uniform(-1.4, 1.4, 40)
    at = time / rng.uniform(0.5, 1.2)
    number = at.astype(int)
    share = np.clip(1.5 * (at - number), 0.0, 1.0)
    share = share**3 * (10.0 - 15.0 * share + 6.0 * share**2)
    moved = places[number] * (1.0 - share) + places[number + 1] * share
    return np.asarray(moved - places[0] * np.exp(-3.0 * time))


def friction(
    known: Mapping[str, Vector], motor: Vector, outer: Vector, speed: Vector
) -> Vector:
    """Return the most that friction can take [N m]."""
    most = known["coulomb"] + known["viscous"] * speed
    if "motor_load" in known:
        slow = known["stribeck"] + abs(
            known["motor_load_stribeck"] * motor - known["outer_load_stribeck"] * outer
        )
        most = most + abs(known["motor_load"] * motor - known["outer_load"] * outer)
        most = most + slow * np.exp(-speed / known["stribeck_velocity"])
    return most


def simulated_logs(
    servos: Mapping[str, Vector], rng: np.random.Generator
) -> list[list[ServoLog]]:
    """Return three logs of each servo."""
    count = len(servos["stall"])
    known = {name: np.repeat(value, 3) for name, value in servos.items()}
    gain = np.repeat(rng.uniform(0.8, 1.25, count), 3) * np.tile(SHARES, count)
    ticks = round(SECONDS / FIRMWARE)
    stamps, goals, seen = [], [], np.empty((ticks, len(gain)))
    for log, delay in enumerate(known["delay"]):
        periods = rng.uniform(0.75, 1.25, int(1.1 * SECONDS * RATE)) / RATE
        time = np.cumsum(periods) - periods[0]
        stamps.append(time[time < SECONDS - 0.01])
        goals.append(goal_of(stamps[-1], rng))
        late = FIRMWARE * np.arange(ticks) - delay
        row = np.searchsorted(stamps[-1], late, side="right") - 1
        seen[:, log] = goals[-1][np.maximum(row, 0)]
    q, dq, inertia = seen[0].copy(), np.zeros(len(gain)), INERTIA + known["armature"]
    readings, duties = np.empty((2, ticks, len(gain)))
    for tick in range(-1000, ticks):  # the servo comes to rest at the first goal
        reading = TICK * np.round((q - known["zero"]) / TICK)
        duty = np.round(885.0 * gain * (seen[max(tick, 0)] - reading)) / 885.0
        duty = np.clip(duty, -1.0, 1.0)
        if tick >= 0:
            readings[tick], duties[tick] = reading, duty
        motor = known["stall"] * duty
        for _ in range(round(FIRMWARE / STEP)):
            outer = -WEIGHT * np.sin(q)
            momentum = inertia * dq + STEP * (motor + outer)
            most = STEP * friction(known, motor, outer, abs(dq))
            dq = np.sign(momentum) * np.maximum(abs(momentum) - most, 0.0) / inertia
            q = q + STEP * dq
    found = []
    for log, (time, goal) in enumerate(zip(stamps, goals, strict=True)):
        row = (time / FIRMWARE).astype(int)
        columns = readings[row, log], goal, duties[row, log]
        position, command, duty = (column[:, None] for column in columns)
        name = f"log {log % 3}"
        found.append(ServoLog(name, ("servo",), time, position, command, duty))
    return [found[3 * servo : 3 * servo + 3] for servo in range(count)]


def shares(ratios: Mapping[str, Sequence[float]]) -> tuple[str, str]:
    """Return the share of all errors within their intervals, and the fewest.

    Each parameter's share goes to stderr.
    """
    within = {name: float(np.mean(np.array(v) <= 1.0)) for name, v in ratios.items()}
    for name, values in ratios.items():
        middle, largest = np.median(values), np.max(values)
        text = f"{name:24}{within[name]:8.1%} of {len(values):3}, error/half width"
        text += f" {middle:.2f} median, {largest:.2f} most"
        print(text, file=sys.stderr, flush=True)
    every = np.concatenate([np.array(values) for values in ratios.values()])
    fewest = min(within, key=within.__getitem__)
    return (
        f"{np.mean(every <= 1.0):.1%} of {len(every)}",
        f"`{fewest}` {within[fewest]:.1%}",
    )


def of_simulated(robot: RobotModel, form: str, count: int, seed: int) -> None:
    """Identify simulated servos, and compare them with the truth, in a row."""
    rng = np.random.default_rng(seed)
    servos = drawn(form, count, rng)
    ratios: dict[str, list[float]] = {name: [] for name in servos}
    sizes: dict[str, list[float]] = {name: [] for name in servos}
    begin, borders = process_time(), 0
    for place, logs in enumerate(simulated_logs(servos, rng)):
        found = identify_servos(robot, logs, forms=[form]).joints[0].chosen
        borders += bool(found.at_border)
        for name, truth in servos.items():
            half = found.half_intervals[name]
            if not found.at_border and np.isfinite(half):
                off = abs(found.values[name] - truth[place])
                ratios[name].append(float(off / half))
                sizes[name].append(float(half / max(abs(truth[place]), 1e-9)))
    seconds = (process_time() - begin) / count
    print(f"{form}, seed {seed}, half widths:", file=sys.stderr)
    for name, values in sizes.items():
        print(f"{name:24}{np.median(values):8.1%}", file=sys.stderr, flush=True)
    stall = f"{np.median(sizes['stall']):.1%}"
    cells = (f"`{form}`, seed {seed}", *shares(ratios), stall, str(borders))
    print(f"| {' | '.join(cells)} | {seconds:.1f} |", flush=True)


def of_halves(robot: RobotModel, forms: Sequence[str], splits: int, seed: int) -> None:
    """Compare fits to disjoint halves of the real logs, in rows."""
    folder = Path(os.environ["CONSISTENT_ID_DATASETS"], "servo_pendulum")
    logs = read_servo_logs(sorted(folder.glob("*.parquet")), robot.joint_names)
    by_gain = [[log for log in logs if log.name.startswith(f"{g}_")] for g in GAINS]
    halves = list(product(*(combinations(range(4), 2) for _ in GAINS)))
    rng = np.random.default_rng(seed)
    for form in forms:
        ratios: dict[str, list[float]] = {}
        for place in rng.choice(len(halves), splits, replace=False):
            fits = []
            for first in (True, False):
                used = [
                    log
                    for mine, kept in zip(by_gain, halves[place], strict=True)
                    for number, log in enumerate(mine)
                    if (number in kept) is first
                ]
                fits.append(identify_servos(robot, used, forms=[form]).joints[0].chosen)
            one, other = fits
            both = set(one.values) & set(other.values)
            if set(one.values) != set(other.values):
                both.discard("viscous")  # in one half, the back-EMF is part of it
            for name in both:
                half = np.hypot(one.half_intervals[name], other.half_intervals[name])
                if np.isfinite(half):
                    off = abs(one.values[name] - other.values[name])
                    ratios.setdefault(name, []).append(float(off / half))
        print(f"halves, {form}, seed {seed}:", file=sys.stderr)
        cells = (f"`{form}`, seed {seed}", *shares(dict(sorted(ratios.items()))))
        print(f"| {' | '.join(cells)} |", flush=True)


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--servos", type=int, default=40)
    parser.add_argument("--friction", nargs="*", default=["plain", "load"])
    parser.add_argument("--splits", type=int, default=4)
    parser.add_argument("--seed", type=int, nargs="+", default=[0])
    add_write(parser)
    options = parser.parse_args()
    with TemporaryDirectory() as made, shown_on(options.write):
        file = Path(made, "pendulum.urdf")
        file.write_text(PENDULUM)
        robot = load_robot(file)
        if options.servos:
            print(SIMULATED.format(options.servos))
        for seed, form in product(
            options.seed, options.friction if options.servos else ()
        ):
            of_simulated(robot, form, options.servos, seed)
        if options.splits:
            print(HALVES.format(options.splits))
            for seed in options.seed:
                of_halves(robot, ("plain", "load", "square"), options.splits, seed)


if __name__ == "__main__":
    main()

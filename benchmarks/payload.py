"""Loads that are known, weighed: errors, and how often 95 % intervals contain them.

``python benchmarks/payload.py [--only ur10e moving still] [--write docs/payload.md]``

``ur10e`` weighs the load of 2.805 kg in every window of ten seconds of both loaded logs
of the UR10e (needs the recordings).  The gains come from the other loaded log, whole or
from ten seconds of it, or are those of the authors.  ``moving`` and ``still`` weigh
random loads, ten and 26 on each of three simulated arms, in ten seconds of motion and
at rest in twelve poses, where dry friction holds.  Motions are random, or designed for
a load (``consistent-id excite --for payload --others known``).
"""

import argparse
import os
import tempfile
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache, partial
from itertools import pairwise
from pathlib import Path

import numpy as np
import pinocchio as pin
import pyarrow.parquet as pq
from faults_robots import Robot, arm, as_drawn, loaded, random_motion, robots, urdf
from pages import written_to
from threadpoolctl import threadpool_limits

import consistent_id as ci
from consistent_id.service import (
    GainCheck,
    LoadQuantities,
    WeighedLoad,
    check_gains,
    weigh_load,
)

PARTS = ("ur10e", "moving", "still")
SCALE = 2.805  # kg, of the UR10e's load, weighed
WINDOW, STEP = 10.0, 1.0  # s
FILES = {  # loaded log: its rows in motion, its broken rows
    "ur-20_02_19_14harm50secLoad.parquet": ((308, 5071), ()),
    "ur-20_02_19_15harm50secLoad.parquet": ((330, 5000), (1, 2)),
}
WRIST = [("z", 0.4, 20.0), ("y", 0.5, 15.0), ("y", 0.1, 8.0)]
WRIST += [("z", 0.45, 6.0), ("y", 0.08, 2.0), ("z", 0.05, 1.0)]
ARMS = {
    "spherical_wrist": arm("spherical_wrist", WRIST),
    **{name: robots()[name] for name in ("ur10_like", "seven_joints")},
}
LOADS = 10
RESTING = 26  # loads on an arm that rests: four errors of a load are alike
NOISES = (0.01, 0.03, 0.06)  # of each joint's torque without the load, in motion
COLOUR = 0.9  # correlation of neighbouring samples of the noise
RATE = 100.0  # Hz
ACCELERATION = 8.0  # rad/s^2, of designed motions
DESIGN = 5.0  # s, of the search
FRICTION = 0.03  # of the effort limits: dry friction
VISCOUS = 0.3  # of dry friction, for each rad/s
CUTOFF = 8.0  # Hz
POSES, MOVE = 12, 4.0  # s from one to the next


@dataclass(frozen=True)
class Weighing:
    """Errors of one weighing, each over its standard error too.

    Parameters
    ----------
    mass : float
        Relative error of the mass.
    centre : float, [m]
        Distance of the centres of mass; not a number where the truth is not known.
    z : ndarray
        Errors of the least-squares quantities, over their standard errors.
    inside : ndarray of bool
        Whether their 95 % intervals contain the truth.
    kinds : tuple of str
        Reasons of the verdict.
    """

    mass: float
    centre: float
    z: np.ndarray
    inside: np.ndarray
    kinds: tuple[str, ...]


def compared(
    found: WeighedLoad, truth: np.ndarray, kept: slice = slice(None)
) -> Weighing:
    """Compare a weighed load with the true quantities, of which some may be unknown."""
    quantities: LoadQuantities = found.in_flange
    low, high = quantities.low, quantities.high
    error = found.payload.quantile * ((low + high) / 2.0 - truth) / (high - low) * 2.0
    known = np.flatnonzero(np.isfinite(truth) & np.isfinite(high - low))
    known = known[np.isin(known, np.arange(10)[kept])]
    return Weighing(
        quantities.body.mass / truth[0] - 1.0,
        float(np.linalg.norm(quantities.body.com - truth[1:4])),
        error[known],
        ((low < truth) & (truth < high))[known],
        tuple(reason.kind for reason in found.verdict.reasons),
    )


def row(name: str, found: list[Weighing], *, centre: bool = False) -> str:
    """Return a row of a table."""
    mass = 100.0 * np.abs([one.mass for one in found])
    cells = [name, f"{len(found)}", f"{np.median(mass):.2f}", f"{mass.max():.2f}"]
    if centre:
        off = 1e3 * np.array([one.centre for one in found])
        cells += [f"{np.median(off):.2f}", f"{np.quantile(off, 0.95):.2f}"]
    z = np.concatenate([one.z for one in found])
    inside = np.concatenate([one.inside for one in found])
    cells += [f"{100.0 * inside.mean():.1f}", f"{np.sqrt(np.mean(z**2)):.2f}"]
    return "| " + " | ".join(cells) + " |"


def windows(file: Path, rows: tuple[int, int]) -> Iterator[tuple[int, int]]:
    """Return the first and the last row of every window in a part of a log."""
    stamps = pq.read_table(file, columns=["time"])["time"].to_numpy()
    time = stamps[rows[0] - 1 : rows[1]]
    for start in np.arange(time[0], time[-1] - WINDOW + 1e-6, STEP):
        first, last = np.searchsorted(time, [start, start + WINDOW])
        yield rows[0] + int(first), rows[0] + int(last) - 1


def weighed_ur10e() -> None:
    """Print the table of the UR10e's load."""
    folder = Path(os.environ["CONSISTENT_ID_DATASETS"], "ur10e", "payload")
    truth = np.full(10, np.nan)
    truth[0] = SCALE
    problem = ci.load_problem("problems/ur10e")
    parts = {name: list(windows(folder / name, FILES[name][0])) for name in FILES}
    apart = round(WINDOW / STEP)

    def gains_of(name: str, rows: tuple[int, int]) -> GainCheck:
        return check_gains(
            problem,
            folder / name,
            known_mass=SCALE,
            rows=rows,
            omit=FILES[name][1],
            link="tool0",
        )

    print(
        "| loaded log | gains | weighings | mass: median error, % | worst, % | "
        "inside 95 %, % | rms z | `gains are off`, % |\n"
        "|---|---|--:|--:|--:|--:|--:|--:|"
    )
    for name, other in (tuple(FILES), tuple(reversed(FILES))):
        whole = [gains_of(other, FILES[other][0])]
        short = [gains_of(other, rows) for rows in parts[other][::apart]]
        cases = {
            "of the other log": (whole, parts[name], parts[name][::apart]),
            "of ten seconds of it": (short, parts[name][::apart], ()),
            "of the authors": ([None], *(2 * [parts[name][::apart]])),
        }
        for kind, (gains, rows, tested) in cases.items():
            found, off = [], []
            for one in gains:
                robot, errors = problem, np.zeros(1)
                if one is not None:
                    stated = one.gains.tolist()
                    robot = ci.load_problem("problems/ur10e", torque_gain=stated)
                    errors = one.factors.relative_errors
                weigh = partial(
                    weigh_load, robot, folder / name, omit=FILES[name][1], link="tool0"
                )
                found += [
                    compared(weigh(rows=part, gain_errors=errors), truth)
                    for part in rows
                ]
                off += [
                    "gains are off"
                    in compared(weigh(rows=part, known_mass=SCALE), truth).kinds
                    for part in tested
                ]
            cells = row(f"{name.split('_')[3][:2]} harmonics | {kind}", found)
            share = f"{100.0 * np.mean(off):.0f}" if off else "-"
            print(f"{cells} {share} |", flush=True)


def random_load(rng: np.random.Generator, robot: Robot) -> ci.InertialParameters:
    """Return a box of a twentieth to a quarter of the arm's mass on its last link."""
    mass = sum(part.mass for part in robot.parts) * np.exp(
        rng.uniform(np.log(0.05), np.log(0.25))
    )
    x, y, z = (sides := rng.uniform(0.06, 0.25, 3)) ** 2
    turned = pin.exp3(rng.normal(size=3))
    inertia = mass / 12.0 * np.diag([y + z, x + z, x + y])
    com = [*rng.uniform(-0.04, 0.04, 2), 0.1 + sides[2] / 2.0]
    return ci.InertialParameters.from_central(mass, com, turned @ inertia @ turned.T)


@cache
def designed(name: str) -> ci.recordings.FourierTrajectory:
    """Return ten seconds of motion for a load on one of the arms."""
    drawn = as_drawn(ARMS[name], np.random.default_rng(0))
    model = loaded(urdf(drawn))
    limits = ci.motion_limits(model, acceleration=ACCELERATION)
    return ci.design_trajectory(
        model,
        ci.PathForm(10.0, 5),
        ci.Aim(interest=[model.link_names[-1]], others="known"),
        limits=limits,
        starts=1,
        workers=1,
        time_limit=DESIGN,
    ).trajectory


def states(
    robot: Robot, rng: np.random.Generator, seconds: float, kind: str
) -> tuple[np.ndarray, ...]:
    """Return stamps, positions, velocities and accelerations of a motion."""
    if kind == "designed" and seconds == WINDOW:
        log = designed(robot.name).recording(rate=RATE)
        return log.time, log.position, log.velocity, log.acceleration
    if kind != "at rest":
        time = np.arange(round(RATE * seconds)) / RATE
        return (time, *random_motion(robot, rng).states(time))
    reach = np.array([0.8 * part.reach for part in robot.parts])
    poses = rng.uniform(-reach, reach, (POSES, len(reach)))
    s = np.linspace(0.0, 1.0, round(MOVE * RATE))
    blend = np.array([10 * s**3 - 15 * s**4 + 6 * s**5])
    parts = [
        part
        for a, b in pairwise(poses)
        for part in (np.tile(a, (round(RATE), 1)), a + blend.T * (b - a))
    ]
    q = np.vstack(parts)
    dq = np.gradient(q, 1.0 / RATE, axis=0)
    time = np.arange(len(q)) / RATE
    return time, q, dq, np.gradient(dq, 1.0 / RATE, axis=0)


@dataclass(frozen=True)
class Run:
    """A run of a simulated arm, without noise; arrays of shape (samples, joints)."""

    time: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    torque: np.ndarray


def run_of(
    robot: Robot,
    load: ci.InertialParameters | None,
    moved: tuple[np.ndarray, ...],
    *,
    friction: float = FRICTION,
    offset: float = 0.1,
    rotor: float = 0.0,
) -> Run:
    """Return the torque of a motion, with a load on the last link or without it.

    Dry friction and rotor inertia are shares of the effort limits, offset of friction.
    """
    model = pin.buildModelFromXML(urdf(robot))
    if load is not None:
        body = pin.Inertia(load.mass, load.com, load.central_inertia)
        model.appendBodyToJoint(model.njoints - 1, body, pin.SE3.Identity())
    time, q, dq, ddq = moved
    data = model.createData()
    rows = zip(q, dq, ddq, strict=True)
    torque = np.array([pin.rnea(model, data, *state).copy() for state in rows])
    effort = np.array([part.effort for part in robot.parts])
    dry = np.tanh(dq / 0.02) + _held(dq)
    torque += friction * effort * (VISCOUS * dq + dry + offset)
    torque += rotor * effort * ddq
    return Run(time, q, dq, torque)


def _held(dq: np.ndarray) -> np.ndarray:
    """Return the share of dry friction that each joint has in each rest.

    Any share of either sign balances a joint; it stays until the joint moves.
    """
    rest = (dq == 0.0).all(axis=1)
    number = np.cumsum(np.diff(rest, prepend=False)) // 2
    rng = np.random.default_rng(zlib.crc32(dq.tobytes()))
    shares = rng.uniform(-1, 1, (number[-1] + 1, dq.shape[1]))
    return np.where(rest[:, None], shares[number], 0.0)


def write_log(
    file: Path, robot: Robot, run: Run, sigma: np.ndarray, rng: np.random.Generator
) -> Path:
    """Write a run as CSV, with correlated noise of these sizes, shape (joints,)."""
    noise = rng.normal(size=run.torque.shape)
    for before, one in pairwise(noise):
        one[:] = COLOUR * before + np.sqrt(1.0 - COLOUR**2) * one
    names = ["time", *(f"{x}_{j}" for x in ("q", "dq", "tau") for j in robot.joints)]
    table = [run.time, run.position, run.velocity, run.torque + sigma * noise]
    np.savetxt(
        file,
        np.column_stack(table),
        "%.9g",
        ",",
        header=",".join(names),
        comments="",
    )
    return file


def weighed_simulated(name: str, noise: float, kind: str) -> list[Weighing]:
    """Weigh random loads on one arm, of which those that controllers may get."""
    robot, found = ARMS[name], []
    still = kind == "at rest"
    for k in range(RESTING if still else LOADS):
        rng = np.random.default_rng([list(ARMS).index(name), round(1e3 * noise), k])
        load = random_load(rng, robot)
        central = load.central_inertia[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]]
        truth = np.concatenate([[load.mass], load.com, central])
        bare, carrying = (
            run_of(robot, body, states(robot, rng, seconds, kind))
            for body, seconds in ((None, 20.0), (load, WINDOW))
        )
        moving = (
            bare if not still else run_of(robot, None, states(robot, rng, 20.0, ""))
        )
        sigma = noise * np.sqrt(np.mean(moving.torque**2, axis=0))
        with tempfile.TemporaryDirectory() as folder:
            (file := Path(folder, "robot.urdf")).write_text(urdf(as_drawn(robot, rng)))
            logs = [
                write_log(Path(folder, f"{log}.csv"), robot, run, sigma, rng)
                for log, run in (("bare", bare), ("loaded", carrying))
            ]
            problem = ci.draft_problem(
                file, logs[0], select=False, cutoff=2.0 if still else CUTOFF
            ).problem()
            weighed = weigh_load(problem, logs[1])
        found.append(compared(weighed, truth, slice(4) if still else slice(None)))
    return found


def simulated(kinds: tuple[str, ...]) -> None:
    """Print the table of simulated arms."""
    print(
        "| loaded run | arm | noise, % | loads | mass: median error, % | worst, % | "
        "centre: median, mm | 95 % of loads, mm | inside 95 %, % | rms z |\n"
        "|---|---|--:|--:|--:|--:|--:|--:|--:|--:|"
    )
    for kind in kinds:
        every = []
        for name in ARMS:
            for noise in NOISES if kind == "random motion" else NOISES[1:2]:
                found = weighed_simulated(name, noise, kind)
                every += found
                line = f"{kind} | `{name}` | {100.0 * noise:g}"
                print(row(line, found, centre=True), flush=True)
        print(row(f"**{kind}** | all | ", every, centre=True))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", nargs="+", choices=PARTS, default=PARTS)
    parser.add_argument("--write", type=Path)
    options = parser.parse_args()
    with threadpool_limits(1):
        for part in options.only:
            used = ("ur10e",) if part == "ur10e" else ()
            with written_to(options.write, f"payload {part}", used):
                if part == "ur10e":
                    weighed_ur10e()
                else:
                    moving = ("random motion", "designed")
                    simulated(moving if part == "moving" else ("at rest",))


if __name__ == "__main__":
    main()

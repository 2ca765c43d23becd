"""A hobby servo, learnt at two gains of its firmware and simulated at a third.

    python benchmarks/servos.py [--held-out kp100 ...] [--seed 0 1 2] [--write PAGE]

The data set servo_pendulum (CONSISTENT_ID_DATASETS): one XL330 lifts 0.49 kg at 0.10 m.
Logs of two gains are learnt from, those of the third, 200 by default, are simulated
from their goals. Printed is the mean absolute error of position, in mrad, the mean over
seeds, of `identify_servos` and of the friction models M1 to M6 of [Duclusaud2024],
written here from the published formulas and fitted by their method: the evolution
strategy on whole logs, constant supply, delay and offset fitted, no temperature.  The
budget is `--trials` simulations for each.
"""

import argparse
import os
import sys
from collections.abc import Iterator, Mapping
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory
from time import process_time

import numpy as np
from pages import add_write, shown_on

from consistent_id._support.arrays import Array
from consistent_id.robot.loaders import load_robot
from consistent_id.rollout import identify_servos, read_servo_logs
from consistent_id.rollout.servo_bounds import duty_law
from consistent_id.rollout.servo_export import replayed_in_mujoco
from consistent_id.rollout.servo_log import ServoLog
from consistent_id.rollout.servo_motion import (
    Friction,
    LoggedDrive,
    cut_pieces,
    position_errors,
)
from consistent_id.rollout.servo_search import POPULATION, SearchDistribution, evolved

PENDULUM = """<robot name="pendulum"><link name="bench"/>
<link name="arm"><inertial><origin xyz="0.1 0 0"/><mass value="0.49"/>
<inertia ixx="1e-5" ixy="0" ixz="0" iyy="1e-5" iyz="0" izz="1e-5"/></inertial></link>
<joint name="servo" type="revolute"><origin rpy="0 1.5707963267948966 0"/>
<parent link="bench"/><child link="arm"/><axis xyz="0 1 0"/>
<limit lower="-3.2" upper="3.2" effort="1" velocity="20"/></joint></robot>"""
GAINS = ("kp100", "kp200", "kp800")
HELD_OUT = "kp200"

COMMON = {
    "stall": (0.2, 2.0),
    "back_emf": (0.0, 0.1),
    "viscous": (0.0, 0.1),
    "armature": (1e-4, 0.01),
    "coulomb": (0.0, 0.1),
    "delay": (0.0, 0.05),
    "zero": (-0.1, 0.1),
}
STRIBECK = {"s": (0.0, 0.1), "v": (0.05, 1.0), "power": (0.5, 3.0)}
LOAD = {"load": (0.0, 0.7)}
DIRECTED = {"load": (0.0, 0.7), "outer": (0.0, 0.7)}
MODELS: Mapping[str, Mapping[str, tuple[float, float]]] = {
    "M1": {},
    "M2": STRIBECK,
    "M3": LOAD,
    "M4": STRIBECK | LOAD | {"load_s": (0.0, 0.7)},
    "M5": STRIBECK | DIRECTED | {"load_s": (0.0, 0.7), "outer_s": (0.0, 0.7)},
    "M6": STRIBECK
    | DIRECTED
    | {"load_s": (0.0, 0.7), "outer_s": (0.0, 0.7)}
    | {"motor_q": (0.0, 1.0), "outer_q": (0.0, 1.0)},
}


def friction(p: Mapping[str, Array]) -> Friction | None:
    """Return a friction law of the family; None for M1."""
    if "load" not in p and "s" not in p:
        return None
    none = np.zeros_like(p["stall"])
    load = p.get("load", none)
    outer_load = p.get("outer", load)
    load_s = p.get("load_s", none)
    outer_s = p.get("outer_s", load_s)

    def law(motor: Array, outer: Array, speed: Array) -> Array:
        total = abs(load * motor - outer_load * outer)
        if "s" not in p:
            return np.asarray(total)
        slow = p["s"] + abs(load_s * motor - outer_s * outer)
        if "motor_q" in p:
            against = np.sign(motor) != np.sign(outer)
            drives = abs(motor) > abs(outer)
            square = np.where(drives, p["outer_q"] * outer**2, p["motor_q"] * motor**2)
            slow = slow + against * square
        return np.asarray(total + slow * np.exp(-((speed / p["v"]) ** p["power"])))

    return law


def rival(
    name: str, training: Array, judged: Array, generations: int, seed: int
) -> tuple[float, Array]:
    """Return a model's error in training, and on each judged log [rad]."""
    box = COMMON | MODELS[name]
    low, high = np.array(list(box.values())).T

    def errors(sets: Array, pieces: Array) -> Array:
        values = dict(zip(box, (low + sets * (high - low)).T, strict=True))
        return position_errors(values, pieces, friction)

    start = np.where(low < 0.0, 0.5, 0.25)
    best = evolved(
        lambda sets: errors(sets, training).mean(axis=1),
        SearchDistribution(start, 0.25),
        generations,
        np.random.default_rng(seed),
    ).best[None]
    return float(errors(best, training).mean()), errors(best, judged)[0]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--trials", type=int, default=2800)
    parser.add_argument("--models", nargs="*", default=list(MODELS))
    parser.add_argument("--held-out", nargs="+", choices=GAINS, default=[HELD_OUT])
    parser.add_argument("--seed", type=int, nargs="+", default=[0], help="of searches")
    add_write(parser)
    options = parser.parse_args()
    with shown_on(options.write):
        report(options)


def report(options: argparse.Namespace) -> None:
    """Print mean absolute errors, by the gain that was held out, over seeds."""
    errors: dict[str, dict[str, list[float]]] = {}
    seconds: dict[str, float] = {}
    for held_out, seed in product(options.held_out, options.seed):
        for name, training, each, spent in measured(held_out, seed, options):
            row(name, training, each, spent)
            own = errors.setdefault(name, {}).setdefault(held_out, [])
            own.append(float(1e3 * each.mean()))
            seconds[name] = seconds.get(name, 0.0) + spent
    gains = [held_out.removeprefix("kp") for held_out in options.held_out]
    print(f"| model | {' | '.join(gains)} | mean | seeds | CPU s |")
    print(f"|---|{'---:|' * (len(gains) + 3)}")
    for name, found in errors.items():
        means = " | ".join(f"{np.mean(some):.1f}" for some in found.values())
        by_seed = np.mean(list(found.values()), axis=0)
        spread = f"{by_seed.min():.1f} to {by_seed.max():.1f}"
        cells = f"{means} | {by_seed.mean():.1f} | {spread} | {seconds[name]:.0f}"
        print(f"| {name} | {cells} |", flush=True)


def measured(
    held_out: str, seed: int, options: argparse.Namespace
) -> Iterator[tuple[str, float, Array, float]]:
    """Yield each model, its error in training, on each judged log [rad], and CPU s."""
    folder = Path(os.environ["CONSISTENT_ID_DATASETS"], "servo_pendulum")
    with TemporaryDirectory() as made:
        file = Path(made, "pendulum.urdf")
        file.write_text(PENDULUM)
        robot = load_robot(file)
        logs = read_servo_logs(sorted(folder.glob("*.parquet")), robot.joint_names)
        training = [log for log in logs if f"{held_out}_" not in log.name]
        judged = [log for log in logs if f"{held_out}_" in log.name]
        begin = process_time()
        fit = identify_servos(robot, training, judged, seed=seed)
        seconds = process_time() - begin
        joint = fit.joints[0]
        for name, form in {
            "`servo`, the form chosen by left-out logs": joint.chosen,
            **{f"friction `{form.name}`": form for form in joint.forms},
        }.items():
            errors = np.array(list(joint.validation[form.name].values()))
            yield name, form.training, errors, seconds
        replays = [
            replayed_in_mujoco(file, fit, log, [joint.gains[log.name]])[0]
            for log in judged
        ]
        yield "`servo.xml` (`plain`) in MuJoCo", np.nan, np.array(replays), 0.0
        pieces = [_whole(robot, part) for part in (training, judged)]
    for name in options.models:
        begin = process_time()
        trained, errors = rival(name, *pieces, options.trials // POPULATION, seed)
        yield name, trained, errors, process_time() - begin


def _whole(robot: object, logs: list[ServoLog]) -> object:
    drives = [LoggedDrive(duty_law(log, 0).gain, 0.0) for log in logs]
    return cut_pieces(robot, logs, 0, drives)


def row(name: str, trained: float, errors: Array, seconds: float) -> None:
    """Say what a model reaches in one run [mrad]."""
    each = "  ".join(f"{1e3 * error:.1f}" for error in errors)
    text = f"{name:<42}{1e3 * trained:9.1f}{1e3 * errors.mean():8.1f}"
    print(f"{text}{seconds:7.0f}  {each}", file=sys.stderr, flush=True)


if __name__ == "__main__":
    main()

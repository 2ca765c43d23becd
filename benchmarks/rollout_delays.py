"""Whether true delays are inside the intervals of `rollout`, on simulated logs.

``python benchmarks/rollout_delays.py [--seeds A-B] [--bodies model|identified]
[--delays MS,MS...] [--write PAGE]``: a seed is a robot of example-robot-data under PD
drives, a kind of friction, a delay of commands, and a motion.  MuJoCo simulates it in
steps of 0.5 ms; friction is dry, and its level depends on speed (Stribeck) or on the
drive's torque (load) besides.  The log has the commands and the encoders' positions.  A
problem is drafted of it, and settings are chosen as `rollout` does without options.
``scatter`` is the 95 % interval by the scatter between blocks of the motion,
``interval`` is what `rollout` prints.  Where the delay is found to be 0, it is from 0
to the upper limit; true delays of 1 and 2 ms (``--delays 0,1,2``) show whether the
limit holds.  Seconds are those of the processor; lines of seeds go to stderr.
"""

import argparse
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from time import process_time
from typing import Any, NamedTuple

import mujoco
import numpy as np
import pandas as pd
from pages import add_write, shown_on
from repair import EXAMPLES

import consistent_id as ci
from consistent_id.recordings.signals import PDGains
from consistent_id.rollout.chosen_settings import chosen_settings
from consistent_id.rollout.commanded_motion import drive_commands
from consistent_id.rollout.replay_model import compiled_model, replay_spec

RATE, SECONDS, STEP = 200.0, 20.0, 5e-4  # Hz, s, s
COUNTS, NOISE = 2**14, 1e-4  # of encoders in a turn; rad
FRICTIONS = ("plain", "stribeck", "load")
DELAYS = (0.0, 0.003, 0.007, 0.012)  # s


class Robot(NamedTuple):
    """A robot and its drives; friction and rotors are drawn around these."""

    file: str
    base: str | None
    kp: float  # N m/rad
    kd: float  # N m s/rad
    coulomb: float  # N m
    rotor: float  # kg m^2
    effort: float = np.inf  # N m, of a drive


ROBOTS = {
    "a1": Robot("a1_description/urdf/a1.urdf", "trunk", 40.0, 1.2, 0.6, 0.012),
    "laikago": Robot(
        "laikago_description/urdf/laikago.urdf", "trunk", 70.0, 2.0, 1.0, 0.03
    ),
    "xarm7": Robot("xarm_description/urdf/xarm7.urdf", None, 250.0, 12.0, 1.2, 0.15),
    "go2": Robot("go2_description/urdf/go2.urdf", "base", 35.0, 1.0, 0.5, 0.012),
    "z1": Robot("z1_description/urdf/z1.urdf", None, 120.0, 5.0, 0.8, 0.06),
}


class Case(NamedTuple):
    """A seed's robot, friction, delay and random numbers."""

    robot: str
    friction: str
    delay: float
    rng: np.random.Generator


def case_of(seed: int, delays: Sequence[float]) -> Case:
    """Return a seed's case; those of consecutive seeds differ."""
    names = list(ROBOTS)
    return Case(
        names[seed % len(names)],
        FRICTIONS[seed // 2 % len(FRICTIONS)],
        delays[seed % len(delays)],
        np.random.default_rng(seed),
    )


def model_of(robot: Robot) -> ci.RobotModel:
    """Return a robot's model of its file."""
    file = EXAMPLES / robot.file
    return ci.load_robot(file, **({} if robot.base is None else {"base": robot.base}))


def commands(model: ci.RobotModel, rng: np.random.Generator) -> np.ndarray:
    """Return chirps of all joints, shape (samples, joints), [rad]."""
    time = np.arange(round(SECONDS * RATE)) / RATE
    told = []
    for joint in model.driven:
        low, high = np.clip([joint.limits.lower, joint.limits.upper], -1.5, 1.5)
        middle, reach = 0.5 * (low + high), min(0.5 * (high - low), 0.5)
        first, last = rng.uniform(0.1, 0.3), rng.uniform(1.5, 3.0)
        phase = first * time + 0.5 * (last - first) * time**2 / SECONDS
        size = reach * rng.uniform(0.5, 0.9) / np.sqrt(1.0 + (time / SECONDS) * 4.0)
        wave = np.sin(2.0 * np.pi * (phase + rng.uniform()))
        told.append(middle + size * wave * np.minimum(time, 1.0))
    return np.column_stack(told)


class Simulated(NamedTuple):
    """A log, and the drives behind it.

    Parameters
    ----------
    drives : dict of str to float
        Viscous and Coulomb friction and rotor inertia, by the names of an estimate.
    """

    log: ci.Recording
    drives: dict[str, float]


def simulated(case: Case, robot: Robot | None = None) -> Simulated:
    """Return the log of a case, by default of one of `ROBOTS`."""
    robot, rng = robot or ROBOTS[case.robot], case.rng
    model = model_of(robot)
    names, count = model.joint_names, len(model.joint_names)
    told = commands(model, rng)
    time = np.arange(len(told)) / RATE
    start = np.tile(told[0], (len(told), 1))
    log = ci.Recording(names, time, start, 0.0 * start, position_command=told)
    gains = PDGains(robot.kp, robot.kd).of(count)
    level = robot.coulomb * rng.uniform(0.6, 1.5, count)
    spec = replay_spec(EXAMPLES / robot.file, names, gains, step=STEP)
    for joint in spec.joints:
        joint.damping[0] = robot.coulomb * rng.uniform(0.1, 0.4)
        joint.armature = robot.rotor * rng.uniform(0.7, 1.4)
    made = compiled_model(spec, case.robot, names, gains)
    more = level * rng.uniform(0.4, 0.9, count)
    fades = rng.uniform(0.1, 0.4, count)  # rad/s
    share = rng.uniform(0.08, 0.2, count)
    compiled, data = made.compiled, mujoco.MjData(made.compiled)
    per = round(1.0 / RATE / compiled.opt.timestep)
    step = 1.0 / RATE / per
    # A time step of MuJoCo is about its start, as `replay` knows.
    late = case.delay + 0.5 * step
    control = drive_commands(log, gains, step, per * len(told), delay=late)
    data.qpos[made.positions] = told[0]
    driven = [compiled.actuator(f"drive of {name}").id for name in names]
    found = np.zeros_like(told)
    for k, torque in enumerate(control):
        if k % per == 0:
            found[k // per] = data.qpos[made.positions]
        friction = level.copy()
        if case.friction == "stribeck":
            friction += more * np.exp(-((data.qvel[made.velocities] / fades) ** 2))
        elif case.friction == "load":
            friction += share * abs(data.actuator_force[driven])
        compiled.dof_frictionloss[made.velocities] = friction
        data.ctrl[driven] = torque
        mujoco.mj_step(compiled, data)
    found += NOISE * rng.standard_normal(found.shape)
    quantum = 2.0 * np.pi / COUNTS
    read = quantum * np.round(found / quantum)
    log = ci.Recording(names, time, read, position_command=told)
    return Simulated(log, drives_of(spec, names, level))


def drives_of(spec: Any, names: Sequence[str], level: np.ndarray) -> dict[str, float]:
    """Return each joint's viscous and Coulomb friction and its rotor inertia."""
    found = {}
    for name, coulomb in zip(names, level, strict=True):
        joint = spec.joint(name)
        found[f"{name}.viscous"] = float(joint.damping[0])
        found[f"{name}.coulomb"] = float(coulomb)
        found[f"{name}.rotor_inertia"] = float(joint.armature)
    return found


def problem_of_log(case: Case, folder: Path, bodies: str) -> ci.Problem:
    """Return the problem that is drafted of a case's log."""
    log = simulated(case).log
    table = {"time": log.time}
    for j, name in enumerate(log.joints):
        table[f"q_{name}"] = log.position[:, j]
        table[f"qdes_{name}"] = log.position_command[:, j]
    pd.DataFrame(table).to_parquet(folder / "log.parquet")
    robot = ROBOTS[case.robot]
    stated = {} if robot.base is None else {"base": robot.base}
    draft = ci.draft_problem(
        EXAMPLES / robot.file,
        folder / "log.parquet",
        gains=PDGains(robot.kp, robot.kd),
        bodies=bodies,
        **stated,
    )
    return draft.problem(folder)


class Judged(NamedTuple):
    """An interval of a case.

    Parameters
    ----------
    interval : tuple of float, or None, [s]
        None where it is not known.
    """

    name: str
    true: float  # s
    found: float  # s
    interval: tuple[float, float] | None

    @property
    def holds(self) -> bool:
        """Whether the true delay is inside."""
        return self.interval is not None and (
            self.interval[0] <= self.true <= self.interval[1]
        )

    def __str__(self) -> str:
        if self.interval is None:
            return f"{self.name} not known"
        low, high = self.interval
        missed = "" if self.holds else " missed"
        return f"{self.name} {1e3 * low:.2f} to {1e3 * high:.2f}{missed}"


def summary(what: str, judged: Sequence[Judged]) -> str:
    """Return how many of some intervals contain the true delay, and their width."""
    known = [one for one in judged if one.interval is not None]
    if not known:
        return f"{what}: none of {len(judged)} is known"
    width = np.median([high - low for low, high in (one.interval for one in known)])
    return (
        f"{what}: {sum(one.holds for one in known)} of {len(known)} true delays are "
        f"inside, median width {1e3 * width:.2f} ms, unknown in "
        f"{len(judged) - len(known)} cases"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", default="0-11")
    parser.add_argument("--bodies", default="model", choices=["model", "identified"])
    parser.add_argument("--delays", default=",".join(f"{1e3 * d:g}" for d in DELAYS))
    add_write(parser)
    options = parser.parse_args()
    with shown_on(options.write):
        report(options)


def report(options: argparse.Namespace) -> None:
    """Print how many intervals contain the true delay."""
    first, last = (int(seed) for seed in options.seeds.split("-"))
    delays = [1e-3 * float(delay) for delay in options.delays.split(",")]
    judged: list[Judged] = []
    for seed in range(first, last + 1):
        case = case_of(seed, delays)
        with tempfile.TemporaryDirectory() as folder:
            problem = problem_of_log(case, Path(folder), options.bodies)
            started = process_time()
            choice = chosen_settings(problem)
        found = choice.delay
        ends = {"interval": choice.delay_interval, "scatter": found.interval}
        shown = [Judged(n, case.delay, found.delay, e) for n, e in ends.items()]
        judged += shown
        print(
            f"{seed:4} {case.robot:8} {case.friction:9} {1e3 * case.delay:4.1f} ms: "
            f"{1e3 * found.delay:5.2f}; {'; '.join(map(str, shown))}; "
            f"{process_time() - started:.1f} s",
            file=sys.stderr,
            flush=True,
        )
    for name in ("scatter", "interval"):
        own = [one for one in judged if one.name == name]
        print(summary(name, own))
        print(summary(f"{name}, true delay 0", [j for j in own if j.true == 0.0]))
        print(summary(f"{name}, delay found 0", [j for j in own if j.found == 0.0]))


if __name__ == "__main__":
    main()

"""Verdicts on clean simulated logs of published arms: none is faulty.

``python benchmarks/clean_simulations.py --seeds 0-29 [--folder FOLDER] [--write
PAGE]``: a seed is an arm, its friction, rotors and noise, and a motion, all drawn at
random; of nine arms, or of twenty from seed 10000 on; from 20000 on the arms move from
pose to pose and stop there, before that along Fourier series.  A problem is drafted of
its log, and looked through as ``consistent-id check`` does; of an accused log the
verdict is shown as well.  In `--folder` logs and problems are kept for the next run.
"""

import argparse
import os
import sys
import tempfile
from collections.abc import Iterable
from pathlib import Path
from time import process_time

import numpy as np
from faults_robots import Motion
from pages import add_write, shown_on
from point_to_point import PointToPoint, drawn_moves
from repair import EXAMPLES
from threadpoolctl import threadpool_limits

import consistent_id as ci
from consistent_id.diagnosis import LogFinding
from consistent_id.problems.log_check import check_problem
from consistent_id.robot.scaling import reference_bodies

_UR = "ur_description/urdf"
ARMS: dict[str, tuple[str, str | None]] = {
    "ur3": (f"{_UR}/ur3_robot.urdf", None),
    "ur5": (f"{_UR}/ur5_robot.urdf", None),
    "ur10": (f"{_UR}/ur10_robot.urdf", None),
    "panda": ("panda_description/urdf/panda.urdf", "panda_link7"),
    "kinova": ("kinova_description/robots/kinova.urdf", "j2s6s200_link_6"),
    "xarm7": ("xarm_description/urdf/xarm7.urdf", "link7"),
    "kuka": ("kuka_kr300/kr300.urdf", None),
    "tx40": ("staubli_tx40/tx40.urdf", None),
    "z1": ("unitree_z1/z1.xml", None),
}
"""Files of example-robot-data or of the data sets, and the arms' tips."""

MORE: dict[str, tuple[str, str, str]] = {
    "baxter": (
        "baxter_description/urdf/baxter.urdf",
        "torso",
        "left_gripper_base_link",
    ),
    "pr2": ("pr2_description/urdf/pr2.urdf", "torso_lift_link", "r_gripper_palm_link"),
    "tiago": (
        "tiago_description/robots/tiago_no_hand.urdf",
        "torso_lift_link",
        "arm_7_link",
    ),
    "tiago_dual": (
        "tiago_description/robots/tiago_dual.urdf",
        "torso_lift_link",
        "arm_left_7_link",
    ),
    "talos": (
        "talos_data/robots/talos_reduced.urdf",
        "torso_2_link",
        "arm_left_7_link",
    ),
    "so100": ("so_arm_description/urdf/so100.urdf", "", ""),
    "so101": ("so_arm_description/urdf/so101.urdf", "", ""),
    "b1_z1": ("b1_description/urdf/b1-z1.urdf", "trunk", "link06"),
    "romeo": ("romeo_description/urdf/romeo.urdf", "torso", "l_wrist"),
    "icub": ("icub_description/robots/icub.urdf", "chest", "l_hand"),
    "g1": (
        "g1_description/urdf/g1_29dof_rev_1_0.urdf",
        "torso_link",
        "left_wrist_yaw_link",
    ),
}
"""Files of further arms, of the links that carry them, and of their tips.

Seeds from `FIRST_OF_ALL` on are of all arms, those before of `ARMS`.
"""

FIRST_OF_ALL, FIRST_OF_MOVES = 10_000, 20_000

RATES = (100.0, 125.0, 200.0, 250.0, 500.0, 1000.0)  # Hz
_WIDEST, _FASTEST = 1.6, 4.0  # rad, rad/s, where an arm's own limits are wider


def arm_file(arm: str) -> Path:
    """Return an arm's URDF or MJCF."""
    relative = {**ARMS, **MORE}[arm][0]
    datasets = Path(os.environ.get("CONSISTENT_ID_DATASETS", ""))
    return next(f / relative for f in (EXAMPLES, datasets) if (f / relative).exists())


def arm_of(seed: int) -> str:
    """Return the arm of a seed."""
    arms = list(ARMS) if seed < FIRST_OF_ALL else [*ARMS, *MORE]
    return arms[seed % len(arms)]


def part_of(arm: str) -> dict[str, str]:
    """Return the base and the tip by which an arm is cut out of its robot."""
    if arm in ARMS:
        tip = ARMS[arm][1]
        return {} if tip is None else {"tip": tip}
    _, base, tip = MORE[arm]
    return {"base": base, "tip": tip} if tip else {}


def clean_log(seed: int, robot: ci.RobotModel | None = None) -> ci.Recording:
    """Return a seed's log, by default of the seed's arm."""
    rng = np.random.default_rng([seed, 27])
    if robot is None:
        robot = ci.load_robot(arm_file(arm_of(seed)), **part_of(arm_of(seed)))
    rate = float(rng.choice(RATES))
    time = np.arange(round(rate * rng.uniform(10.0, 25.0))) / rate
    motion: Motion | PointToPoint
    if seed >= FIRST_OF_MOVES:
        motion = drawn_moves(robot, rng, time[-1], _FASTEST)
    else:
        motion = drawn_motion(robot, rng, time[-1])
    states = motion.at(robot.joint_names, time)
    bodies = drawn_bodies(robot, rng, exact=bool(rng.integers(2)))
    rigid = ci.TorqueModel(robot)
    size = np.std(ci.simulate_torque(rigid, bodies, states).torque, axis=0)
    size = np.maximum(size, 0.02 * size.max())
    shape = {"coulomb": "sign"}
    if rng.integers(2):
        shape = {"coulomb": "tanh", "velocity_scale": rng.uniform(0.005, 0.05)}
    drive = ci.DriveTerms(viscous=True, **shape, offset=True, rotor_inertia=True)
    model = ci.TorqueModel(robot, drive)
    rotors = rng.uniform(0.0, 0.5, len(size))
    speed = np.std(states.velocity, axis=0)
    speed = np.where(speed > 0.0, speed, speed.max())  # of joints that never move
    values = np.column_stack(
        [
            rng.uniform(0.05, 0.25, len(size)) * size / speed,
            rng.uniform(0.05, 0.25, len(size)) * size,
            0.03 * size * rng.normal(size=len(size)),
            rotors * reflected(rigid, bodies, states),
        ]
    )
    noise = rng.uniform(0.005, 0.02) * size
    truth = np.append(bodies, values.ravel())
    log = ci.simulate_torque(model, truth, states, noise=noise, rng=rng)
    step = 2 * np.pi / 2.0 ** rng.integers(14, 21)
    position = np.round(log.position / step) * step
    velocity = log.velocity * (1.0 + 0.003 * rng.normal(size=log.velocity.shape))
    kept = {"velocity": velocity} if rng.integers(2) else {}
    return ci.Recording(log.joints, time, position, torque=log.torque, **kept)


def drawn_motion(
    robot: ci.RobotModel, rng: np.random.Generator, duration: float
) -> Motion:
    """Return Fourier series of five harmonics within limits of travel and speed."""
    count, tempo = len(robot), rng.uniform(0.4, 1.0)
    # Every other motion repeats itself, and the log ends anywhere.
    period = rng.uniform(4.0, 10.0) if rng.integers(2) else duration
    frequency = np.tile(np.arange(1, 6) / period, (count, 1))
    amplitude = rng.normal(size=(count, 5)) / np.arange(1, 6) ** rng.uniform(0.0, 1.0)
    middle = np.zeros(count)
    for j, joint in enumerate(robot.driven):
        low = max(joint.limits.lower, -np.pi)
        high = max(min(joint.limits.upper, np.pi), low + 0.5)
        middle[j] = (low + high) / 2
        reach = min((high - low) / 2, _WIDEST) / abs(amplitude[j]).sum()
        speed = 2 * np.pi * frequency[j] @ abs(amplitude[j])
        most = tempo * min(joint.limits.velocity, _FASTEST)
        amplitude[j] *= min(0.9 * reach, most / speed)
    return Motion(frequency, amplitude, rng.uniform(0, 2 * np.pi, (count, 5)), middle)


def drawn_bodies(
    robot: ci.RobotModel, rng: np.random.Generator, *, exact: bool
) -> np.ndarray:
    """Return bodies of the file's masses; unless `exact`, others than a designer's."""
    bodies = reference_bodies(robot).reshape(len(robot), 10).copy()
    for body in bodies if not exact else ():
        central = ci.InertialParameters(body).central_inertia * rng.uniform(0.8, 1.25)
        com = body[1:4] / body[0] * rng.uniform(0.9, 1.1, 3)
        body[:] = ci.InertialParameters.from_central(body[0], com, central).vector
    return np.asarray(bodies.ravel())


def reflected(
    rigid: ci.TorqueModel, bodies: np.ndarray, states: ci.Recording
) -> np.ndarray:
    """Return the mean inertia about each joint, as its links have it."""
    q = states.position[:: max(len(states) // 50, 1)]
    rest, found = np.zeros_like(q), []
    still = rigid.predict(bodies, q, rest, rest)
    for j in range(q.shape[1]):
        unit = np.zeros_like(q)
        unit[:, j] = 1.0
        found.append((rigid.predict(bodies, q, rest, unit) - still)[:, j].mean())
    return np.array(found)


def written(seed: int, folder: Path) -> Path:
    """Write a seed's log for a user, if it is not there."""
    import pandas as pd

    file = folder / f"{arm_of(seed)}_{seed}.parquet"
    if not file.exists():
        log = clean_log(seed)
        channels = {"q": log.position, "dq": log.velocity, "tau": log.torque}
        table = {"time": log.time} | {
            f"{name}_{joint}": values[:, j]
            for name, values in channels.items()
            if values is not None
            for j, joint in enumerate(log.joints)
        }
        pd.DataFrame(table).to_parquet(file)
    return file


def problem_of(seed: int, log: Path) -> ci.Problem:
    """Return the problem of a seed's log, and keep it beside the log."""
    kept = log.with_suffix(".toml")
    if kept.exists():
        return ci.load_problem(kept, trust=True)
    part = part_of(arm_of(seed)) if arm_of(seed) in MORE else {}
    drafted = ci.draft_problem(arm_file(arm_of(seed)), log, **part)
    kept.write_text(drafted.text(log.parent))
    return drafted.problem(log.parent)


def accusing(findings: Iterable[LogFinding]) -> list[LogFinding]:
    """Return the findings that are faults or warnings."""
    return [f for f in findings if f.severity != "note"]


def seeds(text: str) -> list[int]:
    """Return the seeds of ``0-29`` or ``3``."""
    first, _, last = text.partition("-")
    return list(range(int(first), int(last or first) + 1))


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--seeds", type=seeds, default=seeds("0-29"))
    parser.add_argument("--folder", type=Path, help="where logs and problems are kept")
    add_write(parser)
    options = parser.parse_args()
    with shown_on(options.write):
        accused = report(options)
    sys.exit(accused > 0)


def report(options: argparse.Namespace) -> int:
    """Print the logs that are accused; return how many are.  Others go to stderr."""
    accused = 0
    with tempfile.TemporaryDirectory() as temporary, threadpool_limits(1):
        folder = options.folder or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        for seed in options.seeds:
            log = written(seed, folder)
            problem = problem_of(seed, log)
            started = process_time()
            found = accusing(check_problem(problem).findings)
            word = f"{process_time() - started:.1f} s"
            accused += bool(found)
            if found:
                verdict = ci.run_study(problem).verdict
                word += f", {verdict.word}"
                if verdict.held_out is not None:  # nothing may be held out
                    word += f", held-out error {verdict.held_out:.1%}"
            told = sys.stdout if found else sys.stderr
            line = f"{log.stem}: {len(found)} findings, {word}"
            print(line, file=told, flush=True)
            for f in found:
                print(
                    f"  {f.severity} {f.kind}, {f.recording}, {f.where}: {f.statement}"
                )
    print(f"accused: {accused} of {len(options.seeds)}")
    return accused


if __name__ == "__main__":
    main()

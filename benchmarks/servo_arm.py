"""What teleoperation alone says of an arm's servos, and intervals between files.

    python benchmarks/servo_arm.py [--seeds 2] [--halves] [--write PAGE]

An SO-101 (of `example-robot-data`) with simulated servos of known parameters is
teleoperated: smooth moves between random poses, goals at 30 Hz, positions of 12 bits at
30 Hz, as LeRobot records them; no duty, no current, no torque.  `identify_servos`
learns from goals and positions alone, with the firmware's gain stated.  Printed are, of
each joint, the values with their half intervals; of several seeds, also the median
error and the median half interval over joints and seeds, relative to the true value,
and how often the interval contains it.

``--halves``: the pendulum of servo_pendulum (CONSISTENT_ID_DATASETS), learnt from two
disjoint halves of its files; how often the two estimates agree within their intervals.
"""

import argparse
import os
import sysconfig
from collections.abc import Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from time import process_time

import numpy as np
from pages import add_write, shown_on

from consistent_id._support.arrays import Matrix
from consistent_id.robot.loaders import load_robot
from consistent_id.robot.model import RobotModel
from consistent_id.rollout import ServoLog, identify_servos, read_servo_logs
from consistent_id.rollout.servo_fit import _identified, _ServoData
from consistent_id.rollout.servo_result import ServoForm

SO101 = (
    "cmeel.prefix/share/example-robot-data/robots/so_arm_description/urdf/so101.urdf"
)
STEP = 0.001  # s, of the simulation
RATE = 30.0  # Hz, of goals and positions
TICK = 2 * np.pi / 4096  # rad
GAIN = 8.0  # 1/rad, share of full duty over position error
LATE = 0.03  # s, of goals
TRUTH = {
    "stall": 2.5,  # N m
    "viscous": 0.5,  # N m s/rad, the motor's back-EMF included
    "coulomb": 0.08,  # N m
    "armature": 0.025,  # kg m^2
    "delay": LATE,
    "zero": 0.0,
}
UNITS = {
    "stall": "N m",
    "viscous": "N m s/rad",
    "coulomb": "N m",
    "armature": "kg m^2",
    "delay": "s",
    "zero": "rad",
}
CREEP = 0.005  # rad/s, width of the sign change of friction


def teleoperated(
    robot: RobotModel, seconds: float, rng: np.random.Generator
) -> tuple[Matrix, Matrix]:
    """Return times and goals at 30 Hz: smooth moves of 0.6 to 2 s, and rests."""
    time = np.arange(0.0, seconds, 1.0 / RATE)
    low = np.array([joint.limits.lower for joint in robot.joints])
    high = np.array([joint.limits.upper for joint in robot.joints])
    middle, half = 0.5 * (low + high), 0.3 * (high - low)
    goals = np.empty((len(time), len(low)))
    for j in range(len(low)):
        at, place = 0.0, middle[j]
        while at < seconds:
            move, rest = rng.uniform(0.6, 2.0), rng.exponential(0.3)
            target = middle[j] + half[j] * rng.uniform(-1.0, 1.0)
            s = np.clip((time - at) / move, 0.0, 1.0)
            inside = time >= at
            shape = s**3 * (10 - 15 * s + 6 * s**2)
            goals[inside, j] = (place + (target - place) * shape)[inside]
            at, place = at + move + rest, target
    return time, goals


def played(file: Path, robot: RobotModel, time: Matrix, goals: Matrix) -> Matrix:
    """Return positions at the times of an arm with the true servos (Pinocchio)."""
    import pinocchio as pin

    model = pin.buildModelFromUrdf(str(file))
    places = [model.joints[model.getJointId(n)].idx_v for n in robot.joint_names]
    data, n = model.createData(), model.nv
    q, dq = np.zeros(n), np.zeros(n)
    q[places] = goals[0]
    armature = TRUTH["armature"] * np.eye(n)
    seen = np.empty_like(goals)
    for k in range(len(time)):
        seen[k] = np.round(q[places] / TICK) * TICK
        for i in range(round(1.0 / RATE / STEP)):
            now = time[k] + i * STEP - LATE
            goal = np.empty(n)
            goal[places] = goals[max(int(now * RATE), 0)]
            duty = np.clip(GAIN * (goal - q), -1.0, 1.0)
            torque = TRUTH["stall"] * duty - TRUTH["coulomb"] * np.tanh(dq / CREEP)
            bias = pin.nonLinearEffects(model, data, q, dq)
            mass = pin.crba(model, data, q)
            mass = np.triu(mass) + np.triu(mass, 1).T + armature
            # Friction is implicit: it would need steps much shorter than these.
            slope = (
                TRUTH["viscous"]
                + TRUTH["coulomb"] / CREEP / np.cosh(np.clip(dq / CREEP, -30, 30)) ** 2
            )
            rest = torque - TRUTH["viscous"] * dq - bias
            dq = dq + STEP * np.linalg.solve(mass + STEP * np.diag(slope), rest)
            q = q + STEP * dq
    return seen


def arm_study(
    seeds: int, episodes: int, seconds: float, names: Sequence[str]
) -> list[str]:
    """Return the table of an arm that is teleoperated, of some joints or of all."""
    file = Path(sysconfig.get_path("purelib")) / SO101
    robot = load_robot(file)
    errors: dict[str, list[tuple[float, float, float]]] = {}
    borders: dict[str, int] = {}
    columns: dict[str, ServoForm] = {}
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        logs = []
        for episode in range(episodes):
            time, goals = teleoperated(robot, seconds, rng)
            seen = played(file, robot, time, goals)
            name = f"episode {episode}"
            logs.append(ServoLog(name, robot.joint_names, time, seen, goals))
        for name in names or robot.joint_names:
            place = robot.joint_names.index(name)
            data = _ServoData(robot, tuple(logs), (), GAIN)
            servo = _identified(data, place, ["plain"], seed)
            form = servo.chosen
            for name in form.at_border:
                borders[name] = borders.get(name, 0) + 1
            for name, value in form.values.items():
                known = (value - TRUTH[name], form.half_intervals[name], value)
                errors.setdefault(name, []).append(known)
            number = f", seed {seed}" if seeds > 1 else ""
            columns[f"`{servo.joint}`{number}"] = form
    lines = _joints(columns)
    if seeds > 1:
        lines += ["", *_table(errors, borders, len(columns))]
    return lines


def _joints(columns: Mapping[str, ServoForm]) -> list[str]:
    """Return the table of each joint's values."""
    forms = columns.values()

    def cell(form: ServoForm, name: str) -> str:
        if name not in form.values:
            return "-"
        border = ", at a border" if name in form.at_border else ""
        return f"{form.values[name]:.3g} +- {form.half_intervals[name]:.2g}{border}"

    lines = [
        f"| parameter | true | {' | '.join(columns)} |",
        f"|---|{'--:|' * (len(columns) + 1)}",
    ]
    for name, true in TRUTH.items():
        cells = " | ".join(cell(form, name) for form in forms)
        lines.append(f"| `{name}`, {UNITS[name]} | {true:g} | {cells} |")
    left = " | ".join(f"{1e3 * form.left_out:.1f}" for form in forms)
    return [*lines, f"| error of logs left out, mrad |  | {left} |"]


def _table(
    errors: dict[str, list[tuple[float, float, float]]],
    borders: dict[str, int],
    joints: int,
) -> list[str]:
    lines = [
        "| parameter | true | median error | median half interval | contained | at a "
        "border |",
        "|---|--:|--:|--:|--:|--:|",
    ]
    for name, found in errors.items():
        off, half, _ = np.array(found).T
        within = int((abs(off) <= half).sum())
        scale = abs(TRUTH[name])
        texts = [
            f"{100 * np.median(v) / scale:.0f} %" if scale else f"{np.median(v):.3f}"
            for v in (abs(off), half)
        ]
        lines.append(
            f"| `{name}` | {TRUTH[name]:g} | {' | '.join(texts)} | {within} of "
            f"{joints} | {borders.get(name, 0)} |"
        )
    return lines


def halves() -> list[str]:
    """Return how the estimates of two halves of the pendulum's files agree."""
    from servos import PENDULUM

    files = sorted(
        Path(os.environ["CONSISTENT_ID_DATASETS"]).glob("servo_p*/*.parquet")
    )
    files = [file for file in files if not file.name.startswith("kp200")]
    with TemporaryDirectory() as folder:
        urdf = Path(folder) / "pendulum.urdf"
        urdf.write_text(PENDULUM)
        robot = load_robot(urdf)
    logs = read_servo_logs(files, robot.joint_names)
    names = [file.stem for file in files]
    first = [log for log in logs if names.index(log.name.split(",")[0]) % 2 == 0]
    parts = [first, [log for log in logs if log not in first]]
    lines = []
    for form in ("plain", "load"):
        one, other = (
            identify_servos(robot, part, forms=[form]).joints[0].chosen
            for part in parts
        )
        for name, value in one.values.items():
            gap = abs(value - other.values[name])
            both = np.hypot(one.half_intervals[name], other.half_intervals[name])
            lines.append(
                f"| {form} | `{name}` | {value:.4g} | {other.values[name]:.4g} | "
                f"{gap:.2g} | {both:.2g} | {'yes' if gap <= both else 'no'} |"
            )
    return lines


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--episodes", type=int, default=4)
    parser.add_argument("--seconds", type=float, default=12.0)
    parser.add_argument("--joints", nargs="+", default=())
    parser.add_argument("--halves", action="store_true")
    add_write(parser)
    options = parser.parse_args()
    with shown_on(options.write):
        report(options)


def report(options: argparse.Namespace) -> None:
    """Print the tables."""
    start = process_time()
    lines = (
        halves()
        if options.halves
        else arm_study(options.seeds, options.episodes, options.seconds, options.joints)
    )
    print("\n".join(lines))
    print(f"{process_time() - start:.0f} s of CPU")


if __name__ == "__main__":
    main()

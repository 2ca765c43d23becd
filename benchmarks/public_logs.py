"""Public logs as they lie in their repositories: how many commands until a number.

    python benchmarks/public_logs.py [--only NAME ...] [--write docs/public-logs.md]

The recordings are those of CONSISTENT_ID_DATASETS.  Where these are converted, a file
of the original's form is written from them into a temporary folder: names, order and
number of columns, delimiter, header or none, units, several files.  The first command
names the robot and the log, and nothing else.  A second one is what the first prints
after ``try:``; a value that the user has to know (``KP,KD``) is filled in and stated.
No file is edited.  Seconds are CPU seconds of all commands.
"""

import argparse
import json
import os
import re
import shlex
import struct
import subprocess
import sys
import sysconfig
import zipfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

TORQUE = re.compile(r"^(use|use with care|do not use): .*?error ([\d.]+ %)", re.M)
VERDICT = re.compile(r"(use with care|do not use|use)\b")
SERVO = re.compile(r"([\d.]+ mrad)")
MOST_COMMANDS = 4
HEAD = "| log | form | commands | CPU s | verdict | held-out error |"


@dataclass(frozen=True)
class PublicLog:
    """A log, its source, and how a file of its form is made.

    Parameters
    ----------
    source, licence : str
        Of the log.
    form : str
        Of the files; "as it is" if they are the originals.
    make : callable
        From a folder to the words of the first command.
    knows : mapping of str to str
        Values that messages ask for and no log holds, by their placeholder.
    """

    name: str
    source: str
    licence: str
    form: str
    make: Callable[[Path], Sequence[str | Path]]
    knows: Mapping[str, str] = field(default_factory=dict)


def datasets() -> Path:
    """Return the folder of the recordings."""
    return Path(os.environ["CONSISTENT_ID_DATASETS"])


def example_robot(path: str) -> Path:
    """Return a robot's file of the package example-robot-data."""
    folder = "cmeel.prefix/share/example-robot-data/robots"  # of a wheel
    return Path(sysconfig.get_path("purelib")) / folder / path


def channels(file: str, *stems: str) -> list[np.ndarray]:
    """Return the time and the numbered columns of each stem, shape (samples, n)."""
    table = pq.read_table(datasets() / file)
    known = table.column_names
    found = [table["time"].to_numpy()]
    for stem in stems:
        names = [n for n in known if re.fullmatch(rf"{stem}\d+", n)]
        columns = [table[name].to_numpy().astype(np.float64) for name in names]
        found.append(np.column_stack(columns))
    return found


UR10E = {
    "a": "ur10e/identification/ur-20_02_10-30sec_12harm.parquet",
    "b": "ur10e/validation/ur-20_02_05-20sec_8harm.parquet",
}
UR_STEMS = ("q", "dq", "current", "current_des", "tau_des")


def ur10e_csv(folder: Path) -> list[str | Path]:
    """31 columns without a header, four decimals."""
    for name, file in UR10E.items():
        table = np.column_stack(channels(file, *UR_STEMS))
        np.savetxt(folder / f"{name}.csv", table, fmt="%.4f", delimiter=",")
    robot = datasets() / "ur10e/ur10e.urdf"
    return ["identify", robot, folder / "a.csv", "--validate", folder / "b.csv"]


def rtde(folder: Path) -> list[str | Path]:
    """Write what UR's recorder of RTDE writes: names and spaces."""
    words = ("actual_q", "actual_qd", "actual_current", "target_current")
    names = [f"{w}_{k}" for w in (*words, "target_moment") for k in range(6)]
    for name, file in UR10E.items():
        table = np.column_stack(channels(file, *UR_STEMS))
        header = " ".join(["timestamp", *names])
        path = folder / f"{name}.csv"
        np.savetxt(path, table, fmt="%.6f", header=header, comments="")
    robot = datasets() / "ur10e/ur10e.urdf"
    return ["identify", robot, folder / "a.csv", "--validate", folder / "b.csv"]


def kuka_mat(folder: Path) -> list[str | Path]:
    """Write a structure ``rec`` of arrays (axes, samples), degrees, motor torque."""
    from scipy.io import savemat

    files = {"A": "identification/FF_A.parquet", "B": "validation/FF_B.parquet"}
    for name, file in files.items():
        stems = ("q", "dq", "q_link", "tau_motor")
        t, q, dq, secondary, motor = channels(f"kuka_kr300/{file}", *stems)
        (folder / name).mkdir()
        record = {
            "time_cont": t[None],
            "act_pos_mot_deg": np.degrees(q).T,
            "act_vel_mot_deg_per_s": np.degrees(dq).T,
            "act_pos_se_deg": np.pad(np.degrees(secondary).T, ((0, 3), (0, 0))),
            "act_torque_abs_nm": motor.T,
        }
        savemat(folder / name / "data.mat", {"rec": record})
    robot = datasets() / "kuka_kr300/kr300.urdf"
    a, b = (folder / name / "data.mat" for name in files)
    return ["identify", robot, a, "--validate", b]


def tx40_csv(folder: Path) -> list[str | Path]:
    """Two files of six numbered columns, of motors; no clock."""
    file = "staubli_tx40/identification/seg_0.0-4.5s.parquet"
    _, q, torque = channels(file, "q_motor", "tau_motor")
    for name, table in (("pos_read_data", q), ("curr_data", torque)):
        header = ",".join(map(str, range(6)))
        path = folder / f"{name}.csv"
        np.savetxt(path, table, "%.8g", ",", header=header, comments="")
    robot = datasets() / "staubli_tx40/tx40.urdf"
    return ["identify", robot, folder / "pos_read_data.csv", folder / "curr_data.csv"]


def tiago_csv(folder: Path) -> list[str | Path]:
    """One file for each channel, ``- NAME_position`` and so on; motor currents."""
    joints = ["torso_lift_joint", *(f"arm_{k}_joint" for k in range(1, 8))]
    files = ("identification/first60.parquet", "validation/last40.parquet")
    parts = [channels(f"tiago/{f}", "q", "dq", "current") for f in files]
    t, *found = (np.concatenate(each) for each in zip(*parts, strict=True))
    words = ("position", "velocity", "effort")
    for word, values in zip(words, found, strict=True):
        header = ",".join(["t", *(f"- {joint}_{word}" for joint in joints)])
        table = np.column_stack([t, values])
        path = folder / f"tiago_{word}.csv"
        np.savetxt(path, table, "%.9g", ",", header=header, comments="")
    logs = [folder / f"tiago_{word}.csv" for word in words]
    return ["identify", datasets() / "tiago/tiago.urdf", *logs]


def torch_file(path: Path, tensors: Mapping[str, np.ndarray]) -> None:
    """Write a file as ``torch.save`` writes a dictionary of float tensors."""

    def text(word: str) -> bytes:
        raw = word.encode()
        return b"X" + struct.pack("<I", len(raw)) + raw

    def numbers(values: Sequence[int]) -> bytes:
        return b"(" + b"".join(b"J" + struct.pack("<i", v) for v in values) + b"t"

    body = b"\x80\x02}("
    with zipfile.ZipFile(path, "w") as members:
        for key, (name, array) in enumerate(tensors.items()):
            data = np.ascontiguousarray(array, dtype="<f4")
            strides = [step // 4 for step in data.strides]
            kind = b"ctorch\nFloatStorage\n"
            place = b"J" + struct.pack("<i", data.size)
            body += text(name) + b"ctorch._utils\n_rebuild_tensor_v2\n(("
            body += (
                text("storage") + kind + text(str(key)) + text("cpu") + place + b"tQ"
            )
            body += b"K\x00" + numbers(data.shape) + numbers(strides)
            body += b"\x89ccollections\nOrderedDict\n)RtR"
            members.writestr(f"traj_0/data/{key}", data.tobytes())
        members.writestr("traj_0/data.pkl", body + b"u.")
        members.writestr("traj_0/version", b"3\n")


def unitree_pt(robot: str, model: str, folder: Path) -> list[str | Path]:
    """Write tensors of time, position and command; no velocity, no torque."""
    t, q, command = channels(f"{robot}/chirp.parquet", "q", "qdes")
    tensors = {"time": t, "dof_pos": q, "des_dof_pos": command}
    torch_file(folder / "traj_0.pt", tensors)
    return ["identify", datasets() / robot / model, folder / "traj_0.pt"]


def ur3_bag(folder: Path) -> list[str | Path]:
    """Name the bags that their author recorded."""
    robot = example_robot("ur_description/urdf/ur3_robot.urdf")
    first, second = (datasets() / f"ur3_currents/id{k}.bag" for k in (1, 2))
    return ["identify", robot, first, "--validate", second]


def pendulum(folder: Path) -> list[str | Path]:
    """Name the servo's logs; the robot is the known mass on its arm."""
    from servos import PENDULUM

    (folder / "pendulum.urdf").write_text(PENDULUM)
    files = sorted((datasets() / "servo_pendulum").glob("*.parquet"))
    held = [f for f in files if f.name.startswith("kp200")]
    rest = [f for f in files if f not in held]
    return ["servo", folder / "pendulum.urdf", *rest, "--validate", *held]


def franka(folder: Path) -> list[str | Path]:
    """One of the logs of a resting arm that is touched; each value stands twice."""
    robot = example_robot("panda_description/urdf/panda.urdf")
    return ["identify", robot, datasets() / "franka_contacts/a4.parquet"]


def lerobot(folder: Path) -> list[str | Path]:
    """Write a data set of version 3.0 in degrees, of episodes of 8 s: the Z1's."""
    t, q, command = channels("unitree_z1/chirp.parquet", "q", "qdes")
    names = [f"joint{k}.pos" for k in range(1, 7)] + ["jointGripper.pos"]
    episode = (t // 8.0).astype(int)
    first = np.array([t[episode == e][0] for e in episode])
    table = pa.table(
        {
            "observation.state": list(np.degrees(q).astype(np.float32)),
            "action": list(np.degrees(command).astype(np.float32)),
            "timestamp": (t - first).astype(np.float32),
            "episode_index": episode,
            "frame_index": np.arange(len(t)),
        }
    )
    (folder / "data/chunk-000").mkdir(parents=True)
    pq.write_table(table, folder / "data/chunk-000/file-000.parquet")
    lists = {"dtype": "float32", "shape": [7], "names": names}
    single = {"dtype": "float32", "shape": [1], "names": None}
    info = {
        "codebase_version": "v3.0",
        "robot_type": "z1",
        "fps": 200,
        "total_episodes": int(episode.max()) + 1,
        "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
        "features": {
            "observation.state": lists,
            "action": lists,
            "timestamp": single,
            "episode_index": single | {"dtype": "int64"},
            "frame_index": single | {"dtype": "int64"},
        },
    }
    (folder / "meta").mkdir()
    (folder / "meta/info.json").write_text(json.dumps(info))
    return ["identify", datasets() / "unitree_z1/z1.xml", folder]


def two_topics(folder: Path) -> list[str | Path]:
    """Write a ROS 2 bag in which the gripper has its own topic of joint states."""
    from rosbags.rosbag2 import Writer
    from rosbags.typesys import Stores, get_typestore

    types = get_typestore(Stores.ROS2_HUMBLE)
    kinds = types.types
    state, file = "sensor_msgs/msg/JointState", "identification/FF_A.parquet"
    t, q, dq, torque = channels(f"kuka_kr300/{file}", "q", "dq", "tau")
    arm = [f"joint_{k}" for k in range(1, 7)]
    with Writer(folder / "bag", version=9) as bag:
        topics = {
            name: bag.add_connection(name, state, typestore=types)
            for name in ("/gripper/joint_states", "/joint_states")
        }
        for k, second in enumerate(t):
            nanoseconds = round(1e9 * second) + 10**18
            stamp = kinds["builtin_interfaces/msg/Time"](
                nanoseconds // 10**9, nanoseconds % 10**9
            )
            header = kinds["std_msgs/msg/Header"](stamp, "")
            fingers = (["finger_left", "finger_right"], *[np.zeros(2)] * 3)
            moved = arm, q[k], dq[k], torque[k]
            for topic, values in zip(topics.values(), (fingers, moved), strict=True):
                raw = types.serialize_cdr(kinds[state](header, *values), state)
                bag.write(topic, nanoseconds, raw)
    return ["identify", datasets() / "kuka_kr300/kr300.urdf", folder / "bag"]


FIGAROH = "thanhndv212/figaroh-examples"
ISAAC = "iit-DLSLab/simple-robot-identification-isaaclab"
RATE = {"RATEHz": "5000Hz"}
GO2 = {"KP,KD": "20,1.5"}
Z1 = {"KP,KD": "80,2.5 120,2.5 120,2.5 80,2.5 80,2.5 80,2.5 80,2.5"}
LOGS = (
    PublicLog(
        "UR10e",
        "shamilmamedov/dynamic_calibration",
        "none stated",
        "CSV, 31 columns without a header; currents",
        ur10e_csv,
    ),
    PublicLog(
        "KUKA KR300",
        "JonasWeigand/Robot_Identification",
        "MIT",
        "MATLAB structure, degrees, torque of motors",
        kuka_mat,
    ),
    PublicLog(
        "TX40",
        FIGAROH,
        "Apache-2.0",
        "two CSV files of motors, no clock",
        tx40_csv,
        RATE,
    ),
    PublicLog(
        "TIAGo",
        FIGAROH,
        "Apache-2.0",
        "a CSV file for each channel; currents",
        tiago_csv,
    ),
    PublicLog(
        "Go2",
        ISAAC,
        "BSD-3-Clause",
        "PyTorch tensors, no torque",
        partial(unitree_pt, "unitree_go2", "go2.xml"),
        GO2,
    ),
    PublicLog(
        "Z1",
        ISAAC,
        "BSD-3-Clause",
        "PyTorch tensors, no torque",
        partial(unitree_pt, "unitree_z1", "z1.xml"),
        Z1,
    ),
    PublicLog(
        "UR3",
        "aspectum/ur3-force-estimation",
        "MIT",
        "as it is: ROS 1 bags, reversed currents, own names",
        ur3_bag,
    ),
    PublicLog(
        "XL330 servo",
        "Rhoban/bam",
        "Apache-2.0",
        "as it is (but Parquet): duty, no torque",
        pendulum,
    ),
    PublicLog(
        "Franka, touched",
        "MindLabZHAW/tactileGestureDetection",
        "MIT",
        "as it is (but Parquet): at rest, doubled stamps",
        franka,
    ),
    PublicLog(
        "LeRobot",
        "huggingface/lerobot (form); the Z1's recording",
        "Apache-2.0",
        "data set v3.0, lists, degrees, episodes, no torque",
        lerobot,
        Z1,
    ),
    PublicLog(
        "RTDE",
        "UniversalRobots/RTDE_Python_Client_Library (form); the UR10e's recording",
        "none stated",
        "spaces, `actual_q_0` ...; currents",
        rtde,
    ),
    PublicLog(
        "ROS 2 with gripper",
        "ros2_control (form); the KR300's recording",
        "MIT",
        "bag with two topics of joint states",
        two_topics,
    ),
)


@dataclass(frozen=True)
class Outcome:
    """The commands that a log took, their CPU seconds, and what they ended with."""

    commands: int
    seconds: float
    verdict: str
    error: str
    said: str


def tried(log: PublicLog, folder: Path) -> Outcome:
    """Run a command, and what it prints to be tried, until there is a number."""
    words = [str(word) for word in log.make(folder)]
    before = sum(os.times()[2:4])
    for count in range(1, MOST_COMMANDS + 1):
        call = [sys.executable, "-m", "consistent_id", *words]
        run = subprocess.run(call, capture_output=True, text=True)
        used = sum(os.times()[2:4]) - before
        if run.returncode in (0, 1):
            verdict, error = _number(words[0], run.stdout)
            return Outcome(count, used, verdict, error, run.stdout)
        following = next_words(run.stderr, log.knows)
        if following is None:
            break
        words = following
    return Outcome(count, used, "-", "-", run.stderr)


def _number(command: str, text: str) -> tuple[str, str]:
    """Return the verdict and the error that a command has printed."""
    if command == "servo":
        found, said = SERVO.search(text), VERDICT.match(text)
        return said[1] if said else "-", found[1] if found else "-"
    found = TORQUE.search(" ".join(text.split()))
    return (found[1], found[2]) if found else ("-", "-")


def next_words(message: str, knows: Mapping[str, str]) -> list[str] | None:
    """Return the command that a message proposes, None if a value stays open."""
    lines = [line for line in message.splitlines() if line.startswith("try: ")]
    if not lines:
        return None
    text = lines[-1].removeprefix("try: consistent-id ")
    for placeholder, value in knows.items():
        text = text.replace(placeholder, value)
    open_value = re.search(r" (?:[A-Z]+,[A-Z]+|RATEHz)\b", text)
    return None if open_value else shlex.split(text)


def row(log: PublicLog, found: Outcome) -> str:
    """Return a row of the table."""
    known = "; ".join(f"{k} from its source" for k in log.knows)
    form = f"{log.form}{f' ({known})' if known else ''}"
    counted = str(found.commands) if found.error != "-" else "none leads to a number"
    return (
        f"| {log.name} | {form} | {counted} | {found.seconds:.0f} | {found.verdict} | "
        f"{found.error} |"
    )


def table(logs: Sequence[PublicLog], show: Callable[[str], None] = print) -> list[str]:
    """Return the table of some logs, row by row as they are done."""
    lines = [HEAD, "|---|---|--:|--:|---|--:|"]
    done = 0
    for log in logs:
        with TemporaryDirectory() as folder:
            found = tried(log, Path(folder))
        done += found.error != "-" and found.commands <= 2
        lines.append(row(log, found))
        show(lines[-1])
        if found.error == "-":
            show(found.said[-2000:])
    lines += ["", f"{done} of {len(logs)} give a number in at most two commands."]
    return lines


def main() -> None:
    """Print the table, or write it into a page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", nargs="+", default=[log.name for log in LOGS])
    parser.add_argument("--write", type=Path)
    options = parser.parse_args()
    lines = table([log for log in LOGS if log.name in options.only])
    print("\n".join(lines))
    if options.write is not None:
        page = options.write.read_text()
        begin, end = (page.index(f"<!-- table: {w} -->") for w in ("begin", "end"))
        head = page[:begin] + "<!-- table: begin -->\n"
        options.write.write_text(head + "\n".join(lines) + "\n" + page[end:])


if __name__ == "__main__":
    main()

"""Arms and recordings that `faults_real` spoils: six real ones, and one simulated.

Those whose torque lies in their files under another name, or that have no file of a
drafted form, are written as a user would have them: a Z1 with the torque of its PD
controller, a UR3 whose currents were multiplied by the gains that its bodies imply, and
a Panda simulated by `clean_simulations`.
"""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
from clean_recordings import MEASURED, POSITIONS, Robot, robots
from clean_simulations import arm_file, clean_log
from expected import UR3, UR3_JOINTS

import consistent_id as ci
from consistent_id.problems.nominal_gains import implied_gains
from consistent_id.robot.chains import Selection

RECORDINGS = {
    "ur10e": (
        "identification/ur-20_02_10-30sec_12harm",
        "validation/ur-20_02_05-20sec_8harm",
    ),
    "kuka_kr300": ("identification/FF_A", "validation/FF_B"),
    "staubli_tx40": ("identification/seg_0.0-4.5s", "identification/seg_0.0-4.5s"),
    "tiago": ("identification/first60", "validation/last40"),
    "unitree_z1": ("chirp", "chirp"),
    "ur3": ("id1", "id2"),
    "panda": ("first", "second"),
}
"""Recordings to learn from, and to be predicted: of TX40 and Z1 there is one, whole."""

REAL = tuple(RECORDINGS)[:-1]

_PANDA, _LEARNT = 75, 0.6  # seed of a log of 24 s, and its share to learn from


def arms(folder: Path, into: Path) -> list[Robot]:
    """Write, or link, what the arms need into a folder, and return the arms."""
    found = []
    for robot in robots(folder):
        if robot.name == "unitree_z1":
            found.append(_z1(robot, folder, into))
        elif robot.name in RECORDINGS:
            (into / robot.name).symlink_to(folder / robot.name)
            found.append(robot)
    return [*found, _ur3(folder, into), _panda(into)]


def _z1(robot: Robot, folder: Path, into: Path) -> Robot:
    """Name the torque of the controller as if it were measured.

    The velocity of the gripper is always zero: positions alone are used.
    """
    where = into / robot.name
    where.mkdir()
    (where / robot.model).write_text((folder / robot.name / robot.model).read_text())
    table = pd.read_parquet(folder / robot.name / "chirp.parquet")
    commands = [c for c in table if re.fullmatch(r"d?qdes\d+", c)]
    table.drop(columns=commands).to_parquet(where / "chirp.parquet")
    columns = {**POSITIONS, "torque": "taudes{number}"}
    return replace(robot, columns=columns, gains=None)


def _ur3(folder: Path, into: Path) -> Robot:
    """Turn currents into torques by the gains that the bodies of the file imply."""
    bags = [folder / f"ur3_currents/id{k}.bag" for k in (1, 2)]
    draft = ci.draft_problem(
        UR3,
        bags[:1],
        validation=bags[1:],
        torque_gain=[1.0] * len(UR3_JOINTS),
        names=UR3_JOINTS,
        select=False,
    )
    problem = draft.problem()
    logs = [*problem.logs("training"), *problem.logs("validation")]
    robot = problem.moving
    gains = implied_gains(robot, logs[:1], UR3.name).values
    where = into / "ur3"
    where.mkdir()
    (where / UR3.name).write_text(UR3.read_text())
    for bag, log in zip(bags, logs, strict=True):
        own = log.of(robot.joint_names)
        torque = gains * np.asarray(own.torque)
        _written(replace(own, torque=torque), where / f"{bag.stem}.parquet")
    return Robot("ur3", UR3.name, MEASURED)


def _panda(into: Path) -> Robot:
    """Simulate a Panda with friction, rotors, noise and steps of its encoders."""
    source, where = arm_file("panda"), into / "panda"
    where.mkdir()
    (where / source.name).write_text(source.read_text())
    log = clean_log(_PANDA)
    split = int(_LEARNT * len(log))
    for name, rows in (("first", slice(split)), ("second", slice(split, None))):
        _written(log.samples(rows), where / f"{name}.parquet")
    return Robot("panda", source.name, POSITIONS, Selection(tip="panda_link7"))


def _written(log: ci.Recording, file: Path) -> None:
    """Write a recording with numbered columns."""
    channels = {"q": log.position, "dq": log.velocity, "tau": log.torque}
    table = {"time": log.time} | {
        f"{name}{k}": values[:, k - 1]
        for name, values in channels.items()
        if values is not None
        for k in range(1, values.shape[1] + 1)
    }
    pd.DataFrame(table).to_parquet(file)


def leaning_model(text: str, degrees: float) -> str:
    """Return a URDF or MJCF drawn as if the base was level, though it leans.

    What the robot does is done to the drawing: a URDF is mounted on a new root that is
    turned about x, and an MJCF's gravity is turned.
    """
    angle = float(np.radians(degrees))
    if "<mujoco" in text:
        down = -9.81 * np.array([0.0, np.sin(angle), np.cos(angle)])
        along = " ".join(f"{g:.9g}" for g in down)
        return text.replace("<option ", f'<option gravity="{along}" ', 1)
    children = set(re.findall(r'<child\s+link="([^"]+)"', text))
    links = re.findall(r'<link\s+name="([^"]+)"', text)
    (root,) = (link for link in dict.fromkeys(links) if link not in children)
    mount = (
        f'<link name="floor"/><joint name="mount" type="fixed"><parent link="floor"/>'
        f'<child link="{root}"/><origin rpy="{angle!r} 0 0"/></joint>'
    )
    head, end, rest = text.rpartition("</robot>")
    return f"{head}{mount}{end}{rest}"

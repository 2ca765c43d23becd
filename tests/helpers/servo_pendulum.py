"""A pendulum that a servo drives, and logs of it."""

from dataclasses import replace

import numpy as np

from consistent_id.rollout import ServoLog
from consistent_id.rollout import servo_fit as fitting
from consistent_id.rollout.servo_motion import (
    STEP,
    LoggedDrive,
    cut_pieces,
    simulated,
)
from consistent_id.rollout.servo_result import JointServo, ServoFit, ServoForm

PENDULUM = """<robot name="pendulum"><link name="bench"/>
<link name="arm"><inertial><origin xyz="0.1 0 0"/><mass value="0.5"/>
<inertia ixx="1e-5" ixy="0" ixz="0" iyy="1e-5" iyz="0" izz="1e-5"/></inertial></link>
<joint name="servo" type="revolute"><origin rpy="0 1.5707963267948966 0"/>
<parent link="bench"/><child link="arm"/><axis xyz="0 1 0"/>
<limit lower="-3.2" upper="3.2" effort="1" velocity="20"/></joint></robot>"""


TRUTH = {"stall": 0.7, "viscous": 0.03, "armature": 0.002, "coulomb": 0.02}


TRUTH |= {"delay": 0.005, "zero": 0.01}


GAIN = 1.5  # 1/rad


def a_log(robot, seconds=3.0, frequency=0.7, name="log", **planted):
    """A log of the planted servo, by the simulation itself, of 12 bits a turn."""
    time = np.arange(0.0, seconds, 0.005)
    goal = 0.9 * np.sin(2 * np.pi * frequency * time) * np.sin(time) ** 2
    goal = goal[:, None]
    plain = ServoLog(name, robot.joint_names, time, 0.0 * goal, goal)
    pieces = cut_pieces(robot, [plain], 0, [LoggedDrive(GAIN, 0.0)])
    sets = {k: np.array([v]) for k, v in (TRUTH | planted).items()}
    q = simulated(sets, pieces)[:, 0, 0]
    q = np.interp(time, STEP * np.arange(len(q)), q)
    tick = 2 * np.pi / 4096
    q = (np.round(q / tick) * tick)[:, None]
    duty = np.clip(GAIN * (goal - q), -1.0, 1.0)
    return replace(plain, position=q, duty=duty)


def hand_made(**values):
    form = ServoForm("plain", TRUTH | values, dict.fromkeys(TRUTH, 0.0), 0.0, 0.0)
    return ServoFit("pendulum", (JointServo("servo", (form,), {}, 0.0),), None)


def quick(monkeypatch, generations=2):
    for name in ("_GENERATIONS", "_DESCENT", "_AGAIN"):
        monkeypatch.setattr(fitting, name, generations)


def two_joints(tmp_path):
    joint = """<joint name="{}" type="revolute"><origin rpy="0 {} 0" xyz="{} 0 0"/>
<parent link="{}"/><child link="{}"/><axis xyz="0 1 0"/>{}
<limit lower="-3.2" upper="3.2" effort="1" velocity="20"/></joint>"""
    arm = PENDULUM[PENDULUM.index('<link name="arm">') : PENDULUM.index("<joint")]
    path = tmp_path / "two.urdf"
    path.write_text(
        '<robot name="two"><link name="bench"/>'
        + arm
        + arm.replace('"arm"', '"hand"')
        + joint.format("a", np.pi / 2, 0, "bench", "arm", "")
        + joint.format("b", 0.3, 0.1, "arm", "hand", "{}")
        + "</robot>"
    )
    return path


def written(path, log, names="time,position,goal_position,load", unit=1.0):
    table = np.column_stack(
        [log.time, log.position / unit, log.goal / unit, 885 * log.duty]
    )
    np.savetxt(path, table, delimiter=",", header=names, comments="")
    return path

"""A small robot and a log of it, as files that a user would have."""

from functools import cache
from io import StringIO
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from consistent_id import (
    DriveTerms,
    Recording,
    TorqueModel,
    low_passed,
    simulate_torque,
)
from consistent_id.robot import load_urdf

URDF = """<robot name="arm">
  <link name="base"/>
  <joint name="shoulder" type="revolute">
    <parent link="base"/> <child link="upper"/>
    <axis xyz="0 1 0"/> <limit lower="-3" upper="3" velocity="4" effort="90"/>
  </joint>
  <link name="upper"><inertial>
    <origin xyz="0.2 0.01 0.02"/> <mass value="4"/>
    <inertia ixx="0.02" ixy="0" ixz="0" iyy="0.08" iyz="0" izz="0.08"/>
  </inertial></link>
  <joint name="elbow" type="revolute">
    <parent link="upper"/> <child link="fore"/> <origin xyz="0.4 0 0"/>
    <axis xyz="0 0 1"/> <limit lower="-3" upper="3" velocity="4" effort="60"/>
  </joint>
  <link name="fore"><inertial>
    <origin xyz="0.15 0.02 0.01"/> <mass value="2"/>
    <inertia ixx="0.01" ixy="0" ixz="0" iyy="0.03" iyz="0" izz="0.03"/>
  </inertial></link>
</robot>
"""
DRIVE = DriveTerms(viscous=True, coulomb="tanh", velocity_scale=0.02, offset=True)
HEAD = """
name = "arm"
[model]
urdf = "arm.urdf"
[drive]
viscous = true
coulomb = "tanh"
velocity_scale = 0.02
offset = true
[constraints]
masses = "free"
[data]
"""
FRICTION = [2.0, 3.0, 0.5, 1.0, 1.5, -0.3]


def write_arm(folder):
    """Write ``arm.urdf`` and ``log.csv``; return the two paths."""
    urdf, log = folder / "arm.urdf", folder / "log.csv"
    urdf.write_text(URDF)
    log.write_text(_log())
    return urdf, log


@cache
def _log():
    with TemporaryDirectory() as folder:
        urdf = Path(folder, "arm.urdf")
        urdf.write_text(URDF)
        recording = moved(TorqueModel(load_urdf(urdf), DRIVE))
    table = np.column_stack([recording.time, recording.position, recording.torque])
    header, text = "time,q_shoulder,q_elbow,tau_shoulder,tau_elbow", StringIO()
    np.savetxt(text, table, "%.9g", ",", header=header, comments="")
    return text.getvalue()


def moved(model, seconds=24.0, rate=100.0, tempo=1.0):
    """Return a recording that begins and ends with a second of rest."""
    time = np.arange(int(seconds * rate)) / rate
    fade = np.clip(np.minimum(time - 1.0, seconds - 1.0 - time), 0.0, 1.0)
    fade = fade**3 * (10 - 15 * fade + 6 * fade**2)
    waves = [
        sum(a * np.sin(2 * np.pi * f * tempo * time + p) for a, f, p in terms)
        for terms in (
            ((0.6, 0.23, 0), (0.3, 0.61, 1), (0.1, 1.3, 2)),
            ((0.7, 0.31, 2), (0.3, 0.73, 0), (0.1, 1.1, 1)),
        )
    ]
    q = fade[:, None] * np.column_stack(waves)
    dq = np.gradient(q, time, axis=0)
    exact = Recording(
        model.robot.joint_names, time, q, dq, np.gradient(dq, time, axis=0)
    )
    truth = np.concatenate([model.robot.nominal, FRICTION])
    log = simulate_torque(model, truth, exact, noise=0.1, rng=np.random.default_rng(0))
    return low_passed(log, torque_cutoff=40.0)

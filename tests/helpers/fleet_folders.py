"""Problem files and logs of robots of one type, as a user of fleets has them."""

from dataclasses import replace

import numpy as np
from logged import moved, write_arm

import consistent_id as ci

FILE = """
name = "{name}"
[model]
urdf = "arm.urdf"
[drive]
viscous = true
coulomb = "tanh"
velocity_scale = 0.02
offset = true
rotor_inertia = {rotor}
[constraints]
masses = "free"
[data]
columns = {{torque = "tau_{{joint}}"}}
preparation = {{motion_cutoff = 10.0, torque_cutoff = 10.0}}
[[data.recordings]]
file = "log.csv"
role = "training"
"""


def write_robots(root):
    """Write folders of five robots, one of which carries something; return the root."""
    for k in range(5):
        folder = root / f"robot{k}"
        folder.mkdir()
        urdf, log = write_arm(folder)
        model = ci.TorqueModel(
            ci.robot.load_urdf(urdf),
            ci.DriveTerms(viscous=True, coulomb="tanh", velocity_scale=0.02),
        )
        motion = replace(
            moved(_replace_offset(model), tempo=1.0 + 0.1 * k), torque=None
        )
        x = np.concatenate([np.ravel(model.robot.nominal), [2, 0.5 + k / 9, 1.0, 1.5]])
        x[10:20] += ci.InertialParameters.from_central(
            0.5 * (k == 2) + 1e-9, (0.3, 0.1, 0), 1e-12 * np.eye(3)
        ).vector
        rng = np.random.default_rng(k)
        made = ci.simulate_torque(model, x, motion, noise=0.1, rng=rng)
        table = np.column_stack([made.time, made.position, made.torque])
        header = "time,q_shoulder,q_elbow,tau_shoulder,tau_elbow"
        np.savetxt(log, table, "%.12g", ",", header=header, comments="")
        text = FILE.format(name=f"robot{k}", rotor="false")
        (folder / "problem.toml").write_text(text)
    return root


def _replace_offset(model):
    """The model with the offset that `moved` wants."""
    drive = ci.DriveTerms(
        viscous=True, coulomb="tanh", velocity_scale=0.02, offset=True
    )
    return ci.TorqueModel(model.robot, drive)

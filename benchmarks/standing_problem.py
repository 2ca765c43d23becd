"""A problem file and logs of a robot that MuJoCo simulates on its feet."""

import json
from pathlib import Path

import numpy as np
from standing_robots import EXAMPLES, StandingRobot
from standing_simulation import simulated

import consistent_id as ci

PROBLEM = """# A box on the trunk, simulated by benchmarks/quadruped.py.
name = "trunk"

[model]
{model}
base = "floating"

[drive]
viscous = true
rotor_inertia = true
coulomb = "tanh"
velocity_scale = 0.02

[constraints]
masses = "free"
known_links = {others}  # from a log of the robot hung up by its trunk
fixed = {{ {rotors} }}

[data]
recordings = [
  {{ file = "training.csv", role = "training", rows = [50, {last}] }},
  {{ file = "validation.csv", role = "validation", rows = [50, {last}] }},
]

[data.columns]
torque = "tau_{{joint}}"

[data.base]
angular_velocity = ["gyro_x", "gyro_y", "gyro_z"]
acceleration = ["acc_x", "acc_y", "acc_z"]
orientation = ["q_w", "q_x", "q_y", "q_z"]
order = "wxyz"

[data.preparation]
motion_cutoff = {cutoff}
torque_cutoff = {cutoff}
least_joint_speed = "estimated"
"""


def write_problem(folder: Path, robot: StandingRobot) -> Path:
    """Write a problem file and its logs; return its path."""
    folder.mkdir(parents=True, exist_ok=True)
    for seed, name in enumerate(("training", "validation")):
        log = simulated(robot, seed)
        columns = _columns(log)
        rows = np.column_stack(list(columns.values()))
        header = ",".join(columns)
        file = folder / f"{name}.csv"
        np.savetxt(file, rows, "%.9g", ",", header=header, comments="")
    known = robot.known().items()
    rotors = [f'"{k}" = {v:g}' for k, v in known if k.endswith("rotor_inertia")]
    names = robot.nominal.link_names
    text = PROBLEM.format(
        model=_model_line(robot),
        others=json.dumps([name for name in names if name != robot.trunk]),
        rotors=", ".join(rotors),
        last=len(log) - 50,
        cutoff=robot.cutoff,
    )
    for foot in robot.feet:
        text += (
            f'\n[[data.contacts]]\nframe = "{foot.frame}"\n'
            f'closed = "contact_{foot.frame}"\n'
            f"guard = {ci.signals.impact_guard(robot.cutoff):.3f}\n"
        )
        text += (
            "surface = true\n"
            if foot.sole
            else f"point = {list(foot.point)}\nradius = {foot.radius}\n"
        )
    path = folder / "problem.toml"
    path.write_text(text)
    return path


def _model_line(robot: StandingRobot) -> str:
    if robot.path.suffix == ".xml":
        return 'mjcf = "${CONSISTENT_ID_DATASETS}/unitree_go2/go2.xml"'
    return f'urdf = "{robot.path}"  # of {EXAMPLES}'


def _columns(log: ci.Recording) -> dict[str, np.ndarray]:
    """Return a log's channels by the names that the problem file gives them."""
    columns = {"time": log.time}
    columns |= {f"q_{j}": log.position[:, i] for i, j in enumerate(log.joints)}
    columns |= {f"tau_{j}": log.torque[:, i] for i, j in enumerate(log.joints)}
    for name, values in (
        ("gyro", log.base.angular_velocity),
        ("acc", log.base.specific_force),
    ):
        columns |= {f"{name}_{c}": values[:, i] for i, c in enumerate("xyz")}
    turned = _quaternions(log.base.rotation)
    columns |= {f"q_{c}": turned[:, i] for i, c in enumerate("wxyz")}
    return columns | {f"contact_{c.frame}": 1.0 * c.closed for c in log.contacts}


def _quaternions(rotation: np.ndarray) -> np.ndarray:
    import mujoco

    found = np.zeros((len(rotation), 4))
    for quaternion, R in zip(found, rotation, strict=True):
        mujoco.mju_mat2Quat(quaternion, R.ravel())
    return found

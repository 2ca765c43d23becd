"""Writes ``problems/walker``: a quadruped on its feet, with a box on its trunk.

``python benchmarks/walking_problem.py``.  The robot lifts one foot after another while
its trunk sways.  Forces at the feet are any that balance the trunk; no sensor measures
them.  Logged, with noise, are encoders, joint torques, a gyroscope, an accelerometer,
the trunk's orientation and which feet touch.  `walking.walk` of the tests computes the
motion, in closed form, and the torques.
"""

import sys
from pathlib import Path

import numpy as np

from consistent_id.regression.drive.drive_terms import DriveTerms
from consistent_id.robot.inertia import InertialParameters
from consistent_id.robot.loaders.mjcf import load_mjcf

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "tests" / "helpers"))

from quadrupeds import CORNERS, FEET, FOOT, quadruped_text  # noqa: E402
from walking import RATE, walk  # noqa: E402

FOLDER = ROOT / "problems" / "walker"
BOX = InertialParameters.from_central(2.0, [0.05, 0.02, 0.1], 0.02 * np.eye(3))
VISCOUS = 0.2  # N m s/rad, of each joint
SECONDS, EVERY = 16.0, 2  # each foot is lifted twice; of the computed samples
#: Noise by the beginning of a column's name: rad, N m, rad/s, m/s^2.
NOISE = {"q_": 2e-5, "tau_": 0.05, "gyro_": 0.002, "acc_": 0.02}

TEXT = """\
# Written by benchmarks/walking_problem.py.
name = "walker"
description = "Simulated quadruped that lifts one foot at a time, a box on its trunk."
source = "simulated by benchmarks/walking_problem.py"
licence = "BSD-3-Clause"

[model]
mjcf = "robot.xml"
base = "floating"

[drive]
viscous = true

# The legs are as the file has them; of the trunk with its box, nothing is known.
[constraints]
masses = "free"
known_links = [
{legs}]

[data]
recordings = [
  {{ file = "training.npz", role = "training", rows = [50, {last}] }},
  {{ file = "validation.npz", role = "validation", rows = [50, {last}] }},
]

[data.columns]
torque = "tau_{{joint}}"

[data.base]
angular_velocity = ["gyro_x", "gyro_y", "gyro_z"]
acceleration = ["acc_x", "acc_y", "acc_z"]
orientation = ["quat_w", "quat_x", "quat_y", "quat_z"]
order = "wxyz"

[data.preparation]
motion_cutoff = 20.0  # Hz
torque_cutoff = 20.0  # Hz
"""
CONTACT = """
[[data.contacts]]
frame = "{foot}"
closed = "contact_{foot}"
point = {point}
"""


def write_problem(folder: Path) -> Path:
    """Write the robot, its logs and the problem file; return the file."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "robot.xml").write_text(quadruped_text(hips=CORNERS))
    robot = load_mjcf(folder / "robot.xml", base="floating")
    truth = np.append(robot.nominal, np.full(len(robot), VISCOUS))
    truth[:10] += BOX.vector
    rng = np.random.default_rng(28)
    for seed, name in enumerate(("training", "validation")):
        drive = DriveTerms(viscous=True)
        log = walk(robot, truth, seconds=SECONDS, seed=seed, drive=drive)
        kept = {n: _logged(n, x, rng) for n, x in log.items() if _kept(n)}
        np.savez_compressed(folder / f"{name}.npz", **kept)
    legs = [f'  "{leg}_{part}",' for leg in "abcd" for part in ("hip", "thigh", "calf")]
    last = int(SECONDS * RATE) // EVERY - 50
    text = TEXT.format(legs="".join(f"{line}\n" for line in legs), last=last)
    text += "".join(CONTACT.format(foot=f, point=list(FOOT)) for f in FEET)
    file = folder / "problem.toml"
    file.write_text(text)
    return file


def _kept(name: str) -> bool:
    """Return whether a robot without force sensors logs a column."""
    return name == "time" or name.startswith((*NOISE, "quat_", "contact_"))


def _logged(name: str, values: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return a column as it is logged: noisy, in steps that are less than its noise.

    Steps are powers of two, so that single precision has them, and files are small.
    """
    values = values[::EVERY]
    if name == "time":
        return values
    noise = next((NOISE[n] for n in NOISE if name.startswith(n)), 0.0)
    step = 2.0 ** np.floor(np.log2(noise or 2e-5))
    noisy = values + noise * rng.normal(size=len(values))
    return np.asarray(step * np.round(noisy / step), dtype="float32")


if __name__ == "__main__":
    print(write_problem(FOLDER))

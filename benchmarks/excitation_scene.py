"""What designs among bodies reach: a Panda over a floor, with its own meshes.

``python benchmarks/excitation_scene.py``: 20 mm apart, 90 % of the limits, 10 s, five
harmonics, one process; with the scene and without it.
"""

import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
from excitation_cases import EXAMPLES

import consistent_id as ci
from consistent_id.motion.collisions.scene_file import scene_from_urdf

WORK = 14.0  # units; about as many seconds of an idle processor


def main() -> None:
    file = EXAMPLES / "panda_description/urdf/panda.urdf"
    robot = ci.load_urdf(file, tip="panda_link8")
    allowed = [("ground", "panda_link0"), ("ground", "panda_link1")]
    scene = scene_from_urdf(file, robot, ground=0.0, clearance=0.02, allowed=allowed)
    limits = ci.motion_limits(robot, effort=np.inf).within(0.9)
    print("| objective | scene | condition number | errors | proven [mm] | CPU [s] |")
    print("|---|---|---:|---:|---:|---:|")
    for objective in ("D", "condition"):
        free = None
        for bodies in (None, scene):
            began = time.process_time()
            design = ci.design_trajectory(
                robot,
                ci.PathForm(10.0, 5),
                ci.Aim(objective, refine=None),
                limits=limits,
                scene=bodies,
                starts=2,
                workers=1,
                time_limit=WORK,
            )
            seconds = time.process_time() - began
            errors = np.log(design.accuracy.standard_errors()).mean()
            free = errors if free is None else free
            apart = design.proof.clearance
            print(
                f"| {objective} | {'none' if bodies is None else 'floor, 20 mm'} "
                f"| {design.condition.value:.3g} | {np.exp(errors - free):.2f} "
                f"| {'-' if apart is None else f'{apart.proven * 1e3:.1f}'} "
                f"| {seconds:.1f} |",
                flush=True,
            )


if __name__ == "__main__":
    main()

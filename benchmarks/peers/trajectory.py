"""FIGAROH's exciting trajectories; started by ``excitation_figaroh.py``, in its Python.

``python trajectory.py URDF PACKAGES SECONDS SEED FILE [EFFORT ...]`` starts its
optimiser again and again, each time from another random path, until a time of the
processor has passed.  ``FILE`` (npz) gets every path it looks at but those of finite
differences: ``spent``, seconds of the processor, and ``motion``, shape (paths, 3,
samples, joints), 100 Hz.  With largest torques, one for each joint, it keeps them, and
its columns include friction, rotor inertia and offset; without, there are no such
limits and columns.
"""

import os
import sys
import tempfile
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np
import pinocchio as pin
from figaroh.optimal.base_optimal_trajectory import (
    BaseOptimalTrajectory,
    BaseTrajectoryIPOPTProblem,
)
from figaroh.tools.robot import Robot

WAYPOINTS = 6  # all but the first are searched for
STEP = 2.0  # s from one to the next, its default
RATE = 10  # Hz, of its regressor, limits; waypoints are samples to the last digit
ATTEMPTS = 10  # to begin within the limits
FINE = 100  # Hz, of what is written
CONFIGURATION = f"""
robot:
  name: robot
tasks:
  identification:
    problem:
      model_components: {{friction: ON, actuator_inertia: ON, joint_offset: ON}}
  optimal_trajectory:
    problem: {{soft_lim: 0.0, max_attempts: {ATTEMPTS}}}
    trajectory: {{waypoints: {WAYPOINTS}, segment_duration: {STEP}, frequency: {RATE}}}
"""


class Search(BaseOptimalTrajectory):
    """Its optimiser, whose paths are kept until time is up."""

    def __init__(self, robot: Robot, file: str, seconds: float, notes: Path) -> None:
        super().__init__(robot, list(robot.model.names)[1:], file)
        self.identif_config["act_idxv"] = range(robot.model.nv)  # its examples do so
        self.initialize()
        self.notes, self.seconds = notes, seconds
        self.spent: list[float] = []
        self.curves: list[tuple[np.ndarray, ...]] = []
        self.began = process_time()

    def create_ipopt_problem(self, *arguments: Any) -> "Segment":
        """Return the problem of its own base class."""
        return Segment(self, *arguments)

    def note(self, *curve: np.ndarray) -> None:
        """Keep a path; end the process when time is up."""
        self.spent.append(process_time() - self.began)
        self.curves.append(curve)
        self.end_in_time()

    def end_in_time(self) -> None:
        """Write all paths and end the process, if time is up."""
        if process_time() - self.began < self.seconds:
            return
        motion = [self.CB.get_full_config(FINE, *one)[1:] for one in self.curves]
        np.savez(self.notes, spent=self.spent, motion=motion)
        os._exit(0)  # its own code would catch an exception


class Segment(BaseTrajectoryIPOPTProblem):
    """Its problem, which tells its search of iterates."""

    differences = False

    def objective(self, X: np.ndarray) -> float:
        """Return the condition number, as it does."""
        if not self.differences:
            waypoints = np.vstack([self.wp_init, np.reshape(X, (-1, self.n_joints))])
            self.opt_traj.note(self.tps, waypoints.T, self.vel_wps, self.acc_wps)
        return float(super().objective(X))

    def gradient(self, X: np.ndarray) -> np.ndarray:
        """Return its gradient by finite differences."""
        self.differences = True
        try:
            return np.asarray(super().gradient(X))
        finally:
            self.differences = False


def main() -> None:
    urdf, packages, seconds, seed, notes, *efforts = sys.argv[1:]
    np.random.seed(int(seed))  # noqa: NPY002 - what FIGAROH draws from
    robot = Robot(urdf, package_dirs=packages)
    robot.model.effortLimit[:] = [float(most) for most in efforts] or 1e19
    robot.collision_model = robot.geom_model = pin.GeometryModel()
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "configuration.yaml"
        names = ", ".join(list(robot.model.names)[1:])
        text = CONFIGURATION.replace("ON", "yes" if efforts else "no")
        file.write_text(text + f"joints: {{active_joints: [{names}]}}\n")
        search = Search(robot, str(file), float(seconds), Path(notes))
    while True:
        search.solve(stack_reps=1)
        search.end_in_time()  # it may have found no path to begin with


if __name__ == "__main__":
    main()

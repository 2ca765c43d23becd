"""Raw logs of simulated robots, prepared as `draft_problem` prepares a user's.

A raw log has positions in encoder steps, and torque with noise; no velocity, and no
acceleration.
"""

from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

import consistent_id as ci
from consistent_id.export.urdf_export import urdf_text
from consistent_id.problems.draft_reading import usual_cutoff

STEP = 2.0 * np.pi / 2**19  # rad, of encoders
DRAFTS = 20  # logs of each draft


def encoded(
    position: np.ndarray, rng: np.random.Generator, *, step: float = STEP
) -> np.ndarray:
    """Return what encoders read, whose zeros are anywhere within a step."""
    ahead = step * rng.uniform(size=position.shape[1])
    return step * np.round((position + ahead) / step)


class Preparation:
    """The default preparation of a robot's logs, drafted anew for every twentieth.

    A draft reads the robot from a file, and selects a model by the log's training rows.
    An estimate has the terms of the simulated robot, and of the draft only what it does
    to a log.
    """

    def __init__(self, model: ci.TorqueModel, clean: ci.Recording) -> None:
        regression = ci.build_regression(model, clean)
        found = ci.constrained_least_squares(
            model, regression, constraints=[ci.constraints.PhysicalConsistency()]
        )
        self._file = urdf_text(found, "simulated")
        self._gravity = {} if model.robot.gravity.any() else {"gravity": np.zeros(3)}
        self._count, self._problem = 0, None

    def __call__(
        self,
        clean: ci.Recording,
        noise: np.ndarray,
        rng: np.random.Generator,
        *,
        step: float = STEP,
    ) -> ci.Recording:
        """Return a log, prepared; `clean` is its exact motion and torque."""
        read = encoded(clean.position, rng, step=step)
        return self.log(replace(clean, position=read, torque=clean.torque + noise))

    def log(self, raw: ci.Recording) -> ci.Recording:
        """Return a log, prepared; velocity and acceleration are not read."""
        bare = replace(raw, velocity=None, acceleration=None)
        if self._count % DRAFTS == 0:
            self._problem = self._drafted(bare)
        self._count += 1
        return self.alike(bare)

    def alike(self, raw: ci.Recording) -> ci.Recording:
        """Return another log, prepared as the last one was."""
        assert self._problem is not None
        return self._problem.prepare(replace(raw, velocity=None, acceleration=None))

    def _drafted(self, raw: ci.Recording) -> ci.Problem:
        with TemporaryDirectory() as folder:
            file = Path(folder) / "robot.urdf"
            file.write_text(self._file)
            draft = ci.draft_problem(file, raw, **self._gravity)
            return draft.problem(Path(folder))


def standing(
    clean: ci.Recording, noise: np.ndarray, rng: np.random.Generator
) -> ci.Recording:
    """Return the same of a robot on its feet, whose base is measured exactly."""
    read = encoded(clean.position, rng)
    raw = replace(
        clean,
        position=read,
        velocity=None,
        acceleration=None,
        torque=clean.torque + noise,
    )
    cutoff = usual_cutoff([raw], standing=True)
    smooth = ci.low_passed(raw, motion_cutoff=cutoff, torque_cutoff=cutoff)
    return ci.differentiated(smooth)

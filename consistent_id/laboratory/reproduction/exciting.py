"""Exciting motions in place of a paper's, equally long: two ways to be fair.

Within the robot's limits, as the problem file has them; and within what the paper's own
motions used of each joint's range, speed and acceleration, so that what is gained comes
from the choice of the motion alone.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from consistent_id.excitation.design import design_trajectory
from consistent_id.excitation.designed import ExcitationDesign
from consistent_id.excitation.request import design_request
from consistent_id.motion.limits import MotionLimits
from consistent_id.problems.problem import Problem
from consistent_id.recordings.recording import Recording

_ENOUGH = 120.0  # s; searches end by themselves long before, and so are repeatable


@dataclass(frozen=True, slots=True, eq=False)
class ExcitingSet:
    """As many exciting motions as there were experiments.

    Parameters
    ----------
    designs : dict of str to ExcitationDesign
        By the experiment that each takes the place of.
    """

    name: str
    limits: MotionLimits
    designs: dict[str, ExcitationDesign]

    def motions(self, tasks: Mapping[str, Recording]) -> dict[str, Recording]:
        """Return the designs, sampled at the rates of the tasks they stand for."""
        return {
            name: design.trajectory.recording(tasks[name].rate, f"in place of {name}")
            for name, design in self.designs.items()
        }


def used_by(limits: MotionLimits, motions: Mapping[str, Recording]) -> MotionLimits:
    """Return limits that hold the range, speed and acceleration of some motions."""
    own = [motion.of(limits.joints) for motion in motions.values()]
    return replace(
        limits,
        lower=np.min([m.position.min(axis=0) for m in own], axis=0),
        upper=np.max([m.position.max(axis=0) for m in own], axis=0),
        velocity=np.max([abs(_known(m.velocity)).max(axis=0) for m in own], axis=0),
        acceleration=np.max(
            [abs(_known(m.acceleration)).max(axis=0) for m in own], axis=0
        ),
    )


def exciting_set(
    problem: Problem,
    name: str,
    motions: Mapping[str, Recording],
    limits: MotionLimits | None = None,
    *,
    seed: int = 0,
) -> ExcitingSet:
    """Design a motion in place of each experiment, of the same duration.

    Each from a random start of its own; frequencies reach as high as the problem's
    ``[excitation]`` table asks, whatever the duration.

    Parameters
    ----------
    motions : mapping of str to Recording
        By experiment.
    limits : MotionLimits, optional
        By default those of the ``[excitation]`` table.
    seed : int
        Of the first; the others count up.
    """
    request = design_request(problem)
    limits = request.limits if limits is None else limits
    designs = {}
    for k, (experiment, motion) in enumerate(motions.items()):
        duration = float(motion.time[-1] - motion.time[0])
        share = duration / request.form.duration
        form = replace(
            request.form,
            duration=duration,
            harmonics=int(np.ceil(round(request.form.harmonics * share, 6))),
        )
        design = design_trajectory(
            problem.model,
            form,
            request.aim,
            limits=limits,
            starts=1,
            workers=1,
            time_limit=_ENOUGH,
            seed=seed + k,
        )
        if design.interrupted:
            raise KeyboardInterrupt  # a study of paths that are not done says nothing
        designs[experiment] = design
    return ExcitingSet(name, limits, designs)


def _known(values: np.ndarray | None) -> np.ndarray:
    return np.zeros((1, 1)) if values is None else values

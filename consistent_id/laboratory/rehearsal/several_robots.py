"""Motions played by several planted robots, here or wherever an executor says."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from consistent_id._support.arrays import Vector
from consistent_id._support.executors import Executor
from consistent_id._support.interrupts import note_stop
from consistent_id._support.progress import counted
from consistent_id._support.threads import single_threaded
from consistent_id.excitation.accuracy import PredictedAccuracy
from consistent_id.laboratory.rehearsal.planted import PlantedRobot
from consistent_id.laboratory.rehearsal.rehearsal import Rehearsal, rehearse
from consistent_id.motion.limits import MotionLimits
from consistent_id.recordings.paths import JointPath


@dataclass(frozen=True, slots=True, eq=False)
class PredictedMotion:
    """A motion to play, and what is predicted of it."""

    path: JointPath
    accuracy: PredictedAccuracy


@dataclass(frozen=True, slots=True, eq=False)
class RehearsalPlan:
    """What all robots that play have in common; see `rehearse`.

    Parameters
    ----------
    validation : JointPath
    limits : MotionLimits
    noise : ndarray, shape (joints,), [N m or N]
    highest : float, [Hz]
    rate : float, [Hz]
    seed : int
    """

    validation: JointPath
    limits: MotionLimits
    noise: Vector
    highest: float
    rate: float
    seed: int


def played_by_all(
    plan: RehearsalPlan,
    motions: Mapping[str, Sequence[PredictedMotion]],
    robots: Sequence[PlantedRobot],
    *,
    executor: Executor | None = None,
    progress: bool = False,
) -> dict[str, tuple[Rehearsal, ...]]:
    """Let every robot play every motion; each has the same noise in all of them.

    An interrupt leaves what has been played so far, if anything has.

    Parameters
    ----------
    plan : RehearsalPlan
    motions : mapping of str to sequence of PredictedMotion
        By name; several of one name are alike, such as random paths.
    robots : sequence of PlantedRobot
    executor : Executor, optional
        Where robots play; the result is the same.  By default here.
    progress : bool
        Show a bar.
    """
    names, tasks = [], []
    for name, alike in motions.items():
        for motion in alike:
            tasks += [(motion, robot, k) for k, robot in enumerate(robots)]
            names += [name] * len(robots)
    found: list[Rehearsal] = []
    results = (executor or Executor()).map(partial(_played, plan), tasks)
    with counted(len(tasks), "motions played", progress) as count:
        try:
            for one in results:
                found.append(one)
                count(len(found))
        except KeyboardInterrupt as cause:
            if not found:
                raise
            note_stop(cause)
    return {
        name: tuple(one for own, one in zip(names, found, strict=False) if own == name)
        for name in dict.fromkeys(names[: len(found)])
    }


@single_threaded
def _played(
    plan: RehearsalPlan, task: tuple[PredictedMotion, PlantedRobot, int]
) -> Rehearsal:
    motion, robot, number = task
    return rehearse(
        robot,
        motion.accuracy,
        motion.path,
        plan.validation,
        plan.limits,
        plan.noise,
        np.random.default_rng((plan.seed, number, 1)),
        highest=plan.highest,
        rate=plan.rate,
    )

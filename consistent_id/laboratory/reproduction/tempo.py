"""How slow tasks must have been for a paper's scatter, if its own errors are right.

A paper's verification errors bound what its model leaves out: friction as large as a
guess may be more than they allow.  Inertial torque falls with the square of a task's
tempo and Coulomb friction does not, so what is allowed may still be enough where the
tasks were slow.  Here friction is what the printed errors allow, joint by joint, and
the tasks' tempo is varied.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from consistent_id._support.arrays import Array, Matrix, Vector
from consistent_id.laboratory import Laboratory
from consistent_id.laboratory.reproduction.budget import error_budget, unmodelled_torque
from consistent_id.problems.problem import Problem
from consistent_id.problems.published import parametrisation_of, published_table
from consistent_id.recordings.recording import Recording, states

SLOWNESS = (1.0, 1.5, 2.0, 3.0, 4.0, 6.0)


@dataclass(frozen=True, slots=True, eq=False)
class Tempo:
    """Scatter over experiments whose tasks are slowed down.

    Parameters
    ----------
    names : tuple of str
        Of the paper's combinations.
    slowness : ndarray, shape (tempos,)
        Factors by which tasks take longer.
    allowed : ndarray, shape (joints,)
        Factors of the laboratory's friction at which friction alone, along the paper's
        verification motion, has the mean square that the paper prints as its error.
    scatter : ndarray, shape (tempos, combinations)
        Of least squares as published, with friction as allowed.
    noise : ndarray, shape (tempos, combinations)
        Of the sensors' noise alone.
    """

    names: tuple[str, ...]
    slowness: Vector
    allowed: Vector
    scatter: Matrix
    noise: Matrix

    def needed(self, place: int, value: float) -> float:
        """Return the slowness at which a parameter scatters by `value`.

        Interpolated between logarithms; infinite or 1 beyond what was looked at.
        """
        total = np.hypot(self.scatter[:, place], self.noise[:, place])
        if total[0] >= value:
            return 1.0
        above = np.flatnonzero(total >= value)
        if not len(above):
            return float("inf")
        k = int(above[0])
        low, high = np.log(total[k - 1 : k + 1])
        share = (np.log(value) - low) / (high - low)
        first, second = np.log(self.slowness[k - 1 : k + 1])
        return float(np.exp(first + share * (second - first)))


@dataclass(frozen=True, slots=True, eq=False)
class PrintedSpread:
    """What a paper's own vectors say along its own verification motion.

    Parameters
    ----------
    vectors : ndarray, shape (experiments, joints), [(N m)^2]
        Mean square of the torque by which each vector differs from the mean.
    most_scattered : ndarray, shape (joints,), [(N m)^2]
        The same for one standard deviation of the parameter that scatters most, alone.
    printed : ndarray, shape (motions, joints), [(N m)^2]
        The errors that the paper prints.
    """

    vectors: Matrix
    most_scattered: Vector
    printed: Matrix


def slowed(motion: Recording, factor: float) -> Recording:
    """Return the same path in `factor` times the time."""
    velocity, acceleration = motion.velocity, motion.acceleration
    return replace(
        motion,
        time=motion.time * factor,
        velocity=None if velocity is None else velocity / factor,
        acceleration=None if acceleration is None else acceleration / factor**2,
    )


def tempo_of(
    problem: Problem,
    laboratory: Laboratory,
    motions: Mapping[str, Recording],
    *,
    cell_rate: float,
    slowness: Sequence[float] = SLOWNESS,
) -> Tempo:
    """Slow tasks down, with as much friction as the printed errors allow."""
    allowed = allowed_friction(problem, laboratory)
    budgets = []
    for factor in slowness:
        slow = {name: slowed(motion, factor) for name, motion in motions.items()}
        budgets.append(error_budget(problem, laboratory, slow, cell_rate=cell_rate))
    parts = np.array([budget.parts[:, :-1].sum(axis=1) for budget in budgets])
    errors = np.einsum("j,teja->tea", allowed, parts)
    return Tempo(
        names=budgets[0].names,
        slowness=np.array(slowness),
        allowed=allowed,
        scatter=np.asarray(errors.std(axis=1, ddof=1)),
        noise=np.array([budget.noise_scatter for budget in budgets]),
    )


def allowed_friction(problem: Problem, laboratory: Laboratory) -> Vector:
    """Return the factor of each joint's friction that the printed errors allow.

    With the mean of the errors printed for a joint; one where nothing is printed.
    """
    printed = np.array(published_table(problem).mean_squared_errors)
    if not printed.size:
        return np.ones(len(laboratory.robot.joints))
    torque = unmodelled_torque(laboratory, *_states(problem))[:-1].sum(axis=0)
    square = np.asarray((torque**2).mean(axis=1))
    return np.asarray(np.sqrt(printed.mean(axis=0) / np.where(square > 0, square, 1)))


def printed_spread(problem: Problem, most_scattered: int) -> PrintedSpread:
    """Compare a paper's vectors along its verification motion.

    Parameters
    ----------
    most_scattered : int
        Place of the parameter that scatters most.
    """
    table, mine = published_table(problem), parametrisation_of(problem)
    Y = mine.regressor(*_states(problem))
    vectors = np.array(table.experiments)
    apart = vectors - vectors.mean(axis=0)
    torque = np.einsum("jas,ea->ejs", Y, apart, optimize=True)
    alone = Y[:, most_scattered] * vectors[:, most_scattered].std(ddof=1)
    joints = Y.shape[0]
    return PrintedSpread(
        vectors=np.asarray((torque**2).mean(axis=2)),
        most_scattered=np.asarray((alone**2).mean(axis=1)),
        printed=np.array(table.mean_squared_errors).reshape(-1, joints),
    )


def _states(problem: Problem) -> tuple[Array, Array, Array]:
    motion = problem.motion(published_table(problem).motion)
    return states(motion.of(problem.model.robot.joint_names))

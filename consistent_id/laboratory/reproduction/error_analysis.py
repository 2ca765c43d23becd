"""Errors of a reproduced paper: where they come from, and on other motions.

Along the paper's tasks they are found, predicted, and repeated with other assumptions.
Verification is on motions that nothing was identified from, as a paper's Table VI.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import msgspec
import numpy as np

from consistent_id._support.arrays import Array, Matrix, Vector
from consistent_id.errors import PathError
from consistent_id.laboratory.experiment import Laboratory, perform, synchronised
from consistent_id.laboratory.from_problem import laboratory_table, task_path
from consistent_id.laboratory.reproduction.budget import (
    ErrorBudget,
    Tempo,
    budget_of,
    error_budget,
    tempo_of,
)
from consistent_id.laboratory.reproduction.experiments import Reproduction
from consistent_id.problems.problem import Problem
from consistent_id.problems.published import published_table
from consistent_id.problems.task_tables import PointsTable, TaskTable
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals.clocks import uniform_rate
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.torque_along import predicted_torque

PLACE = 0.05  # m, by which a task is moved along each axis, at most
SIZE = 1.25  # factor by which its sizes grow or shrink, at most
TIME = 1.25  # the same of its duration
FRICTION = 2.0  # the same of each joint's viscous and Coulomb friction
FRICTIONS = 50  # draws of friction for each draw of tasks
_RATE = 200.0  # Hz; enough for the error analysis of a smooth motion
_TRIES = 50  # at drawing a task that the robot can write
_DRAWS = 400  # of friction


@dataclass(frozen=True, slots=True, eq=False)
class VariedAssumptions:
    """Scatter over the experiments, for many guesses at values that a paper omits.

    Parameters
    ----------
    names : tuple of str
        Names of the paper's combinations.
    friction : ndarray, shape (draws, combinations)
        With the file's tasks and friction drawn.
    both : ndarray, shape (draws, combinations)
        With tasks and friction drawn.
    tasks : ndarray, shape (task draws, combinations)
        With tasks drawn and the file's friction.
    noise : ndarray, shape (task draws, combinations)
        Scatter from the sensors' noise alone, with drawn tasks.
    refused : int
        Tasks drawn that the robot cannot write; others were drawn in their place.
    """

    names: tuple[str, ...]
    friction: Matrix
    both: Matrix
    tasks: Matrix
    noise: Matrix
    refused: int


def vary_assumptions(
    problem: Problem,
    budget_along: Callable[[Mapping[str, Recording]], ErrorBudget],
    planned: ErrorBudget,
    *,
    draws: int,
    seed: int,
) -> VariedAssumptions:
    """Repeat the error analysis for tasks and friction drawn at random.

    Places move by up to `PLACE`; sizes, durations and friction are multiplied by
    factors whose logarithms are uniform, up to `SIZE`, `TIME` and `FRICTION`.

    Parameters
    ----------
    budget_along : callable
        Returns the budget of experiments with other motions.
    planned : ErrorBudget
        Budget of the file's own tasks, whose experiments are drawn.
    draws : int
        Number of draws of tasks; friction is drawn `FRICTIONS` times for each.
    """
    rng = np.random.default_rng(seed)
    budgets, refused = [], 0
    for _ in range(draws):
        motions = {}
        for name in planned.experiments:
            motions[name], tries = _writable(problem, name, rng)
            refused += tries
        budgets.append(budget_along(motions))
    rest = [varied_friction_scatter(budget, FRICTIONS, rng) for budget in budgets]
    empty = np.zeros((0, len(planned.names)))
    return VariedAssumptions(
        names=planned.names,
        friction=varied_friction_scatter(planned, FRICTIONS * max(draws, 1), rng),
        both=np.vstack([empty, *rest]),
        tasks=np.vstack([empty, *(budget.scatter() for budget in budgets)]),
        noise=np.vstack([empty, *(budget.noise_scatter for budget in budgets)]),
        refused=refused,
    )


def varied_friction_scatter(
    budget: ErrorBudget, count: int, rng: np.random.Generator
) -> Array:
    """Return the scatter for friction drawn joint by joint; offsets stay.

    Generators of one seed draw one friction, whatever the motions.

    Returns
    -------
    ndarray, shape (count, combinations)
    """
    shape = (count, len(budget.causes), len(budget.joints))
    factors = FRICTION ** rng.uniform(-1.0, 1.0, shape)
    factors[:, budget.causes.index("offset")] = 1.0
    errors = np.einsum("ncj,ecja->nea", factors, budget.parts, optimize=True)
    return np.asarray(errors.std(axis=1, ddof=1))


def _writable(
    problem: Problem, name: str, rng: np.random.Generator
) -> tuple[Recording, int]:
    """Return a task drawn at random, sampled, and how many were refused before."""
    for tries in range(_TRIES):
        table = _varied(problem.table.tasks[name], rng)
        tasks = {**problem.table.tasks, name: table}
        varied = replace(
            problem, table=msgspec.structs.replace(problem.table, tasks=tasks)
        )
        try:
            return task_path(varied, name).recording(_RATE, name), tries
        except PathError:
            continue
    return task_path(problem, name).recording(_RATE, name), _TRIES


def _varied(table: TaskTable, rng: np.random.Generator) -> TaskTable:
    """Return a task elsewhere, of another size and another speed."""
    shift = rng.uniform(-PLACE, PLACE, 3)
    size = SIZE ** rng.uniform(-1.0, 1.0)
    changed: dict[str, Any] = {"duration": table.duration * _factor(TIME, rng)}
    if isinstance(table, PointsTable):
        points = np.array(table.points)
        middle = points.mean(axis=0)
        changed["points"] = (middle + shift + size * (points - middle)).tolist()
    else:
        changed["centre"] = (np.array(table.centre) + shift).tolist()
        for field in ("radius", "height", "semi_axes"):
            if hasattr(table, field):
                changed[field] = _scaled(getattr(table, field), size)
    return msgspec.structs.replace(table, **changed)


def _factor(most: float, rng: np.random.Generator) -> float:
    return float(most ** rng.uniform(-1.0, 1.0))


def _scaled(sizes: float | Sequence[float], factor: float) -> float | list[float]:
    if isinstance(sizes, Sequence):
        return [factor * size for size in sizes]
    return factor * sizes


@dataclass(frozen=True, slots=True, eq=False)
class ErrorAnalysis:
    """Where errors come from, and how certain that is.

    Parameters
    ----------
    budget : ErrorBudget
        Budget of the experiments as they were performed.
    planned : ErrorBudget
        The same from the planned motions.
    shrunk : dict of str to ndarray, shape (draws, combinations)
        By set of motions: how many times smaller the scatter is than along the tasks,
        with one friction for both, drawn again each time.
    """

    budget: ErrorBudget
    planned: ErrorBudget
    varied: VariedAssumptions
    tempo: Tempo
    shrunk: dict[str, Array]


def analyse_errors(
    problem: Problem,
    laboratory: Laboratory,
    done: Reproduction,
    instead: Mapping[str, Mapping[str, Recording]],
    *,
    draws: int,
    seed: int,
) -> ErrorAnalysis:
    """Analyse the errors of reproduced experiments in all ways.

    Parameters
    ----------
    laboratory : Laboratory
        That of the experiments.
    done : Reproduction
        With friction, along the tasks.
    instead : mapping of str to mapping of str to Recording
        Sets of motions in the tasks' place.
    draws : int
        Number of draws of tasks.
    """
    cell_rate = uniform_rate(done.experiments[0].log.encoders)
    budget_along = partial(error_budget, problem, laboratory, cell_rate=cell_rate)
    thin = {e.name: _downsampled(e.log.wanted) for e in done.experiments}
    planned = budget_along(thin)
    shrunk = {}
    for name, motions in instead.items():
        other = {key: _downsampled(motion) for key, motion in motions.items()}
        shrunk[name] = _times_smaller(planned, budget_along(other), seed)
    return ErrorAnalysis(
        budget=budget_of(problem, laboratory, done),
        planned=planned,
        varied=vary_assumptions(problem, budget_along, planned, draws=draws, seed=seed),
        tempo=tempo_of(problem, laboratory, thin, cell_rate=cell_rate),
        shrunk=shrunk,
    )


def _times_smaller(planned: ErrorBudget, instead: ErrorBudget, seed: int) -> Array:
    """Return the quotients of scatter, shape (draws, combinations)."""
    own, other = (
        varied_friction_scatter(budget, _DRAWS, np.random.default_rng(seed))
        for budget in (planned, instead)
    )
    return np.asarray(own / np.where(other > 0.0, other, np.inf))


def _downsampled(motion: Recording) -> Recording:
    return motion.samples(slice(None, None, max(1, int(motion.rate // _RATE))))


@dataclass(frozen=True, slots=True, eq=False)
class Predictor:
    """Parameters that predict torque: the mean of a method's over experiments.

    Parameters
    ----------
    source : str
        The motion.
    parameters : ndarray, shape (parameters,)
    """

    source: str
    method: str
    model: TorqueModel
    parameters: Vector

    def predict(self, recording: Recording) -> Array:
        """Return torques, shape (samples, joints), [N m or N]."""
        return predicted_torque(self.model, self.parameters, recording)


@dataclass(frozen=True, slots=True, eq=False)
class Verification:
    """Errors of predicted torque on motions of their own.

    Parameters
    ----------
    recordings : tuple of Recording
        The measured recordings, one for each motion.
    predictors : tuple of Predictor
        The last one has the true parameters: its errors are those of the sensors.
    mean_squared_errors : ndarray, shape (predictors, motions, joints), [(N m)^2]
        ``sum (measured - predicted)^2 / samples``.
    """

    joints: tuple[str, ...]
    recordings: tuple[Recording, ...]
    predictors: tuple[Predictor, ...]
    mean_squared_errors: Array


def verification_motions(problem: Problem) -> dict[str, Recording]:
    """Return the motions that a problem's laboratory verifies with.

    Without any, the one of the paper.
    """
    names = laboratory_table(problem).verification
    return {
        name: problem.motion(name)
        for name in names or [published_table(problem).motion]
    }


def mean_predictors(source: str, done: Reproduction) -> tuple[Predictor, ...]:
    """Return the mean of each method, as the paper predicts with.

    A mean of physically consistent parameters is physically consistent.
    """
    return tuple(
        Predictor(
            source,
            first.method,
            first.model,
            np.mean([e.estimates[i].parameters for e in done.experiments], axis=0),
        )
        for i, first in enumerate(done.experiments[0].estimates)
    )


def verify(
    problem: Problem,
    laboratory: Laboratory,
    motions: Mapping[str, Recording],
    predictors: Sequence[Predictor],
    *,
    seed: int,
) -> Verification:
    """Perform motions in the laboratory and predict their torque.

    Prepared like the experiments: synchronised, filtered, trimmed.

    Parameters
    ----------
    predictors : sequence of Predictor
        The truth is added to them.
    seed : int
        Seed of noise; another than the experiments'.
    """
    table, robot = laboratory_table(problem), laboratory.robot
    streams = np.random.default_rng(seed).spawn(len(motions))
    logs = [
        perform(laboratory, motion, rng)
        for motion, rng in zip(motions.values(), streams, strict=True)
    ]
    recordings = tuple(
        synchronised(log, cutoff=table.cutoff, trim=table.trim).recording
        for log in logs
    )
    truth = Predictor("the laboratory", "truth", robot.model, robot.parameters)
    every = (*predictors, truth)
    errors = [[mean_squared_error(one, log) for log in recordings] for one in every]
    return Verification(robot.joints, recordings, every, np.array(errors))


def mean_squared_error(predictor: Predictor, recording: Recording) -> Vector:
    """Return the mean of squares of measured less predicted torque, by joint."""
    measured = recording.of(predictor.model.torque_joints).torque
    if measured is None:
        return np.full(len(predictor.model.torque_joints), np.nan)
    return np.asarray(((measured - predictor.predict(recording)) ** 2).mean(axis=0))

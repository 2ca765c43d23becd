"""Error analyses along a paper's tasks: found, predicted, assumptions varied."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from consistent_id._support.arrays import Array
from consistent_id.laboratory.from_problem import laboratory_of
from consistent_id.laboratory.reproduction.assumptions import (
    VariedAssumptions,
    varied_friction_scatter,
    vary_assumptions,
)
from consistent_id.laboratory.reproduction.budget import (
    ErrorBudget,
    budget_of,
    error_budget,
)
from consistent_id.laboratory.reproduction.experiments import Reproduction
from consistent_id.laboratory.reproduction.tempo import Tempo, tempo_of
from consistent_id.problems.problem import Problem
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals.clocks import uniform_rate

_ENOUGH = 200.0  # Hz, enough for the error analysis of a smooth motion
_DRAWS = 400  # of friction


@dataclass(frozen=True, slots=True, eq=False)
class ErrorAnalysis:
    """Where errors come from, and how certain that is.

    Parameters
    ----------
    budget : ErrorBudget
        Of the experiments as they were performed.
    planned : ErrorBudget
        The same from the motions that were asked for.
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
    inertial: Array,
    done: Reproduction,
    instead: Mapping[str, Mapping[str, Recording]],
    *,
    draws: int,
    seed: int,
) -> ErrorAnalysis:
    """Analyse the errors of reproduced experiments in all ways.

    Parameters
    ----------
    inertial : ndarray, shape (10 links,)
        Of the laboratory's robot.
    done : Reproduction
        With friction, along the tasks.
    instead : mapping of str to mapping of str to Recording
        Sets of motions in the tasks' place.
    draws : int
        Of tasks.
    """
    laboratory = laboratory_of(problem, inertial)
    cell_rate = uniform_rate(done.experiments[0].log.encoders)
    thin = {e.name: _downsampled(e.log.wanted) for e in done.experiments}
    planned = error_budget(problem, laboratory, thin, cell_rate=cell_rate)
    shrunk = {}
    for name, motions in instead.items():
        other = {key: _downsampled(motion) for key, motion in motions.items()}
        budget = error_budget(problem, laboratory, other, cell_rate=cell_rate)
        shrunk[name] = _times_smaller(planned, budget, seed)
    return ErrorAnalysis(
        budget=budget_of(problem, laboratory, done),
        planned=planned,
        varied=vary_assumptions(
            problem, laboratory, planned, cell_rate=cell_rate, draws=draws, seed=seed
        ),
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
    return motion.samples(slice(None, None, max(1, int(motion.rate // _ENOUGH))))

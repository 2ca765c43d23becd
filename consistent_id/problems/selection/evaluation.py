"""Choices evaluated: each set of rows is prepared once, each choice fitted once."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import msgspec
import numpy as np

from consistent_id._support.arrays import Matrix, Vector
from consistent_id._support.executors import Executor
from consistent_id._support.threads import single_threaded
from consistent_id.errors import ConsistentIdError
from consistent_id.problems.file import PreparationTable, ProblemTable
from consistent_id.problems.selection.blocks import NUMBERS, folds
from consistent_id.problems.selection.choice import Choice
from consistent_id.problems.selection.factors import Factors, factors_of
from consistent_id.problems.selection.held_out import HeldOut, held_out
from consistent_id.problems.selection.models import (
    Candidate,
    FoldFits,
    candidate_of,
    fitted,
)
from consistent_id.problems.selection.moves import velocity_scale
from consistent_id.problems.selection.samples import Log, Samples, samples_of
from consistent_id.problems.selection.screening import screened
from consistent_id.problems.selection.superset import Superset, superset
from consistent_id.regression.base import BaseParameters
from consistent_id.regression.regressor import TorqueModel


@dataclass(frozen=True, slots=True, eq=False)
class Setting:
    """What all choices of one selection have in common.

    Parameters
    ----------
    table : ProblemTable
    preparation : PreparationTable
        The file's.
    folder : Path
    bodies : TorqueModel
        The robot without drive terms.
    base : BaseParameters
        Of the bodies.
    loaded, sloped : tuple of str
        Torque joints whose friction may depend on the nominal load, or on position.
    logs : tuple of Log
    band : float, [Hz]
        In which torque is predicted.
    thin : int
        Of so many samples one is kept.
    sigma : ndarray, shape (torque joints,), [N m or N]
        By which errors of joints are divided before they add.
    size : float
        Misfit that counts as one, for the prior's sake.
    """

    table: ProblemTable
    preparation: PreparationTable
    folder: Path
    bodies: TorqueModel
    base: BaseParameters
    loaded: tuple[str, ...]
    sloped: tuple[str, ...]
    logs: tuple[Log, ...]
    band: float
    thin: int
    sigma: Vector
    size: float


@dataclass(frozen=True, slots=True, eq=False)
class Evaluated:
    """A choice, fitted without each fold, and its errors there."""

    choice: Choice
    fits: FoldFits
    errors: HeldOut

    @property
    def error(self) -> float:
        """Root-mean-square error on the blocks, in the units of the joints."""
        return float(np.sqrt(self.errors.total))


@dataclass(frozen=True, slots=True, eq=False)
class Evaluator:
    """Fits choices, and remembers rows and fits.

    Parameters
    ----------
    setting : Setting
    """

    setting: Setting
    _samples: dict[float | None, Samples] = field(default_factory=dict)
    _factors: dict[tuple[object, ...], Factors] = field(default_factory=dict)
    _supersets: dict[float, Superset] = field(default_factory=dict)
    _candidates: dict[Choice, Candidate] = field(default_factory=dict)
    _evaluated: dict[Choice, Evaluated] = field(default_factory=dict)

    @property
    def fits(self) -> int:
        """Constrained fits so far."""
        return len(self._evaluated) * len(folds())

    def rescaled(self, sigma: Vector, size: float) -> "Evaluator":
        """Return an evaluator of the same rows with other units of joints."""
        setting = replace(self.setting, sigma=sigma, size=size)
        rows = self._samples, self._factors, self._supersets
        return Evaluator(setting, *rows, self._candidates)

    def with_friction(
        self, loaded: tuple[str, ...], sloped: tuple[str, ...]
    ) -> "Evaluator":
        """Return an evaluator of the same rows with other joints' laws of friction."""
        setting = replace(self.setting, loaded=loaded, sloped=sloped)
        return Evaluator(setting, self._samples)

    def expected(self, evaluated: Evaluated) -> float:
        """Return the torque error on left-out blocks over the torque, all joints."""
        joints = self.factors(evaluated.choice).joints
        torque = sum(np.sum(R[:, -1] ** 2) for joint in joints for R in joint.cells)
        squares = evaluated.errors.squares.sum(axis=0) @ self.setting.sigma**2
        return float(np.sqrt(squares / len(NUMBERS) / torque))

    def candidate(self, choice: Choice) -> Candidate:
        """Return a choice as a torque model with constraints."""
        s = self.setting
        # How rows are prepared is no part of the model.
        alike = replace(
            choice, motion_cutoff=None, torque_cutoff=None, least_speed=None, delay=0.0
        )
        if alike not in self._candidates:
            found = candidate_of(alike, s.table, s.folder, s.bodies)
            self._candidates[alike] = found
        return self._candidates[alike]

    def evaluated(self, choice: Choice) -> Evaluated:
        """Fit a choice under its constraints without each fold in turn.

        Raises
        ------
        ConsistentIdError
            If there is no such model, or no fit.
        """
        if choice not in self._evaluated:
            s, factors = self.setting, self.factors(choice)
            fits = fitted(self.candidate(choice), factors, s.sigma, s.size)
            errors = held_out(fits, factors, s.sigma)
            self._evaluated[choice] = Evaluated(choice, fits, errors)
        return self._evaluated[choice]

    def evaluate_ahead(self, choices: Sequence[Choice]) -> None:
        """Fit choices side by side if the run has an executor; then they are known."""
        executor = Executor.chosen(None)
        if executor is None:
            return
        s, tasks = self.setting, list[tuple[Choice, Candidate, Factors]]()
        for choice in choices:
            with suppress(ConsistentIdError):  # says `evaluated`, if it is asked
                if choice not in self._evaluated:
                    task = choice, self.candidate(choice), self.factors(choice)
                    tasks.append(task)
        fits = partial(_fitted_or_not, s.sigma, s.size)
        found = executor.map(fits, [task[1:] for task in tasks])
        for (choice, candidate, factors), x in zip(tasks, found, strict=True):
            if x is not None:
                own = FoldFits(candidate, x)
                errors = held_out(own, factors, s.sigma)
                self._evaluated[choice] = Evaluated(choice, own, errors)

    def screened(self, choice: Choice, current: Evaluated) -> HeldOut:
        """Return a choice's errors with the bodies of another held."""
        factors = self.factors(choice)
        candidate = self.candidate(choice)
        return screened(candidate, factors, current.fits, self.setting.sigma)

    def seen_on(self, current: Evaluated, choice: Choice) -> HeldOut:
        """Return the errors of a choice on the rows that another one keeps."""
        if current.choice.least_speed == choice.least_speed:
            return current.errors
        rows = self._factors_of(current.choice, choice.least_speed)
        return held_out(current.fits, rows, self.setting.sigma)

    def factors(self, choice: Choice) -> Factors:
        """Return the factors of the rows that a choice keeps."""
        return self._factors_of(choice, choice.least_speed)

    def samples(self, cutoff: float | None) -> Samples:
        """Return the rows of motion with a cut-off."""
        if cutoff not in self._samples:
            s = self.setting
            table = s.preparation
            if table.method == "butterworth":
                table = msgspec.structs.replace(table, motion_cutoff=cutoff)
            table = msgspec.structs.replace(
                table,
                torque_cutoff=s.band,
                delays={k: v for k, v in table.delays.items() if k != "torque"},
            )
            self._samples[cutoff] = samples_of(
                s.bodies, s.logs, table, guard=0.25 / s.band, thin=s.thin
            )
        return self._samples[cutoff]

    def _factors_of(self, choice: Choice, least_speed: float | None) -> Factors:
        scale = velocity_scale(choice)
        key = (choice.motion_cutoff, choice.delay, scale, least_speed)
        if key not in self._factors:
            s = self.setting
            every = self._superset(scale)
            self._factors[key] = factors_of(
                s.bodies,
                self.samples(choice.motion_cutoff).delayed(choice.delay),
                every.terms,
                every.couplings,
                width=scale,
                band=s.band,
                least_speed=least_speed,
                load=s.bodies.robot.nominal,
            )
        return self._factors[key]

    def _superset(self, scale: float) -> Superset:
        if scale not in self._supersets:
            s = self.setting
            self._supersets[scale] = superset(s.bodies, scale, s.loaded, s.sloped)
        return self._supersets[scale]


@single_threaded
def _fitted_or_not(
    sigma: Vector, size: float, task: tuple[Candidate, Factors]
) -> Matrix | None:
    """Return a candidate's parameters without each fold; None if there is no fit."""
    try:
        return fitted(*task, sigma, size).parameters
    except ConsistentIdError:
        return None

"""Evaluation of choices: each set of rows is prepared once, each choice fitted once.

Before that, moves are ranked cheaply. With fixed bodies, the drive terms of each joint
are the solution of a small non-negative least-squares problem, whose error ranks the
moves. The constrained fit then decides.
"""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import msgspec
import numpy as np

from consistent_id._support.arrays import Array, BoolArray, Matrix, Vector
from consistent_id._support.executors import Executor, single_threaded
from consistent_id.errors import ConsistentIdError
from consistent_id.problems.file import (
    PreparationTable,
    ProblemTable,
)
from consistent_id.problems.selection.choice import (
    Choice,
    joint_widths,
)
from consistent_id.problems.selection.fits import (
    RATES,
    UNSEEN,
    CandidateModel,
    Factors,
    FoldFits,
    HeldOut,
    JointColumns,
    JointFactors,
    candidate_columns,
    candidate_of,
    columns_of,
    factors_of,
    fitted,
    held_out,
)
from consistent_id.problems.selection.samples import (
    NUMBERS,
    SampledLog,
    Samples,
    folds,
    samples_of,
)
from consistent_id.problems.selection.superset import (
    NOTHING,
    KeptLaws,
    Superset,
    superset,
)
from consistent_id.regression.base import BaseParameters
from consistent_id.regression.linear import smallest_solution
from consistent_id.regression.regression import triangle
from consistent_id.regression.regressor import TorqueModel

JointWidths = tuple[float, ...]  # of friction's change of sign

_DELAYS = 4  # first-order steps of a delay, at the most
_RANK = 1e-8  # of the largest singular value, of columns of unit length


@dataclass(frozen=True, slots=True, eq=False)
class Setting:
    """The data and settings that all choices of one selection share.

    Parameters
    ----------
    table : ProblemTable
    preparation : PreparationTable
        That of the file.
    folder : Path
    bodies : TorqueModel
        The robot without drive terms.
    base : BaseParameters
        Base parameters of the bodies.
    loaded, sloped : tuple of str
        Torque joints whose friction may depend on the nominal load (`loaded`) or on
        position (`sloped`).
    logs : tuple of SampledLog
    band : float, [Hz]
        Band in which torque is predicted.
    thin : int
        Step between samples that are kept.
    sigma : ndarray, shape (torque joints,), [N m or N]
        Scales of the joints' errors, by which they are divided before they are added.
    size : float
        Misfit that counts as one when the prior's weight is set.
    fading : tuple of float, [rad/s or m/s]
        Stribeck velocities besides those of `stribeck_velocities`.
    stated : KeptLaws
        Of the file, which some choices keep.
    """

    table: ProblemTable
    preparation: PreparationTable
    folder: Path
    bodies: TorqueModel
    base: BaseParameters
    loaded: tuple[str, ...]
    sloped: tuple[str, ...]
    logs: tuple[SampledLog, ...]
    band: float
    thin: int
    sigma: Vector
    size: float
    fading: tuple[float, ...] = ()
    stated: KeptLaws = NOTHING


@dataclass(frozen=True, slots=True, eq=False)
class Evaluated:
    """A choice, fitted without each fold, and its errors on the folds left out."""

    choice: Choice
    fits: FoldFits
    errors: HeldOut

    @property
    def error(self) -> float:
        """Root-mean-square error on the blocks left out, over the joints' scales."""
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
    _masks: dict[tuple[float | None, float], Samples] = field(default_factory=dict)
    _factors: dict[tuple[object, ...], Factors] = field(default_factory=dict)
    _supersets: dict[JointWidths, Superset] = field(default_factory=dict)
    _columns: dict[tuple[object, ...], tuple[JointColumns, ...]] = field(
        default_factory=dict
    )
    _candidates: dict[Choice, CandidateModel] = field(default_factory=dict)
    _evaluated: dict[Choice, Evaluated] = field(default_factory=dict)

    @property
    def fits(self) -> int:
        """Constrained fits so far."""
        return len(self._evaluated) * len(folds())

    def rescaled(self, sigma: Vector, size: float) -> "Evaluator":
        """Return an evaluator of the same rows with other scales of errors."""
        setting = replace(self.setting, sigma=sigma, size=size)
        rows = self._samples, self._masks, self._factors, self._supersets
        return Evaluator(setting, *rows, self._columns, self._candidates)

    def with_friction(
        self, loaded: tuple[str, ...], sloped: tuple[str, ...], stated: KeptLaws
    ) -> "Evaluator":
        """Return an evaluator of the same rows with other load or position laws."""
        setting = replace(self.setting, loaded=loaded, sloped=sloped, stated=stated)
        return Evaluator(setting, self._samples, self._masks)

    def with_fading(self, velocities: tuple[float, ...]) -> "Evaluator":
        """Return an evaluator of the same rows that knows more Stribeck velocities."""
        setting = replace(self.setting, fading=velocities)
        rows = Evaluator(setting, self._samples, self._masks)
        return replace(rows, _candidates=self._candidates, _evaluated=self._evaluated)

    def expected(self, evaluated: Evaluated) -> float:
        """Return the torque error on left-out blocks over the torque, all joints."""
        joints = self.factors(evaluated.choice).joints
        torque = sum(np.sum(R[:, -1] ** 2) for joint in joints for R in joint.cells)
        squares = evaluated.errors.squares.sum(axis=0) @ self.setting.sigma**2
        return float(np.sqrt(squares / len(NUMBERS) / torque))

    def candidate(self, choice: Choice) -> CandidateModel:
        """Return a choice as a torque model with constraints."""
        s = self.setting
        # The preparation of rows is no part of the model.
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
        """Fit choices in parallel if the run has an executor, and keep the results."""
        executor = Executor.chosen(None)
        if executor is None:
            return
        s, tasks = self.setting, list[tuple[Choice, CandidateModel, Factors]]()
        for choice in choices:
            with suppress(ConsistentIdError):  # `evaluated` raises it again
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
        """Return a choice's errors with the bodies of another choice fixed."""
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
        widths = joint_widths(choice)
        key = (choice.motion_cutoff, choice.delay, widths, least_speed)
        if key not in self._factors:
            samples = self._masked(choice.motion_cutoff, least_speed)
            columns = self._columns_of(choice.motion_cutoff, widths, least_speed)
            self._factors[key] = factors_of(columns, samples.delayed(choice.delay))
        return self._factors[key]

    def _columns_of(
        self, cutoff: float | None, widths: JointWidths, least_speed: float | None
    ) -> tuple[JointColumns, ...]:
        """Return columns, the last ones of which are kept: several delays use them."""
        key = cutoff, widths, least_speed
        if key not in self._columns:
            s, every = self.setting, self._superset(widths)
            found = columns_of(
                s.bodies,
                self._masked(cutoff, least_speed),
                every.terms,
                every.couplings,
                widths=widths,
                band=s.band,
            )
            self._columns.clear()
            self._columns[key] = found
        return self._columns[key]

    def _masked(self, cutoff: float | None, least_speed: float | None) -> Samples:
        """Return the rows of motion with a cut-off that are fast enough."""
        if least_speed is None:
            return self.samples(cutoff)
        key = cutoff, least_speed
        if key not in self._masks:
            whole = self.samples(cutoff)
            self._masks[key] = whole.masked(self.setting.bodies, least_speed)
        return self._masks[key]

    def _superset(self, widths: JointWidths) -> Superset:
        if widths not in self._supersets:
            s = self.setting
            self._supersets[widths] = superset(
                s.bodies, widths, s.loaded, s.sloped, s.fading, s.stated
            )
        return self._supersets[widths]


@single_threaded
def _fitted_or_not(
    sigma: Vector, size: float, task: tuple[CandidateModel, Factors]
) -> Matrix | None:
    """Return a candidate's parameters without each fold; None if there is no fit."""
    try:
        return fitted(*task, sigma, size).parameters
    except ConsistentIdError:
        return None


def screened(
    candidate: CandidateModel, factors: Factors, current: FoldFits, sigma: Vector
) -> HeldOut:
    """Return errors of a candidate with the bodies of other fits.

    Parameters
    ----------
    factors : Factors
        Factors of the candidate's rows.
    current : FoldFits
        Fits whose bodies are used, fold by fold.
    sigma : ndarray, shape (torque joints,), [N m or N]
    """
    size = candidate.model.layout.inertial_size
    x = np.zeros((len(current.parameters), len(candidate.model.layout)))
    x[:, :size] = current.parameters[:, :size]
    for group in _groups(candidate, factors):
        joints = [factors.joints[j] for j in group]
        places = set().union(*(joint.places for joint in joints))
        keys = [i for i, key in enumerate(candidate.keys) if key in places]
        A, b = _left(candidate, joints, sigma[group], current.parameters, keys)
        x[:, [size + i for i in keys]] = _drive(A, b, candidate.nonnegative[keys])
    return held_out(FoldFits(candidate, x), factors, sigma)


def _groups(candidate: CandidateModel, factors: Factors) -> list[list[int]]:
    """Return the joints that share drive terms, by their places."""
    groups: list[list[int]] = []
    for j, joint in enumerate(factors.joints):
        own = {key for key in candidate.keys if key in joint.places}
        shared = [
            group
            for group in groups
            if any(own & factors.joints[i].places.keys() for i in group)
        ]
        merged = sorted({j, *(i for group in shared for i in group)})
        groups = [*(g for g in groups if g not in shared), merged]
    return groups


def _left(
    candidate: CandidateModel,
    joints: Sequence[JointFactors],
    sigma: Vector,
    bodies: Matrix,
    keys: Sequence[int],
) -> tuple[Array, Matrix]:
    """Return drive columns, and the torque less that of the bodies, for each fold."""
    size = candidate.model.layout.inertial_size
    columns, rest = [], []
    for joint, s in zip(joints, sigma, strict=True):
        R, kept = joint.training, len(joint.expand)
        places = [joint.places.get(candidate.keys[i], -1) for i in keys]
        A = R[:, :, places] * np.where(np.array(places) < 0, 0.0, 1.0 / s)
        own = bodies[:, :size] @ joint.expand.T
        left = R[:, :, -1] - (R[:, :, :kept] @ own[:, :, None])[:, :, 0]
        columns.append(A)
        rest.append(left / s)
    return np.concatenate(columns, axis=1), np.concatenate(rest, axis=1)


def _drive(A: Array, b: Matrix, nonnegative: BoolArray) -> Matrix:
    """Return least-squares solutions whose marked entries are zero or more.

    Parameters
    ----------
    A : ndarray, shape (folds, rows, columns)
    b : ndarray, shape (folds, rows)
    nonnegative : ndarray of bool, shape (columns,)
    """
    n = A.shape[2]
    norms = np.linalg.norm(A, axis=1)
    seen = norms > UNSEEN * np.linalg.norm(b, axis=1)[:, None]
    A, unit = A * seen[:, None], np.where(seen, norms, 1.0)
    both = np.concatenate([A / unit[:, None], b[:, :, None]], axis=2)
    R = np.asarray(np.linalg.qr(both, mode="r"))
    y = np.zeros((len(A), n))
    sizes = abs(np.diagonal(R[:, :n, :n], axis1=1, axis2=2))
    fine = sizes.min(axis=1, initial=1.0) > _RANK
    y[fine] = np.linalg.solve(R[fine, :n, :n], R[fine, :n, n:])[:, :, 0]
    wrong = np.flatnonzero(~fine | (y[:, nonnegative] < 0.0).any(axis=1))
    if not len(wrong):
        return y / unit
    from scipy.optimize import nnls  # its import takes longer than all else here

    free = np.flatnonzero(~nonnegative)
    for fold in wrong:
        columns = R[fold, :n, :n]
        z, _ = nnls(np.column_stack([columns, -columns[:, free]]), R[fold, :n, n])
        y[fold] = z[:n]
        y[fold, free] -= z[n:]
    return y / unit


def torque_delay(
    candidate: CandidateModel, factors: Factors, base: BaseParameters, sigma: Vector
) -> float:
    """Return the apparent delay of the torque [s], to first order.

    A torque that is late by ``d`` is ``tau - d dtau/dt``; ``d`` is one more unknown of
    least squares without constraints. Another unknown for each joint is a delay of its
    Coulomb friction alone, because bristles and teeth bend first where a joint turns
    back: a delay of all torque must show in the other terms, too.

    Parameters
    ----------
    base : BaseParameters
        Base parameters of the bodies.
    sigma : ndarray, shape (torque joints,), [N m or N]
    """
    rows, late = [], RATES[0]
    for place, (joint, s) in enumerate(zip(factors.joints, sigma, strict=True)):
        columns = (
            candidate_columns(candidate, joint, np.concatenate(joint.cells), base) / s
        )
        own = np.zeros((len(columns), len(factors.joints)))
        own[:, place] = columns[:, late]
        rows.append(np.column_stack([own, np.delete(columns, late, 1)]))
    R = triangle(np.asfortranarray(np.vstack(rows)))
    return -float(smallest_solution(R[:, :-1], R[:, -1], _RANK)[-1])


def fitting_delay(evaluator: Evaluator, current: Evaluated) -> float:
    """Return the delay [s] that leaves no apparent lag of the torque, to two digits."""
    setting, candidate = evaluator.setting, current.fits.candidate
    choice = current.choice
    for _ in range(_DELAYS):
        factors = evaluator.factors(choice)
        late = torque_delay(candidate, factors, setting.base, setting.sigma)
        delay = float(f"{choice.delay + late:.2g}")
        if delay == choice.delay:
            break
        choice = replace(choice, delay=delay)
    return choice.delay

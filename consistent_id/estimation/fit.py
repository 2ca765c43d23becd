"""The errors of an estimate on the torque that it was fitted to.

Everything is computed from the compressed regression alone, at the cost of a few small
factorisations.  On that motion, parameters that the data do not determine have no
effect on torque. On other motions they have, and a prior or a convention chose them:
see `guessed_share`.
"""

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, Self

import numpy as np

from consistent_id._support.arrays import (
    Array,
    Matrix,
    Vector,
    freeze_arrays,
)
from consistent_id.estimation.torque_error import holding, moving_shares
from consistent_id.regression.linear import (
    DATA_RANK_TOLERANCE,
    null_space,
    pulled_solution,
)
from consistent_id.regression.regression import Regression
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.residual_noise import UnconstrainedFit
from consistent_id.regression.row_structure import random_rows

_ALONE = ("misfit", "floor", "excess", "drive_share", "correlation", "spare", "guessed")
_PER_JOINT = tuple(
    "torque misfits shares slopes explained expected efforts moving holding".split()
)
_ROUNDING = 1e-10  # relative size of a column that drive terms explain up to rounding

ROW_MATTERS = 0.05
"""Torque relative to the strongest row of its unit, below which a row is left out."""


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """The errors of an estimate on its training data.

    Parameters
    ----------
    joints : tuple of str
    misfit : float
        RMS residual over RMS torque, all joints stacked.
    floor : float
        The same for least squares without constraints, with the same weights.
    excess : float
        Weighted residual over that of least squares without constraints, both per
        degree of freedom; NaN where there are no more rows than parameters.
    drive_share : float
        RMS torque of the estimated drive terms over RMS torque, all joints stacked;
        NaN for a model without drive terms.
    correlation : float
        Samples that carry the information of one independent sample; NaN where it is
        not known.
    spare : float
        Independent samples per parameter that the data determine; NaN likewise.
    guessed : float
        Largest share of a row's torque on other motions that the data do not determine;
        see `guessed_share`.
    torque : array_like, shape (joints,), [N m or N]
        RMS torque.
    misfits : array_like, shape (joints,)
        RMS residual over RMS torque of each joint.
    shares : array_like, shape (joints,)
        RMS torque of each joint over the largest of those that move alike (turn or
        slide).
    slopes : array_like, shape (joints,)
        Slope of the measured torque on that of the nominal bodies, with free drive
        terms: one, if the torque is the nominal robot's.  NaN without nominal bodies.
    explained : array_like, shape (joints,)
        Share of the torque beyond drive terms, squared, that the nominal bodies explain
        with this slope.
    expected : array_like, shape (joints,)
        Torque of the nominal bodies beyond drive terms, over the measured torque: the
        expected importance of the nominal bodies.
    efforts : array_like, shape (joints,)
        Largest torque over the joint's effort limit; zero where either is not known.
    moving : array_like, shape (joints,)
        Share of samples in which the joint moves, according to its Coulomb friction;
        NaN without it.
    holding : array_like, shape (joints,), [N m or N]
        Torque that friction can balance at rest; NaN where it is not known.
    """

    joints: tuple[str, ...]
    misfit: float
    floor: float
    excess: float
    drive_share: float
    correlation: float
    spare: float
    guessed: float
    torque: Vector
    misfits: Vector
    shares: Vector
    slopes: Vector
    explained: Vector
    expected: Vector
    efforts: Vector
    moving: Vector
    holding: Vector

    def __post_init__(self) -> None:
        freeze_arrays(
            self, dict.fromkeys(_PER_JOINT, (len(self.joints),)), "fit", finite=False
        )

    def to_dict(self) -> dict[str, Any]:
        """Return plain numbers, ready for JSON; unknown ones are None."""
        return {
            **{name: _number(getattr(self, name)) for name in _ALONE},
            "joints": {
                joint: {name: _number(getattr(self, name)[j]) for name in _PER_JOINT}
                for j, joint in enumerate(self.joints)
            },
        }

    @classmethod
    def from_dict(cls, record: dict[str, Any]) -> Self:
        """Read what `to_dict` wrote."""
        joints = record["joints"]
        alone: dict[str, Any] = {name: _known(record.get(name)) for name in _ALONE}
        of_joints: dict[str, Any] = {
            name: np.array([_known(joint.get(name)) for joint in joints.values()])
            for name in _PER_JOINT
        }
        return cls(joints=tuple(joints), **alone, **of_joints)


def fit_of(
    model: TorqueModel,
    free: UnconstrainedFit,
    x: Vector,
    *,
    known: Matrix | None = None,
) -> Fit:
    """Return the errors of parameters on a regression.

    Parameters
    ----------
    free : UnconstrainedFit
        Least squares on the regression, whose `sigma` affect only `Fit.excess`.
    x : ndarray, shape (parameters,)
    known : ndarray, shape (rows, parameters), optional
        Rows of the equalities that hold by assumption.
    """
    regression, rank = free.regression, free.solution.rank
    counts = np.array(regression.counts, dtype=np.float64)
    size = np.maximum(regression.torque_rms, np.finfo(float).tiny)
    drive = np.append(x, 0.0)
    drive[: model.layout.inertial_size] = 0.0
    of_drive = np.array(
        [np.linalg.norm(F @ drive) for F in regression.factors]
    ) / np.sqrt(counts)
    residual = regression.residual_rms(x)
    least = regression.residual_rms(free.parameters)
    has_drive = len(model.layout) > model.layout.inertial_size
    effective = np.nan if regression.noise is None else regression.effective.sum()
    moving = moving_shares(model, regression)
    held = holding(model, x, moving)

    def stacked(rms: Vector) -> float:
        return float(np.sqrt((counts * rms**2).sum() / (counts * size**2).sum()))

    return Fit(
        joints=regression.joints,
        misfit=stacked(residual),
        floor=stacked(least),
        excess=_excess(regression, residual, least, rank),
        drive_share=stacked(of_drive) if has_drive else np.nan,
        correlation=float(counts.sum() / effective),
        spare=float(effective / max(rank, 1)),
        guessed=guessed_share(
            model, free, x, np.zeros((0, len(x))) if known is None else known
        ),
        torque=size,
        misfits=residual / size,
        shares=_shares(model, size),
        **_on_nominal(model, regression),
        efforts=regression.peaks / _effort_limits(model),
        moving=moving,
        holding=held,
    )


def _excess(
    regression: Regression, residual: Vector, least: Vector, rank: int
) -> float:
    """Return the weighted residual over that of least squares, per degree of freedom.

    Least squares has ``rows - rank`` degrees of freedom; a robot that is known
    beforehand would have all rows.

    Parameters
    ----------
    residual, least : ndarray, shape (joints,), [N m or N]
        RMS residuals of the parameters and of least squares.
    """
    counts = np.array(regression.counts, dtype=np.float64)
    rows = counts.sum()
    if rows <= rank:
        return np.nan
    own, best = (
        np.linalg.norm(rms * np.sqrt(counts) / regression.sigma)
        for rms in (residual, least)
    )
    floor = max(float(best), float(np.finfo(float).tiny))
    return float(own / floor * np.sqrt(1.0 - rank / rows))


def _on_nominal(model: TorqueModel, regression: Regression) -> dict[str, Array]:
    """Return each joint's slope on the nominal torque, and the share it explains."""
    names = ("slopes", "explained", "expected")
    nominal, inertial = model.robot.nominal, model.layout.inertial_size
    if nominal is None:
        nothing = np.full(len(regression.joints), np.nan)
        return dict.fromkeys(names, nothing)
    found = []
    for F in regression.factors:
        both = np.column_stack([F[:, :inertial] @ np.ravel(nominal), F[:, -1]])
        drive = F[:, inertial:-1]
        norms = np.linalg.norm(drive, axis=0)
        # After filters, columns of a joint at rest are so small that their squares
        # vanish.
        moving = norms > _ROUNDING * norms.max(initial=0.0)
        if moving.any():
            unit = drive[:, moving] / norms[moving]
            both = both - unit @ np.linalg.lstsq(unit, both, rcond=None)[0]
        expected, beyond = np.linalg.norm(both, axis=0)
        product = float(both[:, 0] @ both[:, 1])
        if expected <= _ROUNDING * np.linalg.norm(F):
            found.append((np.nan, 0.0, 0.0))
            continue
        both_sizes = float(expected) * float(beyond)
        explained = product**2 / max(both_sizes**2, 1e-300)
        size = max(float(np.linalg.norm(F[:, -1])), 1e-300)
        found.append((product / expected**2, explained, expected / size))
    return dict(zip(names, np.array(found).T, strict=True))


def _shares(model: TorqueModel, torque: Vector) -> Vector:
    """Return each row's torque over the largest of its unit; zero if all are zero."""
    shares = np.zeros(len(torque))
    for kind in (model.forces, ~model.forces):
        largest = torque[kind].max(initial=0.0)
        if largest > 0.0:
            shares[kind] = torque[kind] / largest
    return shares


def _effort_limits(model: TorqueModel) -> Vector:
    """Return effort limits, [N m or N]; infinite where they are not known."""
    limits = {joint.name: joint.limits.effort for joint in model.robot.joints}
    known = np.array([limits.get(name, np.inf) for name in model.torque_joints])
    return np.where(known > 0.0, known, np.inf)


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _known(value: float | None) -> float:
    return np.nan if value is None else float(value)


def guessed_share(
    model: TorqueModel, free: UnconstrainedFit, x: Vector, known: Matrix
) -> float:
    """Return the share of torque that the data do not determine, on random motions.

    The prior of each parameter has a standard deviation that causes as much torque as
    the typical parameter of `x`. The weight that this prior keeps beside data and
    equalities is the prior-dominated share of ``x``: one for unidentifiable parameters,
    zero for well determined ones.  The function returns the torque of this share over
    the whole torque, for the row with the largest ratio. If the base floats, its rows
    are included: all bodies move.

    Parameters
    ----------
    free : UnconstrainedFit
        Least squares on the data.
    x : ndarray, shape (parameters,)
    known : ndarray, shape (rows, parameters)
        Rows of the equalities that hold by assumption.

    Returns
    -------
    float
        NaN for a model that cannot move, because its rows were given.
    """
    if not model.robot.connected:
        return np.nan
    every = _with_all_rows(model) if model.robot.floating else model
    rows = random_rows(every)
    unit = 1.0 / np.where(rows.norms > 0.0, rows.norms, 1.0)
    u = x / unit  # torque of each parameter on other motions
    noise, open_steps = free.noise, null_space(known * unit, DATA_RANK_TOLERANCE)
    seen = noise.coordinates @ free.base.projection * unit @ open_steps
    scaled = np.linalg.solve(noise.root.T, seen)  # in standard errors
    prior = 1.0 / max(float(np.mean(u**2)), np.finfo(float).tiny)
    left = pulled_solution(np.asarray(scaled), open_steps.T @ u, prior)
    guess = unit * (open_steps @ left)
    torque, guessed = rows.rms(x), rows.rms(guess)
    matters = (torque > 0.0) & (_shares(every, torque) >= ROW_MATTERS)
    share = guessed[matters] / torque[matters]
    return float(min(share.max(initial=0.0), 1.0))


@lru_cache(maxsize=16)
def _with_all_rows(model: TorqueModel) -> TorqueModel:
    every = replace(model, torque_joints=())
    return model if model.torque_joints == every.torque_joints else every

"""The errors of an estimate on the torque that it was fitted to.

Everything is computed from the compressed regression alone, at the cost of a few small
factorisations.  On that motion, parameters that the data do not determine have no
effect on torque. On other motions they have, and a prior or a convention chose them.
`guessed_share` is the share of such torque, whatever the prior.  `prior_errors` is its
error, if the prior's bodies are those of a model whose bodies agree with the data.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, Self

import numpy as np

from consistent_id._support.arrays import (
    Array,
    BoolArray,
    Matrix,
    Vector,
    freeze_arrays,
)
from consistent_id._support.tables import brief
from consistent_id.estimation.torque_error import holding, moving_shares, slopes_on
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals.masks import standstill
from consistent_id.regression.linear import (
    DATA_RANK_TOLERANCE,
    null_space,
    pulled_solution,
)
from consistent_id.regression.regression import Regression
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.residual_noise import UnconstrainedFit
from consistent_id.regression.row_structure import RandomRows, random_rows
from consistent_id.robot.scaling import (
    USUAL_WIDTHS,
    link_scales,
    placeholders,
    reference_bodies,
)

ROW_MATTERS = 0.05
"""Torque relative to the strongest row of its unit, below which a row is left out."""


AGREES = 1.5
"""Distance of nominal bodies from the data, in usual errors, up to which they agree."""

TOGETHER = 0.08
"""Error of all rows' torque over that torque, beyond which the prior is not good."""


def torque_shares(model: TorqueModel, torque: Vector) -> Vector:
    """Return each row's torque over the largest of its unit; zero if all are zero."""
    shares = np.zeros(len(torque))
    for kind in (model.forces, ~model.forces):
        largest = torque[kind].max(initial=0.0)
        if largest > 0.0:
            shares[kind] = torque[kind] / largest
    return shares


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
    matters = (torque > 0.0) & (torque_shares(every, torque) >= ROW_MATTERS)
    share = guessed[matters] / torque[matters]
    return float(min(share.max(initial=0.0), 1.0))


def prior_errors(
    model: TorqueModel, free: UnconstrainedFit, x: Vector, known: Matrix
) -> Vector:
    """Return the error of each row's torque on random motions that the prior causes.

    With ``w`` the standard deviation of the prior of each parameter, ``A`` the data and
    ``1`` the noise, the estimate keeps ``K = (w A^T A w + 1)^-1`` of the prior's error:
    the covariance of the parameters due to it is ``w K K^T w``.  Nominal bodies have
    their usual errors, `USUAL_WIDTHS`.  If they are farther from the data than that,
    all are multiplied by the root of the ratio of squares.  Drive terms have a prior as
    wide as in `guessed_share`.

    Parameters
    ----------
    free : UnconstrainedFit
        Least squares on the data.
    x : ndarray, shape (parameters,)
        The estimate, whose prior pulls bodies to nominal ones.
    known : ndarray, shape (rows, parameters)
        Rows of the equalities that hold by assumption.

    Returns
    -------
    ndarray, shape (torque joints,)
        Standard deviations over the torque of `x`; zero for rows that make little of
        it.  NaN where nominal bodies are not known, are placeholders or farther from
        the data than `AGREES`, the base floats, or all rows together exceed `TOGETHER`.
    """
    robot = model.robot
    unknown = np.full(len(model.torque_joints), np.nan)
    if robot.nominal is None or placeholders(robot):
        return unknown
    if robot.floating or not robot.connected:
        return unknown
    usual, nominal = link_scales(robot).widths(USUAL_WIDTHS), reference_bodies(robot)
    rows, size = random_rows(model), model.layout.inertial_size
    width = _typical_widths(rows, x)
    width[:size] = usual
    distance = _distance(free, nominal, width)
    if not distance <= AGREES:
        return unknown
    width[:size] *= distance
    open_steps = null_space(known * width, DATA_RANK_TOLERANCE)
    seen = _in_errors(free, width[:, None] * open_steps)
    kept = np.linalg.inv(seen.T @ seen + np.eye(open_steps.shape[1]))
    wrong = width[:, None] * (open_steps @ kept)
    squares = np.sum([rows.rms(column) ** 2 for column in wrong.T], axis=0)
    torque = rows.rms(x)
    matters = (torque > 0.0) & (torque_shares(model, torque) >= ROW_MATTERS)
    if np.sqrt(squares.sum()) > TOGETHER * np.linalg.norm(torque):
        return unknown
    ratio = np.sqrt(squares) / np.where(matters, torque, 1.0)
    return np.asarray(np.where(matters, ratio, 0.0))


def _typical_widths(rows: RandomRows, x: Vector) -> Vector:
    """Return the sizes at which each parameter makes as much torque as the typical."""
    unit = 1.0 / np.where(rows.norms > 0.0, rows.norms, 1.0)
    return np.asarray(unit * max(float(np.sqrt(np.mean((x / unit) ** 2))), 1e-300))


def _in_errors(free: UnconstrainedFit, changes: Matrix) -> Matrix:
    """Return changes of the parameters in standard errors of the data."""
    noise = free.noise
    y = noise.coordinates @ free.base.projection @ changes
    return np.asarray(np.linalg.solve(noise.root.T, y))


def _distance(free: UnconstrainedFit, bodies: Matrix, width: Vector) -> float:
    """Return the distance of nominal bodies from the data, in widths; at least one.

    The root mean square over the base parameters of bodies, with all drive terms free.
    """
    noise, size = free.noise, bodies.size
    nominal = np.zeros(len(width))
    nominal[:size] = bodies.ravel()
    y = noise.coordinates @ (free.solution.x - free.base.projection @ nominal)
    M = noise.coordinates @ free.base.projection * width
    L = np.linalg.cholesky(noise.scatter)
    y, M = np.linalg.solve(L, y), np.linalg.solve(L, M)
    others = null_space(M[:, size:].T, DATA_RANK_TOLERANCE)
    M, y = others.T @ M[:, :size], others.T @ y
    squares = float(y @ np.linalg.solve(M @ M.T + np.eye(len(y)), y))
    of_bodies = sum(k < size for k in free.base.independent)
    return float(np.sqrt(max(squares / of_bodies, 1.0)))


@lru_cache(maxsize=16)
def _with_all_rows(model: TorqueModel) -> TorqueModel:
    every = replace(model, torque_joints=())
    return model if model.torque_joints == every.torque_joints else every


_ALONE = tuple(
    "misfit floor excess drive_share friction_share correlation spare guessed".split()
)
_PER_JOINT = tuple(
    "torque misfits shares slopes explained expected efforts moving holding "
    "prior_errors".split()
)

_USUAL = 0.99  # quantile of the torque that is compared with effort limits
_ENOUGH = 300  # samples in motion, of which three outliers are less than the rest


@brief
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
    friction_share : float
        The same of its friction terms alone; NaN for a model without any.
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
    prior_errors : array_like, shape (joints,)
        Error of each row's torque on other motions that the prior causes, over that
        torque; NaN where the prior is not known to be good.  See `prior_errors`.
    """

    joints: tuple[str, ...]
    misfit: float
    floor: float
    excess: float
    drive_share: float
    friction_share: float
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
    prior_errors: Vector

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
    pulled: bool = False,
) -> Fit:
    """Return the errors of parameters on a regression.

    Parameters
    ----------
    free : UnconstrainedFit
        Least squares on the regression, whose `sigma` affect only `Fit.excess`.
    x : ndarray, shape (parameters,)
    known : ndarray, shape (rows, parameters), optional
        Rows of the equalities that hold by assumption.
    pulled : bool
        Whether a prior pulls the bodies to nominal ones.
    """
    regression, rank = free.regression, free.solution.rank
    counts = np.array(regression.counts, dtype=np.float64)
    size = np.maximum(regression.torque_rms, np.finfo(float).tiny)
    of_drives = np.arange(len(x)) >= model.layout.inertial_size
    rubs = _friction_columns(model)
    residual = regression.residual_rms(x)
    least = regression.residual_rms(free.parameters)
    effective = np.nan if regression.noise is None else regression.effective.sum()

    def stacked(rms: Vector) -> float:
        return float(np.sqrt((counts * rms**2).sum() / (counts * size**2).sum()))

    def share(columns: BoolArray) -> float:
        part = np.append(np.where(columns, x, 0.0), 0.0)
        rms = [np.linalg.norm(F @ part) for F in regression.factors] / np.sqrt(counts)
        return stacked(rms) if columns.any() else np.nan

    equalities = np.zeros((0, len(x))) if known is None else known
    guessed = guessed_share(model, free, x, equalities)
    by_prior = np.full(len(size), np.nan)
    if pulled:
        by_prior = prior_errors(model, free, x, equalities)
    shares, efforts = torque_shares(model, size), _effort_limits(model)
    of_nominal = _on_nominal(model, regression)
    moving = moving_shares(model, regression)
    return Fit(
        joints=regression.joints,
        misfit=stacked(residual),
        floor=stacked(least),
        excess=_excess(regression, residual, least, rank),
        drive_share=share(of_drives),
        friction_share=share(rubs),
        correlation=float(counts.sum() / effective),
        spare=float(effective / max(rank, 1)),
        guessed=guessed,
        torque=size,
        misfits=residual / size,
        shares=shares,
        **of_nominal,
        efforts=regression.peaks / efforts,
        moving=moving,
        holding=holding(model, x, moving),
        prior_errors=by_prior,
    )


def _friction_columns(model: TorqueModel) -> BoolArray:
    """Return which parameters are coefficients of friction, shape (parameters,)."""
    terms = model.column_terms  # none of a sensor's offsets
    start, rubs = model.layout.inertial_size, np.zeros(len(model.layout), np.bool_)
    rubs[start : start + len(terms)] = [t.friction and t.nonnegative for t in terms]
    return rubs


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
    nominal = model.robot.nominal
    if nominal is None:
        nothing = np.full(len(regression.joints), np.nan)
        return dict.fromkeys(("slopes", "explained", "expected"), nothing)
    found = slopes_on(model, regression, np.ravel(nominal))
    return {
        "slopes": found.slopes,
        "explained": found.explained,
        "expected": found.expected,
    }


def usual_efforts(model: TorqueModel, recordings: Sequence[Recording]) -> Vector | None:
    """Return the torque that 99 % of a joint's samples do not exceed, over its limit.

    A few outliers do not change it; a wrong gain or limit does.  It is the larger of
    those of all samples and of samples in motion: long rests do not hide it.

    Parameters
    ----------
    recordings : sequence of Recording
        With the torque of the model's joints.

    Returns
    -------
    ndarray, shape (joints,), or None
        None where no recording has all torques.
    """
    logs = [
        log.of(model.torque_joints)
        for log in recordings
        if log.torque is not None and set(model.torque_joints) <= set(log.joints)
    ]
    if not logs:
        return None
    torque = np.concatenate([abs(np.asarray(log.torque)) for log in logs])
    rows = [log.torque_known for log in logs]
    known = np.concatenate(
        [
            np.ones(log.position.shape, dtype=np.bool_) if own is None else own
            for log, own in zip(logs, rows, strict=True)
        ]
    )
    if not known.any(axis=0).all():
        return None
    moving = np.concatenate([_moving(log) for log in logs])
    columns = zip(torque.T, known.T, moving.T, strict=True)
    usual = [_usual(tau[seen], moves[seen]) for tau, seen, moves in columns]
    return np.asarray(np.array(usual) / _effort_limits(model))


def _usual(torque: Vector, moves: BoolArray) -> float:
    """Return the torque that 99 % of samples do not exceed, nor of those in motion."""
    parts = [torque] if moves.sum() < _ENOUGH else [torque, torque[moves]]
    return max(float(np.quantile(part, _USUAL)) for part in parts)


def _moving(log: Recording) -> BoolArray:
    """Return where each joint moves beside its own top speed, (samples, joints)."""
    still = [standstill(log.of([name])) for name in log.joints]
    return ~np.concatenate(still, axis=1)


def _effort_limits(model: TorqueModel) -> Vector:
    """Return effort limits, [N m or N]; infinite where they are not known."""
    limits = {joint.name: joint.limits.effort for joint in model.robot.joints}
    known = np.array([limits.get(name, np.inf) for name in model.torque_joints])
    return np.where(known > 0.0, known, np.inf)


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _known(value: float | None) -> float:
    return np.nan if value is None else float(value)

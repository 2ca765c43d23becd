"""The errors of an estimate on the torque that it was fitted to.

Everything is computed from the compressed regression alone, at the cost of a few small
factorisations.  On that motion, parameters that the data do not determine have no
effect on torque. On other motions they have, and a prior or a convention chose them:
see `guessed_share`.
"""

from collections.abc import Sequence
from dataclasses import dataclass
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
from consistent_id.estimation.body_slopes import slopes_on
from consistent_id.estimation.prior_share import (
    guessed_share,
    prior_errors,
    torque_shares,
)
from consistent_id.estimation.torque_error import holding, moving_shares
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals.masks import standstill
from consistent_id.regression.regression import Regression
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.residual_noise import UnconstrainedFit

_ALONE = ("misfit", "floor", "excess", "drive_share", "correlation", "spare", "guessed")
_PER_JOINT = tuple(
    "torque misfits shares slopes explained expected efforts moving holding "
    "prior_errors".split()
)

_USUAL = 0.99  # quantile of the torque that is held against effort limits
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

    equalities = np.zeros((0, len(x))) if known is None else known
    return Fit(
        joints=regression.joints,
        misfit=stacked(residual),
        floor=stacked(least),
        excess=_excess(regression, residual, least, rank),
        drive_share=stacked(of_drive) if has_drive else np.nan,
        correlation=float(counts.sum() / effective),
        spare=float(effective / max(rank, 1)),
        guessed=guessed_share(model, free, x, equalities),
        torque=size,
        misfits=residual / size,
        shares=torque_shares(model, size),
        **_on_nominal(model, regression),
        efforts=regression.peaks / _effort_limits(model),
        moving=moving,
        holding=held,
        prior_errors=prior_errors(model, free, x, equalities)
        if pulled
        else np.full(len(size), np.nan),
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

"""Delay, scale and encoder bias of PD drives, estimated with the parameters of the fit.

The torque is linear in the model's parameters, but not in errors of drives and
encoders.  So these are found by Gauss-Newton steps, in each of which the parameters are
solved for (variable projection): ``tau = Y x + C e``, where the columns ``C`` are the
effect of a small change ``e`` of the calibration on both sides.  A prior keeps the
calibration within realistic values.

`command_delay` finds the delay alone.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from consistent_id._support.arrays import (
    BoolArray,
    Matrix,
    Vector,
    freeze_arrays,
)
from consistent_id._support.executors import single_threaded
from consistent_id._support.singular import pinv, svd
from consistent_id._support.tables import Table, brief
from consistent_id.constraints import Constraint
from consistent_id.errors import ProblemError
from consistent_id.estimation.determination import FreeParameters, least_squares
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals.drive_torque import DriveCalibration
from consistent_id.regression.correlated_noise import SHOWN, spectral_errors
from consistent_id.regression.linear import extended
from consistent_id.regression.motion_arrays import Motion
from consistent_id.regression.recorded_motion import motion_of
from consistent_id.regression.regression import Regression, build_regression
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.residual_noise import joint_noise

UNKNOWNS = ("delay", "scale", "encoder_bias")
"""Parts of a calibration that a fit may estimate."""

_STEPS = 8  # Gauss-Newton steps; after the first, errors are a few per cent
_SETTLED = 0.05  # of a standard error: a smaller step is the last
LATER = 1e-4  # s, by which commands are delayed to compute the effect of a delay
_TURNED = 1e-5  # rad or m, by which joints are moved to compute the effect of a bias

DELAY_SPREAD = 0.03
"""Prior standard deviation of the delay [s]: six periods of 200 Hz."""

SCALE_SPREAD = 0.1
"""The same for torque scales: motor constants and gears are within ten per cent."""

BIAS_SPREAD = 0.05, 0.005
"""The same for encoder biases [rad], [m]: joints are zeroed to a few degrees."""

_LITTLE = 0.5
"""Singular value of the data's rows, relative to the prior, below which a change is not
identifiable: the data add less than a quarter of the prior's information.
"""

_PART = 0.3  # share of a direction's largest entry from which another is part of it


@brief
@dataclass(frozen=True, slots=True, eq=False)
class CalibrationFit:
    """A calibration, and its standard errors.

    Parameters
    ----------
    joints : tuple of str
    found : tuple of str
        The parts of `UNKNOWNS` that were estimated.
    values : array_like, shape (1 + 2 joints,)
        Delay [s], each joint's scale, each joint's encoder bias [rad or m].
    standard_errors : array_like, shape (1 + 2 joints,)
        For noise as correlated as the residuals, with the prior; zero for parts that
        were not estimated.
    unknown : array_like, shape (directions, 1 + 2 joints)
        Changes of the calibration that are not identifiable; they stay near their
        stated values.
    """

    joints: tuple[str, ...]
    found: tuple[str, ...]
    values: Vector
    standard_errors: Vector
    unknown: Matrix

    def __post_init__(self) -> None:
        shape = (1 + 2 * len(self.joints),)
        shapes = {"values": shape, "standard_errors": shape, "unknown": (None, *shape)}
        freeze_arrays(self, shapes, "drive calibration")

    @property
    def calibration(self) -> DriveCalibration:
        """The calibration as a value."""
        return _calibration(self.values)

    @property
    def delay_error(self) -> float:
        """The delay's standard error [s]."""
        return float(self.standard_errors[0])

    @property
    def known(self) -> BoolArray:
        """Whether the data determine each value by itself."""
        part = _PART * abs(self.unknown).max(axis=1, initial=0.0, keepdims=True)
        return np.asarray(~(abs(self.unknown) > part).any(axis=0))

    def table(self) -> Table:
        """Return the calibration with its standard errors, for people."""
        n = len(self.joints)
        titles = {"scale": "torque scale", "encoder_bias": "encoder bias [mrad, mm]"}
        shown = [(name, i) for i, name in enumerate(UNKNOWNS[1:]) if name in self.found]
        units = {"scale": 1.0, "encoder_bias": 1e3}
        rows = [
            (joint, *(self._cell(1 + i * n + j, units[name]) for name, i in shown))
            for j, joint in enumerate(self.joints)
        ]
        title = "Drives and encoders"
        if "delay" in self.found:
            title += f"; commands are late by {self._cell(0, 1e3)} ms"
        notes = [
            "+- 1 standard error, for this model of bodies and friction: a "
            "calibration may compensate for errors of the model. Rollouts show "
            "whether it does"
        ]
        if not self.known.all():
            notes.append(
                "not known: the parameters of the fit explain it as well, or it "
                "together with another; such are near where they were stated. Known "
                'bodies (bodies = "model") determine more'
            )
        if "encoder_bias" in self.found:
            notes.append(
                "the bias is identified from gravity torque. A bias between command "
                "and reading acts like a torque offset of kp times the bias; with "
                "one set of gains they cannot be separated"
            )
        return Table(
            title,
            ("joint", *(titles[name] for name, _ in shown)) if shown else (),
            tuple(rows) if shown else (),
            tuple(notes),
        )

    def _cell(self, place: int, unit: float) -> str:
        value, error = unit * self.values[place], unit * self.standard_errors[place]
        return f"{value:.3f} +- {error:.3f}" if self.known[place] else "not known"


@single_threaded
def fit_calibration(
    model: TorqueModel,
    recordings: Callable[[DriveCalibration], Sequence[Recording]],
    found: Sequence[str] = UNKNOWNS,
    *,
    start: DriveCalibration | None = None,
    constraints: Sequence[Constraint] = (),
) -> CalibrationFit:
    """Estimate errors of drives and encoders.

    Parameters
    ----------
    model : TorqueModel
    recordings : callable
        Function from a calibration to prepared recordings, always of the same samples;
        see `calibrated`.
    found : sequence of str
        Some of `UNKNOWNS`.
    start : DriveCalibration, optional
        Start of the search, and values of the parts that are not estimated.
    constraints : sequence of Constraint
        Only their equalities are used, such as known bodies and equal motors.

    Raises
    ------
    ProblemError
        If `found` names something else.
    RecordingError
        If the recordings cannot be used.
    """
    for name in found:
        if name not in UNKNOWNS:
            known = ", ".join(UNKNOWNS)
            raise ProblemError(f"no {name!r} in a drive calibration, expected {known}")
    n = len(model.robot)
    given = (DriveCalibration() if start is None else start).of(n)
    values = np.concatenate([[given.delay], given.scale, given.encoder_bias])
    wanted = np.repeat([name in found for name in UNKNOWNS], [1, n, n])
    search = _CalibrationSearch(
        model,
        recordings,
        wanted,
        values,
        _spread(model),
        FreeParameters.of(constraints, model),
    )
    for _ in range(_STEPS):
        found_here = search.step(values)
        change, values = abs(found_here.values - values), found_here.values
        if (change <= _SETTLED * found_here.standard_errors).all():
            break
    last = found_here._replace(standard_errors=search.errors(values))
    return CalibrationFit(model.robot.joint_names, tuple(found), *last)


class _CalibrationStep(NamedTuple):
    values: Vector
    standard_errors: Vector
    unknown: Matrix


def _spread(model: TorqueModel) -> Vector:
    """Return the prior standard deviations."""
    slides = np.array([joint.kind == "prismatic" for joint in model.robot.driven])
    bias = np.where(slides, BIAS_SPREAD[1], BIAS_SPREAD[0])
    return np.concatenate([[DELAY_SPREAD], np.full(len(bias), SCALE_SPREAD), bias])


def _calibration(values: Vector) -> DriveCalibration:
    scale, bias = np.split(values[1:], 2)
    return DriveCalibration(float(values[0]), scale, bias)


@dataclass(frozen=True, slots=True, eq=False)
class _CalibrationSearch:
    """The state at the beginning of a step.

    Changes of scales are relative, so that scales stay positive.
    """

    model: TorqueModel
    recordings: Callable[[DriveCalibration], Sequence[Recording]]
    wanted: BoolArray
    stated: Vector
    spread: Vector
    free: FreeParameters

    def step(self, values: Vector) -> _CalibrationStep:
        """Return better values, their standard errors, and unidentifiable changes."""
        rows, width = self._compressed(values)
        wanted, scale = self.wanted, _is_scale(self.wanted)
        away = values - self.stated
        away[scale] = np.log(values[scale] / self.stated[scale])
        # Rows below those of the model's parameters contain the calibration alone; in
        # units of the prior's standard deviations, the prior is a unit row each.
        spread, n = self.spread[wanted], int(wanted.sum())
        seen, rest = rows[width:, width:-1] * spread, rows[width:, -1]
        A = np.vstack([seen, np.eye(n)])
        inverse = pinv(A)
        change, errors = np.zeros(len(values)), np.zeros(len(values))
        change[wanted] = spread * (inverse @ np.append(rest, -(away[wanted] / spread)))
        errors[wanted] = spread * np.linalg.norm(inverse, axis=1)
        moved = values + change
        moved[scale] = values[scale] * np.exp(change[scale])
        moved[0] = max(moved[0], 0.0)
        _, s, Vt = svd(seen)
        hidden = Vt[np.append(s, np.zeros(n - len(s))) < _LITTLE]
        unknown = np.zeros((len(hidden), len(values)))
        unknown[:, wanted] = hidden
        return _CalibrationStep(moved, errors * np.where(scale, moved, 1.0), unknown)

    def errors(self, values: Vector) -> Vector:
        """Return standard errors, noise being as correlated as the residuals are."""
        here, sigma, free, x = self._fitted(values)
        parts, count, total = [], 0, 0
        for one, other in self._motions(values, here):
            first = max(len(one.q) - SHOWN, 0) // 2
            shown, late = (m.samples(first, first + SHOWN) for m in (one, other))
            count, total = count + len(shown.q), total + len(one.q)
            pieces = self._rows(shown, late, free, x)
            parts += [
                np.vstack(own) / s
                for own, s in zip(zip(*pieces, strict=True), sigma, strict=True)
            ]
        width, wanted = free.directions.shape[1], self.wanted
        n = int(wanted.sum())
        # What is not shown is like what is: the prior is as much weaker beside it.
        prior = np.zeros((n, width + n + 1))
        prior[:, width:-1] = np.diag(np.sqrt(count / total) / self.spread[wanted])
        found = spectral_errors(parts, prior)[width:] * np.sqrt(count / total)
        errors = np.zeros(len(values))
        errors[wanted] = found
        return errors * np.where(_is_scale(wanted), values, 1.0)

    def _compressed(self, values: Vector) -> tuple[Matrix, int]:
        """Return the triangle of all rows ``[Y, C, tau]``, and the width of ``Y``.

        Rows are divided by their noise.
        """
        here, sigma, free, x = self._fitted(values)
        width = free.directions.shape[1]
        R = np.zeros((0, width + int(self.wanted.sum()) + 1))
        for one, other in self._motions(values, here):
            for rows in self._rows(one, other, free, x):
                for j, s in enumerate(sigma):
                    R = extended(R, np.asfortranarray(rows[j] / s))
        return R, width

    def _fitted(
        self, values: Vector
    ) -> tuple[Sequence[Recording], Vector, FreeParameters, Vector]:
        """Return recordings, noise of joints, free parameters, and those that fit."""
        here = self.recordings(_calibration(values))
        regression = build_regression(self.model, here)
        sigma = joint_noise(self.model, regression) * np.sqrt(regression.correlation)
        free = self.free.determined(regression.weighted(sigma))
        return here, sigma, free, _fitted(regression.weighted(sigma), free)

    def _motions(
        self, values: Vector, here: Sequence[Recording]
    ) -> Iterator[tuple[Motion, Motion]]:
        """Yield rows of each recording, and those with commands a little later."""
        later = values + np.r_[LATER, np.zeros(len(values) - 1)]
        after = self.recordings(_calibration(later)) if self.wanted[0] else here
        for one, other in zip(here, after, strict=True):
            yield motion_of(self.model, one, None), motion_of(self.model, other, None)

    def _rows(
        self, whole: Motion, late: Motion, free: FreeParameters, x: Vector
    ) -> Iterator[list[Matrix]]:
        """Yield, piece by piece, the rows ``[Y, C, tau]`` of each torque joint."""
        model, wanted = self.model, self.wanted
        n = len(model.robot)
        for moved, delayed in zip(whole.pieces(), late.pieces(), strict=True):
            along = moved.along
            state = along.q, along.dq, along.ddq
            Y = moved.regressor(model)
            torque = np.einsum("jps,p->sj", Y, x)
            C = np.zeros((*torque.shape, 1 + 2 * n))
            if wanted[0]:
                C[:, :, 0] = (moved.torque - delayed.torque) / LATER
            for j, joint in enumerate(model.robot.joint_names):
                if wanted[1 + j] and joint in model.torque_joints:
                    row = model.torque_joints.index(joint)
                    C[:, row, 1 + j] = -torque[:, row]
                if wanted[1 + n + j]:
                    C[:, :, 1 + n + j] = -moved.through(_turned(model, x, state, j))
            yield [
                np.column_stack(
                    [
                        Y[row].T @ free.directions,
                        C[:, row][:, wanted],
                        moved.torque[:, row] - Y[row].T @ free.start,
                    ]
                )
                for row in range(len(model.torque_joints))
            ]


def _is_scale(values: BoolArray) -> BoolArray:
    n = (len(values) - 1) // 2
    return np.array([False] + n * [True] + n * [False])


def _fitted(regression: Regression, free: FreeParameters) -> Vector:
    stacked = regression.stacked()
    y = least_squares(*free.reduced(stacked[:, :-1], stacked[:, -1]))
    return np.asarray(free.start + free.directions @ y)


def _turned(
    model: TorqueModel, x: Vector, state: tuple[Matrix, Matrix, Matrix], joint: int
) -> Matrix:
    """Return the derivative of torques by the position of one joint."""
    q, dq, ddq = state
    change = np.zeros(q.shape[1])
    change[joint] = _TURNED
    both = (model.predict(x, q + sign * change, dq, ddq) for sign in (1.0, -1.0))
    ahead, behind = both
    return np.asarray((ahead - behind) / (2.0 * _TURNED))

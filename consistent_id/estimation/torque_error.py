"""How torque differs from that of a model, or of given bodies, joint by joint.

Errors of predicted torque are computed with and without the part that dry friction
balances: that of a joint at rest balances it, up to its breakaway torque.  A model with
Coulomb friction predicts zero there, so a residual contradicts the model only beyond
the breakaway torque.  Slopes compare the torque with that of given bodies.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from consistent_id._support.arrays import (
    Array,
    Matrix,
    Vector,
    array_default,
    freeze_arrays,
)
from consistent_id._support.singular import lstsq
from consistent_id.errors import ProblemError
from consistent_id.recordings.recording import Recording
from consistent_id.regression import torque_along
from consistent_id.regression.drive.laws import AsymmetricCoulomb, Coulomb
from consistent_id.regression.drive.term import DriveTerm, JointSamples
from consistent_id.regression.motion_arrays import Motion
from consistent_id.regression.recorded_motion import motion_of
from consistent_id.regression.regression import Regression, build_regression
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.rows.contact_maps import unknown_rows

AT_REST = 0.05
"""Share of samples in motion below which a joint's friction is hardly identifiable:
three seconds of a minute.
"""

IN_MOTION = 0.5
"""Share of samples in motion above which rests are few and have little effect."""

BREAKAWAY = 0.25
"""Largest friction over a drive's effort limit: a drive with more friction is a poor
one.  It is used where the data do not determine the friction.
"""

_ROUNDING = 1e-10  # relative size of a column that drive terms explain up to rounding
_DRY = (Coulomb, AsymmetricCoulomb)
_AT_EASE = float(np.tanh(1.0))  # of the direction, below which a joint may be at rest


@dataclass(frozen=True, slots=True, eq=False)
class TorqueError:
    """Prediction error of one estimate on one recording.

    Parameters
    ----------
    rms : ndarray, shape (torque joints,), [N m or N]
        Root of the mean squared error.
    relative : ndarray, shape (torque joints,)
        RMS error over RMS torque.
    torque : ndarray, shape (torque joints,), [N m or N]
        RMS torque.
    stacked : float
        ``||tau - prediction|| / ||tau||`` over all joints; where some turn and others
        slide, the root mean square of the errors of both kinds, since N m and N cannot
        be added.
    beyond : ndarray, shape (torque joints,), [N m or N]
        Root of the mean squared error beyond the torque that friction can balance at
        rest; see `beyond_friction`.
    stacked_beyond : float
        ``stacked`` for this error.
    band : float, optional, [Hz]
        Cut-off of the filter that measured and predicted torque have passed; None if
        they are not filtered.
    """

    recording: str
    rms: Vector
    relative: Vector
    torque: Vector
    stacked: float
    beyond: Vector
    stacked_beyond: float
    band: float | None = None

    @property
    def mse(self) -> Vector:
        """Mean squared error of each joint, [(N m)^2 or N^2]."""
        return self.rms**2


def measured_torque(model: TorqueModel, recording: Recording) -> Array | None:
    """Return the torque of a recording in the model's order, NaN where not known.

    Returns
    -------
    ndarray, shape (samples, torque joints), [N m or N], or None
        None if the recording has no torque.
    """
    if recording.torque_filter is not None:  # its rows are not those of every sample
        measured = torque_along.measured_torque(model, recording)
        unknown = unknown_rows(model, recording)
        return measured if unknown is None else np.where(unknown, np.nan, measured)
    if not model.robot.floating and recording.of(model.torque_joints).torque is None:
        return None
    motion = motion_of(model, recording, None)
    if motion.weights is None:
        return motion.torque
    return np.where(motion.weights > 0.0, motion.torque, np.nan)


def prediction_errors(
    model: TorqueModel,
    predictions: Iterable[tuple[Vector, Vector | None]],
    recording: Recording,
) -> list[TorqueError]:
    """Return the error of each vector of parameters of a model along a recording.

    Parameters
    ----------
    predictions : iterable of (ndarray, ndarray or None)
        Parameters, shape (parameters,), and the torque that friction can hold at rest,
        shape (torque joints,), from `holding`; None counts as zero.

    Raises
    ------
    ProblemError
        If the recording has no torque, or its torque is zero throughout.
    """
    if not model.robot.floating and recording.of(model.torque_joints).torque is None:
        raise ProblemError(f"{recording.name} has no torque to compare with")
    motion = motion_of(model, recording, None)
    if not motion.torque.any():
        raise ProblemError(f"{recording.name}: its torque is zero throughout")
    regression = build_regression(model, recording, noise=False)
    counts, size = np.array(regression.counts), regression.torque_rms
    moving = moving_shares(model, regression)
    # If rows are mixed, friction of a joint at rest is in all of them.
    rests = not motion.mixed and bool((moving < IN_MOTION).any())
    behind = recording.torque_filter
    band = None if behind is None else behind.cutoff
    errors = []
    for x, held in predictions:
        rms = regression.residual_rms(x)
        beyond = _rms_beyond(model, x, held, recording, motion) if rests else rms
        errors.append(
            TorqueError(
                recording.name,
                rms,
                rms / np.where(size > 0.0, size, np.nan),
                size,
                stacked_of_kinds(model, counts * rms**2, counts * size**2),
                beyond,
                stacked_of_kinds(model, counts * beyond**2, counts * size**2),
                band,
            )
        )
    return errors


def _rms_beyond(
    model: TorqueModel,
    x: Vector,
    held: Vector | None,
    recording: Recording,
    motion: Motion,
) -> Vector:
    """Return each joint's RMS error beyond the torque that friction can balance."""
    error = motion.torque - motion.predicted(model, x)
    held = np.zeros(len(model.torque_joints)) if held is None else held
    moved = recording.of(model.robot.joint_names)
    # Of a filtered recording with a low cut-off, one row may be kept.
    kept = slice(None) if motion.places is None else motion.places
    q, dq = moved.position[kept], np.asarray(moved.velocity)[kept]
    left = beyond_friction(model, q, dq, error, held)
    return np.asarray(np.sqrt(np.mean(left**2, axis=0)))


def stacked_of_kinds(model: TorqueModel, error: Vector, torque: Vector) -> float:
    """Return the relative error of all rows, each kind relative to its own size.

    Forces in N and torques in N m cannot be added.  `error` and `torque` are sums of
    squares, of each row.
    """
    sides = (model.forces, ~model.forces)
    kinds = [kind for kind in sides if torque[kind].any()]
    squares = [error[kind].sum() / torque[kind].sum() for kind in kinds]
    return float(np.sqrt(np.mean(squares)))


def stacked_of_regression(
    model: TorqueModel, regression: Regression, x: Vector
) -> float:
    """Return the relative error of parameters on compressed rows, unweighted.

    Parameters
    ----------
    x : ndarray, shape (parameters,)
    """
    counts = np.array(regression.counts, dtype=np.float64)
    size = counts * regression.torque_rms**2
    return stacked_of_kinds(model, counts * regression.residual_rms(x) ** 2, size)


def stacked_error(errors: Sequence[TorqueError]) -> float | None:
    """Return the relative torque error over several recordings, with equal weights.

    The root of the mean square of `TorqueError.stacked`; None without any.
    """
    return _mean([error.stacked for error in errors])


def stacked_beyond(errors: Sequence[TorqueError]) -> float | None:
    """Return the same for errors beyond friction at rest."""
    return _mean([error.stacked_beyond for error in errors])


def _mean(stacked: Sequence[float]) -> float | None:
    return float(np.sqrt(np.mean(np.square(stacked)))) if stacked else None


def moving_shares(model: TorqueModel, regression: Regression) -> Vector:
    """Return the share of samples in which each joint moves, shape (torque joints,).

    It is the mean square of the direction in the Coulomb term; NaN without Coulomb
    friction.
    """
    shares = np.full(len(regression.joints), np.nan)
    for row, columns in _coulomb_columns(model).items():
        seen = float(np.sum(regression.factors[row][:, columns] ** 2))
        shares[row] = seen / regression.counts[row]
    return shares


def holding(model: TorqueModel, x: Vector, moving: Vector) -> Vector:
    """Return the torque that friction can balance at each joint, (torque joints,).

    It is the estimated Coulomb friction; for a joint that hardly moved, `BREAKAWAY`
    times its effort limit, and NaN without a limit.  Zero without Coulomb friction.

    Parameters
    ----------
    x : ndarray, shape (parameters,)
    moving : ndarray, shape (torque joints,)
        From `moving_shares`.
    """
    limits = {joint.name: joint.limits.effort for joint in model.robot.joints}
    held = np.zeros(len(model.torque_joints))
    for row, columns in _coulomb_columns(model).items():
        held[row] = abs(x[columns]).max()
        if moving[row] < AT_REST:
            limit = limits.get(model.torque_joints[row], np.inf)
            known = 0.0 < limit < np.inf
            held[row] = BREAKAWAY * limit if known else np.nan
    return held


def beyond_friction(
    model: TorqueModel, q: Matrix, dq: Matrix, error: Array, held: Vector
) -> Array:
    """Return torque errors beyond the torque that friction at rest can balance.

    In motion nothing is subtracted; see `Coulomb` for how much a joint moves.

    Parameters
    ----------
    q, dq : ndarray, each shape (samples, joints)
        Motion of the robot's joints.
    error : ndarray, shape (samples, torque joints), [N m or N]
    held : ndarray, shape (torque joints,), [N m or N]
        From `holding`; where it is NaN, any torque may be held.
    """
    left = error.copy()
    names = model.robot.joint_names
    for row, terms in _coulomb_terms(model).items():
        j = names.index(model.torque_joints[row])
        samples = JointSamples(q[:, j], dq[:, j], np.zeros(len(q)), None)
        speed = np.sum([abs(c) for t in terms for c in t.columns(samples)], axis=0)
        known = np.isfinite(held[row])
        slack = (
            held[row] * (1.0 - speed)
            if known
            else np.where(speed < _AT_EASE, np.inf, 0.0)
        )
        left[:, row] = np.maximum(abs(error[:, row]) - slack, 0.0)
    return left


def _coulomb_terms(model: TorqueModel) -> dict[int, list[DriveTerm]]:
    """Return the Coulomb terms of each row that has any."""
    names = model.robot.joint_names
    found: dict[int, list[DriveTerm]] = {}
    for row, name in enumerate(model.torque_joints):
        if name not in names:
            continue
        terms = model.terms[names.index(name)].terms
        dry: list[DriveTerm] = [t for t in terms if isinstance(t, _DRY)]
        if dry:
            found[row] = dry
    return found


def _coulomb_columns(model: TorqueModel) -> dict[int, list[int]]:
    """Return the columns of each row's Coulomb friction."""
    index = model.layout.index
    return {
        row: [index(f"{model.torque_joints[row]}.{n}") for t in terms for n in t.names]
        for row, terms in _coulomb_terms(model).items()
    }


@dataclass(frozen=True, slots=True, eq=False)
class Slopes:
    """Slopes of joints' torque on the torque of given bodies, with free drive terms.

    Parameters
    ----------
    joints : tuple of str
    slopes : array_like, shape (joints,)
        One, if the torque is that of these bodies.
    explained : array_like, shape (joints,)
        Share of the torque beyond drive terms, squared, that the bodies explain with
        this slope.
    expected : array_like, shape (joints,)
        Torque of the bodies beyond drive terms, over the measured torque.
    errors : array_like, shape (joints,) or (), optional
        Standard errors of the slopes; infinite where they are not known.
    """

    joints: tuple[str, ...]
    slopes: Vector
    explained: Vector
    expected: Vector
    errors: Vector = array_default(np.inf)

    def __post_init__(self) -> None:
        errors = np.broadcast_to(self.errors, (len(self.joints),))
        object.__setattr__(self, "errors", errors)
        names = ("slopes", "explained", "expected", "errors")
        shapes = dict.fromkeys(names, (len(self.joints),))
        freeze_arrays(self, shapes, "slopes", finite=False)


def slopes_on(model: TorqueModel, regression: Regression, bodies: Vector) -> Slopes:
    """Return the slope of each joint's torque on that of bodies.

    Parameters
    ----------
    bodies : ndarray, shape (10 * links,)
    """
    inertial, found = model.layout.inertial_size, []
    for F in regression.factors:
        both = np.column_stack([F[:, :inertial] @ bodies, F[:, -1]])
        drive = F[:, inertial:-1]
        norms = np.linalg.norm(drive, axis=0)
        # After filters, columns of a joint at rest are so small that their squares
        # vanish.
        moving = norms > _ROUNDING * norms.max(initial=0.0)
        if moving.any():
            unit = drive[:, moving] / norms[moving]
            both = both - unit @ lstsq(unit, both)
        expected, beyond = np.linalg.norm(both, axis=0)
        product = float(both[:, 0] @ both[:, 1])
        if expected <= _ROUNDING * np.linalg.norm(F):
            found.append((np.nan, 0.0, 0.0))
            continue
        both_sizes = float(expected) * float(beyond)
        explained = product**2 / max(both_sizes**2, 1e-300)
        size = max(float(np.linalg.norm(F[:, -1])), 1e-300)
        found.append((product / expected**2, explained, expected / size))
    return Slopes(regression.joints, *np.array(found).T)

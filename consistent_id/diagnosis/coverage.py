"""Limits of a log's information: rests, saturation, small motion, rank, motion noise.

Motion noise stands in the columns of the regressor.  With ``W = W_0 + V`` in place of
``W_0`` least squares tends to ``(W^T W)^-1 W_0^T W_0 x``: its bias is
``-(W^T W)^-1 V^T V x``, which does not fall with the number of samples.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from consistent_id._support.arrays import Array, BoolArray, Matrix, Vector
from consistent_id._support.executors import single_threaded
from consistent_id.diagnosis.findings import LogFinding
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals.clocks import is_uniform, uniform_rate
from consistent_id.recordings.signals.derivatives import noise_gain
from consistent_id.recordings.signals.drive_limits import cut_off, saturated
from consistent_id.recordings.signals.filtered_rows import altered
from consistent_id.recordings.signals.filters import low_passed
from consistent_id.recordings.signals.masks import standstill
from consistent_id.recordings.signals.smoother import ORDERS, motion_noise
from consistent_id.regression.base import BaseParameters, excitation_of
from consistent_id.regression.linear import solve_linear
from consistent_id.regression.motion_arrays import Motion
from consistent_id.regression.recorded_motion import motion_of
from consistent_id.regression.regression import build_regression
from consistent_id.regression.regressor import TorqueModel

_ABOVE = 2.0  # cut-off of the motion over the torque's: beyond, its noise alone is left
_STILL = 0.02  # of a joint's largest velocity: slower joints stand still
_IDLE = 0.2  # least share of samples with all joints at rest that is reported
_RESTS = 0.9  # with this share of samples at rest or more, a joint does not move
_PINNED = 5  # least number of samples at a limit that is reported
_STAY = 0.03  # s at a limit from which on a torque is not cut off by noise alone
_SMALL, _SLOW = 0.05, 0.1  # rad or m; rad/s or m/s, of the joint that moves most
_BRIEF = 3.0  # s: in a shorter log joints may not turn back
_TURNS, _TURNING = 2.5, 0.05  # least turns of the median joint; share of top speed
_MOVES = 2e-3  # rad or m of travel: with less a joint rests and its readings flicker,
_STEPS = 2.0  # also within so many steps of its encoder


def of_samples(prepared: Recording) -> Recording:
    """Return a recording whose motion has no noise far above the band of its torque.

    The filter of the torque takes such noise out of the rows.  The motion itself is
    examined sample by sample, without that filter.
    """
    behind = prepared.torque_filter
    if behind is None:
        return prepared
    moved = replace(behind.source, torque=None, wrenches=(), torque_known=None)
    rate = uniform_rate(behind.source)
    if _ABOVE * behind.cutoff >= 0.5 * rate:
        return replace(prepared, torque_filter=None)
    smooth = low_passed(moved, motion_cutoff=_ABOVE * behind.cutoff)
    channels = {
        name: values[behind.kept]
        for name in ("position", "velocity", "acceleration")
        if (values := getattr(smooth, name)) is not None
    }
    return replace(prepared, torque_filter=None, **channels)


def standing_share(recording: Recording) -> float:
    """Return the share of samples in which all joints stand still."""
    velocity = recording.velocity
    if velocity is None or not velocity.any():
        velocity = np.gradient(recording.position, recording.time, axis=0)
    largest = abs(velocity).max(axis=0)
    still = abs(velocity) <= _STILL * np.where(largest > 0.0, largest, 1.0)
    return float(still.all(axis=1).mean())


def standstill_findings(recording: Recording) -> list[LogFinding]:
    """Warn of long times at which all joints rest."""
    share = standing_share(recording)
    if share < _IDLE:
        return []
    return [
        LogFinding(
            "standstill",
            "warning",
            recording.name,
            f"all joints stand still in {share:.0%} of {len(recording)} samples",
            "trim the rests: at rest, friction may have any value within its bounds",
            share / _IDLE,
        )
    ]


def in_motion(model: TorqueModel, prepared: Recording) -> TorqueModel:
    """Return a model with the torque of only those joints that move in a log.

    At rest, friction takes any value up to the breakaway torque.  No function of
    velocity predicts it, so torque at rest contradicts no model.

    Parameters
    ----------
    prepared : Recording
        With velocity, filtered.
    """
    rests = standstill(prepared.of(model.robot.joint_names)).mean(axis=0) > _RESTS
    resting = np.array(model.robot.joint_names)[rests]
    moving = tuple(name for name in model.torque_joints if name not in resting)
    return replace(model, torque_joints=moving or model.torque_joints)


def saturation_findings(
    recording: Recording, limits: Mapping[str, float] | None = None
) -> list[LogFinding]:
    """Find torques that stay at their largest value (`saturated`, `cut_off`).

    Peaks that are cut off for less than 0.03 s each, such as those of noise, bias an
    estimate little: they are a warning.

    Parameters
    ----------
    limits : mapping of str to float, optional, [N m or N]
        Torque at which the drives clip, for joints whose torque was computed from
        commands.  Staying at that limit is no fault.
    """
    if recording.torque is None:
        return []
    at_limit, limits = saturated(recording) | cut_off(recording), limits or {}
    return [
        LogFinding(
            "saturation",
            "fault" if _stays(at, recording.time) else "warning",
            joint,
            f"{joint}: torque stays at {_levels(tau[at])} in {int(at.sum())} of "
            f"{len(tau)} samples",
            "leave these samples out, or move more gently: the channel does not show "
            "torque beyond the limit",
            float(at.sum()) / _PINNED,
        )
        for joint, tau, at in zip(
            recording.joints, recording.torque.T, at_limit.T, strict=True
        )
        if at.sum() >= _PINNED
        and abs(tau[at]).max() > 0.0
        and not np.isclose(abs(tau[at]).max(), limits.get(joint, np.inf))
    ]


def _levels(torque: Vector) -> str:
    """Return the limit of a torque, or both, in words."""
    ends = (float(torque.min()), float(torque.max()))
    sides = ends if ends[0] < 0.0 < ends[1] else (max(ends, key=abs),)
    return " and ".join(f"{end:.4g}" for end in sides)


def _stays(mask: BoolArray, time: Vector) -> bool:
    """Return whether a mask holds for most samples of some stretch of `_STAY`."""
    samples = max(round(_STAY / float(np.median(np.diff(time)))), 1)
    within = np.convolve(mask, np.ones(samples), "valid")
    return bool(within.max(initial=0.0) > 0.5 * samples)


def extent_findings(prepared: Recording) -> list[LogFinding]:
    """Warn of motion that is small or slow, or ends before joints turned back twice.

    Parameters
    ----------
    prepared : Recording
        With velocity, filtered.
    """
    velocity = np.asarray(prepared.velocity)
    travel = float(np.ptp(prepared.position, axis=0).max())
    fastest = float(abs(velocity).max())
    turns = float(np.median([_turns(v) for v in velocity.T if v.any()] or [0]))
    brief = prepared.duration < _BRIEF
    for kind, seen, least, unit, advice in (
        (
            "small motion",
            travel,
            _SMALL,
            "rad or m is the widest travel",
            "more widely",
        ),
        ("slow motion", fastest, _SLOW, "rad/s or m/s is the top speed", "faster"),
        ("short", turns if brief else _TURNS, _TURNS, "turns of a joint", "for longer"),
    ):
        if seen < least:
            return [
                LogFinding(
                    kind,
                    "warning",
                    prepared.name,
                    f"{seen:.3g} {unit} in {prepared.duration:.3g} s; with less than "
                    f"{least:g} the bodies are hardly identifiable",
                    f"move {advice}",
                    least / max(seen, 0.1 * least),
                )
            ]
    return []


def _turns(velocity: Vector) -> int:
    """Return the number of a joint's reversals, without flickering at rest."""
    moving = velocity[abs(velocity) > _TURNING * abs(velocity).max()]
    return int((np.diff(np.sign(moving)) != 0.0).sum())


def rank_findings(
    model: TorqueModel,
    recording: Recording,
    base: BaseParameters,
    steps: Vector | float = 0.0,
) -> list[LogFinding]:
    """Name the combinations of base parameters that are not identifiable.

    Encoder readings flicker at rest; joints that only flicker are taken as at rest.

    Parameters
    ----------
    recording : Recording
        With velocity, acceleration and torque.
    steps : ndarray, shape (joints,), or float, [rad or m]
        Steps of the encoders, which a filtered position no longer shows.
    """
    recording = recording.of(model.robot.joint_names)
    travel = np.ptp(recording.position, axis=0)
    at_rest = travel < np.maximum(_MOVES, _STEPS * np.asarray(steps))
    steady = altered(recording, lambda raw: _without_motion(raw, at_rest))
    excitation = excitation_of(build_regression(model, steady, noise=False), base)
    missing = excitation.structural_rank - excitation.data_rank
    if missing == 0:
        return []
    still = [j for j, rests in zip(recording.joints, at_rest, strict=True) if rests]
    cause = f"{', '.join(still)} did not move; " if still else ""
    return [
        LogFinding(
            "rank",
            "warning",
            ", ".join(still) or "all joints",
            f"{cause}the data determine {excitation.data_rank} of "
            f"{excitation.structural_rank} base parameters (structural rank); not "
            "identifiable: " + "; ".join(excitation.undetermined),
            "move the joints that these combinations name, and not all alike; what is "
            "not identifiable is taken from the prior",
            1.0 + missing,
        )
    ]


def _without_motion(recording: Recording, at_rest: BoolArray) -> Recording:
    """Return a recording in which resting joints have constant positions."""
    q = np.where(at_rest, recording.position.mean(axis=0), recording.position)
    dq, ddq = (
        np.where(at_rest, 0.0, np.asarray(rate))
        for rate in (recording.velocity, recording.acceleration)
    )
    return replace(recording, position=q, velocity=dq, acceleration=ddq)


SHARE = 0.01
"""Least share of noise in a column's power that is reported.

Least squares underestimates a parameter by about this share.
"""

# Bias of the torque, over the torque, up to which this is a note: models that are
# called good predict to 2 %, and a quarter of that adds 3 % to their error.
_LITTLE_BIAS = 0.005
_NO_MOTION = 1e-12  # power of a direction, over the largest, that is rounding alone

_STRETCH = 2000  # samples from which the noise of the readings is estimated
_NAMED = 3  # most columns that a finding names


def motion_noise_findings(
    model: TorqueModel,
    log: Recording,
    prepare: Callable[[Recording], Recording],
    base: BaseParameters,
    *,
    prepared: Recording | None = None,
) -> list[LogFinding]:
    """Return a warning if the regressor contains noise of the positions.

    It is a note if the bias of the torque is negligible. The noise of the readings is
    the smoother's estimate (`motion_noise`), but at least that of the encoder's steps.

    Parameters
    ----------
    log : Recording
        As recorded, with torque.  Without a uniform clock there is no finding.
    prepare : callable
        Adds velocity and acceleration.
    prepared : Recording, optional
        Result of `prepare`, if it is known.
    """
    log = log.of(model.robot.joint_names)
    if log.acceleration is not None or not is_uniform(log):
        return []
    if len(log) < 8 * ORDERS[-1]:
        return []  # too short for a smoother
    first = max((len(log) - _STRETCH) // 2, 0)
    sigma = motion_noise(log.samples(slice(first, first + _STRETCH))).position
    ready = prepare(log) if prepared is None else prepared
    gain = noise_gain(log, prepare, prepared=ready)
    noise = column_noise(model, ready, gain * (sigma**2)[:, None, None], base)
    largest = noise.noisiest[0][1]
    if largest <= SHARE:
        return []
    named = ", ".join(
        f"{name} {100.0 * share:.2g} %"
        for name, share in noise.noisiest[:_NAMED]
        if share > SHARE
    )
    return [
        LogFinding(
            "motion noise",
            "warning" if noise.torque_error > _LITTLE_BIAS else "note",
            "all joints",
            f"noise of the positions ({np.median(sigma):.2g} rad or m) is part of the "
            f"regressor's columns: {named}; it biases the torque of least squares by "
            f"about {100.0 * noise.torque_error:.2g} %",
            "lower the cut-off of the motion or smooth it, or use "
            "instrumental_variables with the commanded motion",
            largest / SHARE,
        )
    ]


_SAMPLES = 4000  # evenly spaced samples over which is averaged


@dataclass(frozen=True, slots=True, eq=False)
class ColumnNoise:
    """Noise of the motion in the columns of a regressor.

    Parameters
    ----------
    names : tuple of str
        Names of the base parameters.
    shares : ndarray, shape (base,)
        Share of noise in each column's power; joints are weighted by their torque.
    bias : ndarray, shape (base,)
        Bias of weighted least squares from that noise.
    torque_error : float
        Torque of this bias over the torque.
    """

    names: tuple[str, ...]
    shares: Vector
    bias: Vector
    torque_error: float

    @property
    def noisiest(self) -> tuple[tuple[str, float], ...]:
        """Columns and their shares, the largest first."""
        order = np.argsort(-self.shares)
        return tuple((self.names[i], float(self.shares[i])) for i in order)


@single_threaded
def column_noise(
    model: TorqueModel,
    recording: Recording,
    covariance: Array,
    base: BaseParameters,
    *,
    seed: int = 0,
) -> ColumnNoise:
    """Return the share of each base column that is noise of the motion.

    Noise is drawn at samples of the motion, because it passes through friction, which
    jumps, and through products of velocities.

    Parameters
    ----------
    recording : Recording
        Prepared, with torque.
    covariance : ndarray, shape (joints, 3, 3)
        Covariance of position, velocity and acceleration: `noise_gain` times the
        variance of the readings, in the robot's order.
    seed : int
        Seed of the drawn noise.
    """
    # Noise of the motion is examined before the filter, sample by sample.
    bare = replace(_spread(recording), torque_filter=None)
    motion = motion_of(model, bare, None)
    torque = motion.torque
    weights = 1.0 / np.maximum(np.sqrt((torque**2).mean(axis=0)), 1e-12)
    W = _rows(model, motion, base, weights)
    V = _rows(model, _noisy(motion, covariance, seed), base, weights) - W
    x = solve_linear(W, (torque * weights).T.ravel()).x
    bias = -_shrunk(W, V, x)
    power = (W**2).sum(axis=0)
    shares = (V**2).sum(axis=0) / np.where(power > 0.0, power, np.inf)
    error = np.linalg.norm(W @ bias) / np.sqrt(torque.size)
    return ColumnNoise(base.names, shares, np.asarray(bias), float(error))


def _shrunk(W: Matrix, V: Matrix, x: Vector) -> Vector:
    """Return ``(W^T W)^-1 V^T V x``, at most ``x`` in each direction.

    Noise cannot take more from a parameter than there is.  In directions in which the
    data have less motion than noise, the quotient is some large number.
    """
    powers = (W**2).sum(axis=0) + (V**2).sum(axis=0)
    size = np.sqrt(np.where(powers > 0.0, powers, 1.0))
    W, V = W / size, V / size
    noise = V.T @ V
    both = W.T @ W + noise
    values, axes = np.linalg.eigh(both)
    kept = values > _NO_MOTION * values[-1]
    to_unit = axes[:, kept] / np.sqrt(values[kept])
    of_noise, turns = np.linalg.eigh(to_unit.T @ noise @ to_unit)
    to_unit = to_unit @ turns
    lost = of_noise / np.maximum(1.0 - of_noise, of_noise)
    return np.asarray(to_unit @ (lost * (to_unit.T @ both @ (size * x))) / size)


def _spread(recording: Recording) -> Recording:
    return recording.samples(slice(None, None, -(-len(recording) // _SAMPLES)))


def _noisy(motion: Motion, covariance: Array, seed: int) -> Motion:
    """Return the motion with noise of the given covariance drawn upon it."""
    rng = np.random.default_rng(seed)
    n, joints = motion.q.shape
    # Eigenvectors, because position and acceleration may be fully correlated.
    values, axes = np.linalg.eigh(covariance)
    roots = axes * np.sqrt(np.maximum(values, 0.0))[:, None, :]
    drawn = np.einsum("jab,njb->anj", roots, rng.normal(size=(n, joints, 3)))
    q, dq, ddq = (x + e for x, e in zip(motion[:3], drawn, strict=True))
    return motion._replace(q=q, dq=dq, ddq=ddq)


def _rows(
    model: TorqueModel, motion: Motion, base: BaseParameters, weights: Vector
) -> Matrix:
    """Return the base columns of all torque joints' rows, weighted."""
    Y = model.regressor(motion.q, motion.dq, motion.ddq)[:, list(base.independent)]
    return np.concatenate(list(Y * weights[:, None, None]), axis=1).T

"""Causes that the log itself suggests: gravity, masses, the order of all channels."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from consistent_id._support.arrays import IntArray, Matrix, Vector
from consistent_id.constraints import FixedMasses
from consistent_id.diagnosis.channel_factors import ChannelFactors, channel_factors
from consistent_id.diagnosis.contact import contact
from consistent_id.diagnosis.corrections import Cause
from consistent_id.diagnosis.explain import Candidate, FittedLog, thinned
from consistent_id.diagnosis.late_torque import late_torque
from consistent_id.diagnosis.lost_signs import lost_signs
from consistent_id.diagnosis.missing_parts import missing_parts
from consistent_id.diagnosis.other_gravity import other_gravity
from consistent_id.diagnosis.other_load import other_loads
from consistent_id.recordings.recording import Recording

_THRESHOLD = 1.3  # ratio of misfits, as in the table of corrections
_EXPLAINED = 0.03  # of the torque: misfit below which the following are not asked for
# Ratio of misfits for the clock: its speed also moves the edge of smooth Coulomb
# friction, which brings clean logs up to 1.45.
_OF_TIME = 1.6
_GAINS = (1e-3, 0.01, 0.4, 0.55, 0.7, 0.85, 1.2, 1.4, 1.8, 2.5, 100.0, 1e3)
_FEW = 300  # samples that choose the speed of a clock
_SPEEDS = (0.1, 0.2, 0.35, 0.5, 0.7, 0.85, 1.0, 1.2, 1.4, 2.0, 2.8, 5.0, 10.0)


def alternatives(as_is: FittedLog) -> list[Candidate]:
    """Return the causes in the model that a log suggests."""
    return [
        *other_gravity(as_is),
        *_other_masses(as_is),
        *other_loads(as_is),
        *_other_channels(as_is),
        *lost_signs(as_is),
        *_other_gain(as_is),
        *_other_clock(as_is),
        *late_torque(as_is),
        *missing_parts(as_is),
        *contact(as_is),
    ]


def _other_masses(as_is: FittedLog) -> Iterator[Candidate]:
    """Yield the log with masses that are not known.

    A gain that all torques share does to a robot what it does to its masses.
    """
    free = [c for c in as_is.constraints if not isinstance(c, FixedMasses)]
    if len(free) == len(as_is.constraints):
        return
    cause = Cause(
        "masses or gain",
        "all joints",
        "with masses that are not the model's, or gains that are not the log's",
        'check load, tool, model and gains; if these are right, masses = "free" '
        "(--masses free)",
        _THRESHOLD,
        excuse=1,
    )
    yield Candidate(cause, as_is.factors, free)


def _other_gain(as_is: FittedLog) -> Iterator[Candidate]:
    """Yield the log with another factor for the one torque that profits most.

    Several joints carry one body: what they say of it has to agree.
    """
    from scipy.optimize import minimize_scalar

    factors = as_is.factors
    everyone, names = factors.model.robot.joint_names, factors.model.torque_joints
    if as_is.misfit < _EXPLAINED or len(names) < 2:
        return  # one torque alone is explained as well whatever its gain

    def changed(name: str, logarithm: float) -> ChannelFactors:
        scale = np.ones(len(everyone))
        scale[everyone.index(name)] = np.exp(logarithm)
        return factors.changed(np.diag(scale))

    tried = factors.least_misfits(_GAINS)
    j, k = np.unravel_index(np.argmin(tried), tried.shape)
    name, start = names[j], float(np.log(_GAINS[k]))
    if tried[j, k] * _THRESHOLD > factors.least_misfit():
        return
    near = minimize_scalar(
        lambda logarithm: changed(name, logarithm).least_misfit(),
        bounds=(start - 0.4, start + 0.4),
        method="bounded",
        options={"xatol": 0.005},
    )
    factor = float(np.exp(near.x))
    cause = Cause(
        "torque gain",
        name,
        f"with the torque of {name} times {factor:.3g}",
        f"check the gain and gear ratio of {name}",
        _THRESHOLD,
    )
    yield Candidate(cause, changed(name, float(near.x)), as_is.constraints)


def _other_clock(as_is: FittedLog) -> Iterator[Candidate]:
    """Yield the log with the clock's speed that fits best.

    Gravity knows no time: what weighs in it accelerates in the inertial torque.
    """
    from scipy.optimize import minimize_scalar

    if as_is.misfit < _EXPLAINED:
        return
    model, base = as_is.factors.model, as_is.factors.base
    few = thinned(as_is.recording, _FEW)

    def left(logarithm: float) -> float:
        log = _at_speed(few, float(np.exp(logarithm)))
        return channel_factors(model, base, [log])[0].least_misfit()

    tried = [left(float(s)) for s in np.log(_SPEEDS)]
    k = int(np.argmin(tried))
    if k in (0, len(tried) - 1) or _SPEEDS[k] == 1.0:
        return  # at the ends there is no inertial torque, or nothing else
    if min(tried) * _OF_TIME > tried[_SPEEDS.index(1.0)]:
        return
    inner = np.log(_SPEEDS)[[k - 1, k + 1]]
    speed = float(np.exp(minimize_scalar(left, bounds=inner, method="bounded").x))
    cause = Cause(
        "clock",
        "time",
        f"with a clock {speed:.3g} times as fast",
        f"divide the time by {speed:.3g}: find out in which unit, or at which rate, it "
        "was logged",
        _OF_TIME,
    )
    (factors,) = channel_factors(model, base, [_at_speed(as_is.recording, speed)])
    yield Candidate(cause, factors, as_is.constraints)


def _at_speed(log: Recording, speed: float) -> Recording:
    """Return a prepared recording of which the clock runs faster."""
    velocity, acceleration = np.asarray(log.velocity), np.asarray(log.acceleration)
    return replace(log, velocity=speed * velocity, acceleration=speed**2 * acceleration)


def _other_channels(as_is: FittedLog) -> Iterator[Candidate]:
    """Yield the order of all torque channels in which rows fit best, one by one."""
    factors = as_is.factors
    names = factors.model.torque_joints
    if len(names) < 3:
        return
    costs = np.array([_row_misfits(F, len(factors.base)) for F in factors.factors])
    if (costs.argmin(axis=1) == np.arange(len(names))).all():
        return  # each row fits its own channel best
    order = _cheapest_order(np.log(np.maximum(costs, 1e-9)))
    if (order == np.arange(len(order))).sum() >= len(order) - 2:
        return  # at most two exchanged, which the table has
    everyone = factors.model.robot.joint_names
    matrix = np.eye(len(everyone))
    places = [everyone.index(name) for name in names]
    matrix[np.ix_(places, places)] = np.eye(len(names))[:, order]
    meant = ", ".join(names[k] for k in order)
    cause = Cause(
        "channel order",
        "all joints",
        f"with the torques of {', '.join(names)} taken from the columns of {meant}",
        "name the torque columns in the order of the joints they belong to",
        _THRESHOLD,
    )
    yield Candidate(cause, factors.changed(matrix), as_is.constraints)


def _cheapest_order(costs: Matrix) -> IntArray:
    """Return the column of each row, all different, with the least sum of costs."""
    from scipy.optimize import linear_sum_assignment

    _, order = linear_sum_assignment(costs)
    return np.asarray(order)


def _row_misfits(factor: Matrix, base: int) -> Vector:
    """Return what a joint's row leaves of each torque channel, relative to it."""
    columns, channels = factor[:, :base], factor[:, base:]
    kept = columns[:, columns.any(axis=0)]
    Q, _ = np.linalg.qr(kept / np.linalg.norm(kept, axis=0))
    left = channels - Q @ (Q.T @ channels)
    size = np.maximum(np.linalg.norm(channels, axis=0), 1e-300)
    return np.asarray(np.linalg.norm(left, axis=0) / size)

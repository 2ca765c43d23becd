"""How much of its range and of its limits each joint of a design uses.

Where a limit is not stated, the largest value that is reached takes its place.
"""

from collections.abc import Sequence

import numpy as np

from consistent_id._support.arrays import Vector
from consistent_id._support.tables import Table, some_of
from consistent_id.excitation.designed import ExcitationDesign
from consistent_id.motion.limits import MotionLimits
from consistent_id.motion.proofs.extremes import extremes
from consistent_id.motion.proofs.margins import Margin
from consistent_id.recordings.joint_paths import JointPath

_ENDS = ("lower", "upper")
_RATES = ("velocity", "acceleration", "jerk")
_BOUNDED = (*_RATES, "torque")
_OVER_TIME = ("torque rate", "torque RMS")
_NAMED = 4  # joints, in one sentence
_HARDLY = 0.1  # share of a joint's range, or rad or m without one
_SAMPLES = 1000
_AT_LIMIT = 0.9  # share of a velocity limit that stops a joint
_UNITS = "values without a limit in rad or m, s, N m or N"
_QUARTER = 0.25  # of its range, that such a joint should move through


def least_moved(path: JointPath, limits: MotionLimits) -> str:
    """Return which joints hardly move, in words.

    A joint hardly moves if it uses less than a tenth of its range; without a range, if
    it moves by less than 0.1 rad or m.
    """
    return least_moved_of(limits.joints, range_shares(path, limits))


def least_moved_of(joints: Sequence[str], shares: Vector) -> str:
    """Return which joints hardly move, in words, from the shares of their ranges."""
    few = [k for k in np.argsort(shares) if shares[k] < _HARDLY]
    if few:
        named = tuple(
            f"{joints[k]} ({100.0 * shares[k]:.2g} % of its range)" for k in few
        )
        verb = "moves" if len(few) == 1 else "move"
        return f"hardly {verb}: {some_of(named, _NAMED)}"
    k = int(np.argmin(shares))
    return f"least moved: {joints[k]}, {100.0 * shares[k]:.0f} % of its range"


def range_shares(path: JointPath, limits: MotionLimits) -> Vector:
    """Return the share of its range that each joint uses; without one, in rad or m."""
    order = [tuple(path.joints).index(joint) for joint in limits.joints]
    time = path.start + path.duration * np.linspace(0.0, 1.0, _SAMPLES)
    moved = np.ptp(path.evaluate(time, 0)[0][:, order], axis=0)
    width = limits.upper - limits.lower
    return np.asarray(moved / np.where(np.isfinite(width), width, 1.0))


def longer_duration(design: ExcitationDesign) -> float | None:
    """Return the duration that joints stopped by their velocity limits need [s].

    A sine of amplitude ``A`` and one period ``T`` has the velocity ``2 pi A / T``; the
    amplitude is that of a quarter of the range.  None if no joint hardly moves because
    of its velocity limit, or if a longer motion is not the reason.
    """
    limits = design.limits
    shares = range_shares(design.trajectory, limits)
    used = {m.joint: m.bound / m.limit for m in _margins_of(design, "velocity")}
    width = limits.upper - limits.lower
    needed = [
        np.pi * _QUARTER * width[j] / limits.velocity[j]
        for j, joint in enumerate(limits.joints)
        if shares[j] < _HARDLY and used.get(joint, 0.0) >= _AT_LIMIT
    ]
    longest = max(needed, default=0.0)
    if longest <= design.form.duration:
        return None
    step = 10.0 ** (np.floor(np.log10(longest)) - 1.0)
    return float(np.ceil(longest / step) * step)


def longer_words(design: ExcitationDesign) -> tuple[str, ...]:
    """Return a sentence that advises a longer motion, if that is the reason."""
    longer = longer_duration(design)
    if longer is None:
        return ()
    return (
        f"joints that hardly move are stopped by their velocity limits in "
        f"{design.form.duration:g} s: --duration {longer:g} gives them time for a "
        "quarter of their range",
    )


def largest_values(design: ExcitationDesign) -> dict[str, list[float | None]]:
    """Return the largest absolute values of each joint's motion, by quantity.

    Velocity, acceleration and jerk are proven bounds; torque is that of the limits'
    check at samples, None where it is not known.  In rad or m, s, N m or N.
    """
    path, limits = design.trajectory, design.limits
    found: dict[str, list[float | None]] = {
        name: extremes(path, order).size.tolist()
        for order, name in enumerate(_RATES, start=1)
    }
    predicted = design.demands.predicted
    found["torque"] = [None] * len(limits.joints)
    if predicted is not None:
        time = path.start + path.duration * np.linspace(0.0, 1.0, _SAMPLES)
        torque = predicted.kernel.torque(path.evaluate(time))
        found["torque"] = abs(torque).max(axis=(0, 1)).tolist()
    return found


def _margins_of(design: ExcitationDesign, quantity: str) -> list[Margin]:
    every = design.proof.margins.margins
    return [margin for margin in every if margin.quantity == quantity]


def used_limits(design: ExcitationDesign) -> Table:
    """Return the share of each limit that a design uses, joint by joint.

    Without a limit, the largest value that is reached.
    """
    limits = design.limits
    margins = {(m.joint, m.quantity): m for m in design.proof.margins.margins}
    over_time = {m.quantity for m in design.proof.margins.margins} & {*_OVER_TIME}
    quantities = (*_BOUNDED, *(name for name in _OVER_TIME if name in over_time))
    largest, none = largest_values(design), [None] * len(limits.joints)
    rows = []
    for j, joint in enumerate(limits.joints):
        low, high = (margins.get((joint, f"{end} position")) for end in _ENDS)
        cells = ["-"] * (1 + len(quantities))
        if low is not None and high is not None:
            span = limits.upper[j] - limits.lower[j]
            cells[0] = f"{100.0 * (high.bound - low.bound) / span:.0f} %"
        for k, quantity in enumerate(quantities, start=1):
            if (margin := margins.get((joint, quantity))) is not None:
                cells[k] = f"{100.0 * margin.bound / margin.limit:.0f} %"
            elif (value := largest.get(quantity, none)[j]) is not None:
                cells[k] = f"{value:.3g}, no limit"
        rows.append((joint, *cells))
    whose = _torque_of(design)
    of_torque = () if any(whose in n for n in design.notes) else (f"torque: {whose}",)
    units = (_UNITS,) if any("no limit" in c for row in rows for c in row[1:]) else ()
    return Table(
        "Share of each limit that is used",
        ("joint", "range", *quantities),
        tuple(rows),
        (*of_torque, *units),
    )


def _torque_of(design: ExcitationDesign) -> str:
    """Return whose torque is compared with the limits, in words."""
    if design.demands.parameters is None:
        return "not checked"
    return design.demands.torque_of

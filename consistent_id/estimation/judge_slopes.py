"""The rule on slopes: whether torque is the nominal robot's, joint by joint."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from consistent_id._support.arrays import BoolArray, Vector
from consistent_id.estimation.evidence import Evidence
from consistent_id.estimation.fit import Fit
from consistent_id.estimation.stiction import IN_MOTION
from consistent_id.estimation.verdict import Reason

# Of simulated logs without a fault (see `judge`), slopes were 0.92-1.12.
SLOPE_CARE = (0.8, 1.25)
SLOPE_FAR = 3.0  # no designer is so wrong about masses
SLOPE_MISSING = 0.2  # below, the bodies' torque is not in the channel
EFFORT_CARE = 1.2  # peak torque over effort limit: limits are often rounded down
EXPLAINED = 0.3  # squared share of torque from which a slope means something
EXPECTED = 0.1  # share of a joint's torque that makes its slope matter
EXPECTED_MUCH = 0.3  # share that cannot be missing for want of excitation
JOINT_MATTERS = 0.05  # torque over that of the strongest joint


class _Found(NamedTuple):
    """Joints by what is wrong with their slopes; a joint is in one of the lists."""

    reversed_: list[int]
    missing: list[int]
    off: list[int]
    far: list[int]  # of those that are off
    alike: bool  # all that mean something are off, as by one gain


def of_slopes(evidence: Evidence) -> Iterator[Reason]:
    """Compare the channel with the torque of the nominal bodies, joint by joint."""
    fit = evidence.fit
    if fit is None:
        return
    found = _found(fit)
    if found.reversed_:
        yield Reason(
            "torque sign",
            "do not use",
            f"torque runs against the nominal bodies': {_slopes(fit, found.reversed_)}",
            "check the sign of torque and position, and the axes of the model",
        )
    if found.missing:
        yield Reason(
            "torque channel",
            "use with care",
            "the torque of the nominal bodies is hardly in the channel: "
            f"{_slopes(fit, found.missing)}",
            "is it compensated for gravity, another quantity, or of another joint?",
        )
    if found.off:
        # Two witnesses of a gain: masses, and what the drives can give.
        shown = found.alike and bool((fit.efforts[found.far] > EFFORT_CARE).any())
        yield Reason(
            "gain or unit" if found.alike else "nominal model",
            "do not use" if shown else "use with care",
            "measured over nominal torque: " + _slopes(fit, found.off),
            "check the unit and gain of torque, and the model's masses"
            if found.alike
            else "check these joints' gains, drive terms (rotor inertia) and bodies",
        )


def _found(fit: Fit) -> _Found:
    """Return the joints whose slopes are wrong.

    What friction holds at rest may turn a slope by as much as `_held_slopes` says.
    """
    held = _held_slopes(fit)
    least, most = fit.slopes - held, fit.slopes + held
    strong = fit.shares >= JOINT_MATTERS
    matters = strong & (fit.expected >= EXPECTED)
    # With a gain of 100, the nominal torque is a hundredth, but explains it all.
    scaled = strong & (abs(fit.slopes) * fit.expected >= EXPECTED_MUCH)
    means = (matters | scaled) & (fit.explained >= EXPLAINED)
    low, high = SLOPE_CARE
    reversed_ = means & (most < 0.0)
    missing = matters & (fit.expected >= EXPECTED_MUCH) & (most < SLOPE_MISSING)
    missing &= ~reversed_
    off = means & ((most < low) | (least > high)) & ~reversed_ & ~missing
    alike = bool(off.any()) and bool((off == means).all()) and _alike(fit.slopes[off])
    far = where(off & (least > SLOPE_FAR))
    return _Found(where(reversed_), where(missing), where(off), far, alike)


def _held_slopes(fit: Fit) -> Vector:
    """Return how much friction at rest can turn each slope, either way.

    Of a joint that mostly rests: torque held meanwhile, as like the nominal bodies' as
    can be.  NaN where nobody knows how much friction can hold: no slope means anything.
    """
    rests = fit.moving < IN_MOTION
    share = np.sqrt(np.where(rests, 1.0 - fit.moving, 0.0))
    nominal = np.maximum(fit.expected * fit.torque, np.finfo(float).tiny)
    with np.errstate(over="ignore"):  # of bodies without torque: by any amount
        return np.where(rests, share * fit.holding / nominal, 0.0)


def _alike(slopes: Vector) -> bool:
    """Return whether slopes are off as by one gain.

    They are if all are far off to the same side, or if those of several joints differ
    by less than the gate allows.
    """
    far = slopes.min() > SLOPE_FAR or slopes.max() < 1.0 / SLOPE_FAR
    near = slopes.max() / slopes.min() < SLOPE_CARE[1] / SLOPE_CARE[0]
    return bool(far or (near and len(slopes) > 1))


def where(mask: BoolArray) -> list[int]:
    """Return the places of what is true."""
    return [int(j) for j in np.flatnonzero(mask)]


def _slopes(fit: Fit, joints: Sequence[int]) -> str:
    return ", ".join(f"{fit.joints[j]} {fit.slopes[j]:.2f}" for j in joints)

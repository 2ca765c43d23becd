"""The rule on slopes: whether torque is the nominal robot's, joint by joint."""

from collections.abc import Iterator, Sequence

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


def of_slopes(evidence: Evidence) -> Iterator[Reason]:
    """Compare the channel with the torque of the nominal bodies, joint by joint.

    What friction holds at rest may turn a slope by as much as `_held_slopes` says.
    """
    fit = evidence.fit
    if fit is None:
        return
    held = _held_slopes(fit)
    least, most = fit.slopes - held, fit.slopes + held
    strong = fit.shares >= JOINT_MATTERS
    matters = strong & (fit.expected >= EXPECTED)
    # With a gain of 100, the nominal torque is a hundredth, but explains it all.
    scaled = strong & (abs(fit.slopes) * fit.expected >= EXPECTED_MUCH)
    means = (matters | scaled) & (fit.explained >= EXPLAINED)
    reversed_ = [j for j in where(means) if most[j] < 0.0]
    missing = [
        j
        for j in where(matters & (fit.expected >= EXPECTED_MUCH))
        if most[j] < SLOPE_MISSING and j not in reversed_
    ]
    low, high = SLOPE_CARE
    off = [
        j
        for j in where(means)
        if (most[j] < low or least[j] > high) and j not in (*reversed_, *missing)
    ]
    if reversed_:
        yield Reason(
            "torque sign",
            "do not use",
            f"torque runs against the nominal bodies': {_slopes(fit, reversed_)}",
            "check the sign of torque and position, and the axes of the model",
        )
    if missing:
        yield Reason(
            "torque channel",
            "use with care",
            "the torque of the nominal bodies is hardly in the channel: "
            f"{_slopes(fit, missing)}",
            "is it compensated for gravity, another quantity, or of another joint?",
        )
    if off:
        alike = len(off) == np.count_nonzero(means) and _alike(fit, off)
        # Two witnesses of a gain: masses, and what the drives can give.
        beyond = [j for j in off if least[j] > SLOPE_FAR]
        shown = alike and bool((fit.efforts[beyond] > EFFORT_CARE).any())
        yield Reason(
            "gain or unit" if alike else "nominal model",
            "do not use" if shown else "use with care",
            "measured over nominal torque: " + _slopes(fit, off),
            "check the unit and gain of torque, and the model's masses"
            if alike
            else "check these joints' gains, drive terms (rotor inertia) and bodies",
        )


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


def _alike(fit: Fit, joints: Sequence[int]) -> bool:
    """Return whether slopes are off as by one gain.

    They are if all are far off to the same side, or if those of several joints differ
    by less than the gate allows.
    """
    slopes = fit.slopes[list(joints)]
    far = slopes.min() > SLOPE_FAR or slopes.max() < 1.0 / SLOPE_FAR
    near = slopes.max() / slopes.min() < SLOPE_CARE[1] / SLOPE_CARE[0]
    return bool(far or (near and len(slopes) > 1))


def where(mask: BoolArray) -> list[int]:
    """Return the places of what is true."""
    return [int(j) for j in np.flatnonzero(mask)]


def _slopes(fit: Fit, joints: Sequence[int]) -> str:
    return ", ".join(f"{fit.joints[j]} {fit.slopes[j]:.2f}" for j in joints)

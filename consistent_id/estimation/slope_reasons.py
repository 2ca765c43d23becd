"""Reasons from slopes: each joint's torque beside that of bodies known otherwise."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from consistent_id._support.arrays import BoolArray, Vector
from consistent_id.estimation.fit import Fit
from consistent_id.estimation.torque_error import IN_MOTION, Slopes
from consistent_id.estimation.verdict import Reason
from consistent_id.regression.row_names import BASE_ROWS

# Of simulated logs without a fault (see `judge`), slopes were 0.92-1.12.
SLOPE_CARE = (0.8, 1.25)

# Slopes that all significant joints exceed, and that their mean exceeds, either way: as
# by one gain of all torques.  Bodies that are wrong differ from joint to joint.
COMMON_EACH = 1.10
COMMON_MEAN = 1.15

# Mean slope, either way, and ratio of the largest slope to the least, with which a gain
# of all torques is far more likely than bodies.  Torques of 0.7 and 1.3 times leave
# ratios of 1.05 to 1.15 on a UR10e, a TX40 and a TIAGo; a right log of a KUKA whose
# bodies were guessed, 1.24; loads that are not in a UR10e's file, 1.19 to 3.1.
ONE_GAIN_MEAN = 1.20
ONE_GAIN_SPREAD = 1.20

# Slopes on bodies that other joints determine, that confirm a joint's gain.  A gain of
# 1.3 on one joint of a UR10e leaves 1.24 to 1.55 (its last two joints say nothing).
SLOPE_CONFIRMED = (0.89, 1.12)
SLOPE_FAR = 3.0  # no designer's masses are so wrong
SLOPE_MISSING = 0.2  # below, the bodies' torque is not in the channel
EFFORT_CARE = 1.2  # peak torque over effort limit: limits are often rounded down
# Share of all torque that wrong gains may be before the verdict says so: with slopes
# within `SLOPE_CARE`, one strong joint may make an estimate that much wrong.  Slopes of
# simulated logs without a fault make it 0.12 at most; clean logs of a UR10e, 0.09.
GAINS_CARE = 0.12
EXPLAINED = 0.3  # squared share of torque from which a slope is significant
EXPECTED = 0.1  # share of a joint's torque from which its slope is used
EXPECTED_MUCH = 0.3  # share that cannot be missing for lack of excitation
_SEVERAL = 2  # joints whose slopes one gain may move
_SURE = 2.0  # standard errors of a slope, with which it confirms a gain
_OF_ALL = "torque of all joints"  # the factor of reasons that are joined
JOINT_MATTERS = 0.05  # torque over that of the strongest joint


class _Found(NamedTuple):
    """Joints by the fault of their slopes; a joint is in one of the lists."""

    reversed_: list[int]
    missing: list[int]
    off: list[int]
    far: list[int]  # of those that are off
    strong: list[int]  # off by less, but of joints that carry much of the torque
    alike: bool  # all significant slopes are off, as by one gain
    common: list[int]  # all significant ones, if they are all off a little to one side


def slope_reasons(fit: Fit, crossed: Slopes | None) -> Iterator[Reason]:
    """Compare the channel with the torque of the nominal bodies, joint by joint.

    Parameters
    ----------
    crossed : Slopes, optional
        Slopes of doubtful joints, on bodies that the other joints determine; see
        `confirmed_slopes`.
    """
    found = _found(fit)
    if found.reversed_:
        yield Reason(
            "torque sign",
            "do not use",
            "measured torque has the opposite sign of the nominal bodies': "
            f"{slopes_of(fit, found.reversed_)}",
            "reverse the torque of these joints by a negative gain (--torque-gain), or "
            "their position, or their axes in the model; consistent-id check tries it",
        )
    if found.missing:
        yield Reason(
            "torque channel",
            "use with care",
            "the channel hardly contains the torque of the nominal bodies: "
            f"{slopes_of(fit, found.missing)}",
            "check for compensated gravity, another quantity or another joint",
        )
    if found.off and found.alike:
        # Two independent signs of a gain: masses, and effort limits of the drives.
        shown = bool((fit.efforts[found.far] > EFFORT_CARE).any())
        yield Reason(
            "gain or unit",
            "do not use" if shown or _one_gain(fit, found.off) else "use with care",
            "measured over nominal torque: " + slopes_of(fit, found.off),
            "check the unit and gain of torque, and the model's masses; if these are "
            'known to be right, --accept "gain or unit"',
            _OF_ALL,
            slopes_of(fit, found.off),
        )
        return
    if found.common:
        mean = _mean(fit.slopes[found.common])
        yield Reason(
            "gain or unit",
            "do not use" if _one_gain(fit, found.common) else "use with care",
            f"measured over nominal torque: {slopes_of(fit, found.common)}; nothing in "
            f"the log separates a gain of {mean:.2f}, or a wrong clock, from bodies "
            f"that are {mean:.2f} times the nominal ones",
            "check the gain of torque, the unit of time, and the model's masses; if "
            'these are known to be right, --accept "gain or unit"',
            _OF_ALL,
            slopes_of(fit, found.common),
        )
    if found.off:
        yield from _of_nominal(fit, found, crossed)
    elif found.strong and not found.common:
        yield from _of_strong(fit, found.strong, crossed)


def _covered(fit: Fit, found: _Found) -> list[int]:
    """Return joints whose slope is about the factor of all joints."""
    if not found.common:
        return []
    (low, high), mean = SLOPE_CARE, _mean(fit.slopes[found.common])
    return [j for j in found.common if low <= fit.slopes[j] / mean <= high]


def effort_reasons(fit: Fit, usual: Vector | None) -> Iterator[Reason]:
    """Compare the torque with the effort limits of the model.

    Parameters
    ----------
    usual : ndarray, shape (joints,), optional
        Torque that 99 % of the samples do not exceed, over the limits.
    """
    exceeds = fit.efforts > EFFORT_CARE
    if usual is not None:
        few = where(exceeds & (usual <= EFFORT_CARE))
        exceeds = exceeds & (usual > EFFORT_CARE)
        if few:
            said = ", ".join(f"{fit.joints[j]} {fit.efforts[j]:.2g} times" for j in few)
            yield Reason(
                "effort limit",
                "use",
                f"peaks of torque exceed the model's effort limit: {said}; 99 % of the "
                "samples do not",
            )
    beyond = where(exceeds)
    if beyond:
        said = ", ".join(f"{fit.joints[j]} {fit.efforts[j]:.2g} times" for j in beyond)
        statement = f"torque exceeds the model's effort limit: {said}"
        if agreeing(fit)[beyond].all():
            statement += (
                f"; but measured over nominal torque is {slopes_of(fit, beyond)}: "
                "peaks, perhaps outliers, or a wrong limit"
            )
        yield Reason(
            "effort limit",
            "use with care",
            statement,
            "check the unit and gain of torque, or correct the limit",
        )


def _of_nominal(fit: Fit, found: _Found, crossed: Slopes | None) -> Iterator[Reason]:
    """Doubt single joints, but for those whose gain the other joints confirm.

    Then the nominal bodies are wrong, or there is a load: the estimate shows it.  A
    slope that is the factor of all joints is not stated again.
    """
    off, covered = found.off, _covered(fit, found)
    right = () if crossed is None else confirmed_joints(crossed)
    others = {} if crossed is None else _told(crossed)
    doubtful = [j for j in off if fit.joints[j] not in right and j not in covered]
    said = "measured over nominal torque: "
    if doubtful:
        one = fit.joints[doubtful[0]] if len(doubtful) == 1 else ""
        yield Reason(
            "nominal model",
            "use with care",
            said + slopes_of(fit, doubtful) + _beside(fit, doubtful, others),
            "check these joints' gains, drive terms (rotor inertia) and bodies",
            f"torque of {one}" if one else "",
            slopes_of(fit, doubtful),
        )
    known = [j for j in off if fit.joints[j] in right]
    if known:
        yield Reason(
            "nominal model",
            "use",
            f"{said}{slopes_of(fit, known)}{_beside(fit, known, others)}, so the "
            "gains are right, and the model's bodies are wrong or carry a load",
        )


def _of_strong(
    fit: Fit, strong: Sequence[int], crossed: Slopes | None
) -> Iterator[Reason]:
    """Doubt small errors of gains that make a large error of all torque."""
    right = () if crossed is None else confirmed_joints(crossed)
    doubtful = [j for j in strong if fit.joints[j] not in right]
    share = _wrong_share(fit, doubtful, _held_slopes(fit))
    if share > GAINS_CARE:
        largest = max(doubtful, key=lambda j: abs(fit.slopes[j] - 1.0) * fit.torque[j])
        yield Reason(
            "nominal model",
            "use with care",
            f"measured over nominal torque: {slopes_of(fit, doubtful)}; nothing in the "
            f"log separates a wrong gain of {fit.joints[largest]} from other bodies, "
            f"and such gains would make {share:.0%} of all joints' torque wrong",
            "check these joints' gains and the model's masses; if these are known to "
            'be right, --accept "nominal model"',
        )


def _wrong_share(fit: Fit, joints: Sequence[int], held: Vector) -> float:
    """Return the error of all joints' torque, if slopes of some are wrong gains.

    ``||(s - 1) t|| / ||t||``, where ``t`` is the torque over the slopes ``s``, without
    the part that friction at rest may change.
    """
    chosen = np.isin(np.arange(len(fit.joints)), joints)
    slopes = np.where(chosen, fit.slopes, 1.0)
    torque = fit.torque / slopes
    off = np.where(chosen, np.maximum(abs(slopes - 1.0) - held, 0.0), 0.0)
    return float(np.linalg.norm(off * torque) / np.linalg.norm(torque))


def _told(crossed: Slopes) -> dict[str, float]:
    """Return slopes on bodies that the other joints determine, where they do."""
    means = (crossed.explained >= EXPLAINED) & (crossed.expected >= EXPECTED)
    return {crossed.joints[j]: float(crossed.slopes[j]) for j in where(means)}


def _beside(fit: Fit, joints: Sequence[int], others: dict[str, float]) -> str:
    """Return slopes on bodies that the other joints determine, in words."""
    known = [fit.joints[j] for j in joints if fit.joints[j] in others]
    if not known:
        return ""
    shown = ", ".join(f"{name} {others[name]:.2f}" for name in known)
    return f"; over the torque of bodies that the other joints determine: {shown}"


def agreeing(fit: Fit) -> BoolArray:
    """Return joints whose gain the nominal bodies confirm, shape (joints,)."""
    low, high = SLOPE_CONFIRMED
    right = (fit.explained >= EXPLAINED) & (fit.expected >= EXPECTED_MUCH)
    return np.asarray(right & (fit.slopes >= low) & (fit.slopes <= high))


def doubtful_joints(fit: Fit) -> tuple[str, ...]:
    """Return joints whose torque is not the nominal bodies', if others' torque is."""
    found = _found(fit)
    doubtful = found.off or found.strong
    return () if found.alike else tuple(fit.joints[j] for j in doubtful)


def confirmed_joints(crossed: Slopes) -> tuple[str, ...]:
    """Return joints whose gain the torque of the other joints confirms.

    Parameters
    ----------
    crossed : Slopes
        On bodies that the other joints determine.
    """
    low, high = SLOPE_CONFIRMED
    least = crossed.slopes - _SURE * crossed.errors
    most = crossed.slopes + _SURE * crossed.errors
    right = (least >= low) & (most <= high)
    right &= (crossed.explained >= EXPLAINED) & (crossed.expected >= EXPECTED_MUCH)
    return tuple(crossed.joints[j] for j in where(right))


def _found(fit: Fit) -> _Found:
    """Return the joints whose slopes are wrong.

    Friction at rest may change a slope by as much as `_held_slopes` returns.
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
    common = _common(means, least, most, fit.slopes)
    # Where friction is most of the torque, a slope says too little of the gain.
    told = means & (fit.expected >= EXPECTED_MUCH) & (fit.slopes > 0.0)
    told &= np.isfinite(held)
    # The force on a floating base passes no drive, whose gain might be wrong.
    told &= ~np.isin(fit.joints, BASE_ROWS)
    near = where(told & ~reversed_ & ~missing & ~off)
    heavy = near if _wrong_share(fit, near, held) > GAINS_CARE else []
    return _Found(
        where(reversed_), where(missing), where(off), far, heavy, alike, common
    )


def _common(means: BoolArray, least: Vector, most: Vector, slopes: Vector) -> list[int]:
    """Return the significant joints, if one gain may have moved all their slopes.

    Two joints or more; changes by friction at rest count against it.
    """
    joints = where(means)
    if len(joints) < _SEVERAL:
        return []
    large = bool((least[joints] > COMMON_EACH).all())
    small = bool((most[joints] < 1.0 / COMMON_EACH).all() and (least[joints] > 0).all())
    if not large and not small:
        return []
    mean = _mean(slopes[joints])
    return joints if max(mean, 1.0 / mean) > COMMON_MEAN else []


def _one_gain(fit: Fit, joints: Sequence[int]) -> bool:
    """Return whether slopes are so alike, and so far from one, that a gain is likely.

    Bodies that are wrong, or a load, change the slopes of joints differently.  The
    force on a floating base passes no drive: if it is off as well, bodies are.
    """
    slopes = fit.slopes[list(joints)]
    if len(joints) < _SEVERAL or slopes.min() <= 0.0:
        return False
    if any(fit.joints[j] in BASE_ROWS for j in joints):
        return False
    mean, spread = _mean(slopes), float(slopes.max() / slopes.min())
    return max(mean, 1.0 / mean) >= ONE_GAIN_MEAN and spread <= ONE_GAIN_SPREAD


def _mean(slopes: Vector) -> float:
    """Return the geometric mean of positive slopes."""
    return float(np.exp(np.mean(np.log(slopes))))


def _held_slopes(fit: Fit) -> Vector:
    """Return the largest change of each slope by friction at rest, either way.

    For a joint that mostly rests, the torque at rest is assumed to be as similar to the
    nominal bodies' torque as possible.  NaN where the limit of friction is not known:
    the slope is then not significant.
    """
    rests = fit.moving < IN_MOTION
    share = np.sqrt(np.where(rests, 1.0 - fit.moving, 0.0))
    nominal = np.maximum(fit.expected * fit.torque, np.finfo(float).tiny)
    with np.errstate(over="ignore"):  # bodies without torque: any change
        return np.where(rests, share * fit.holding / nominal, 0.0)


def _alike(slopes: Vector) -> bool:
    """Return whether slopes are off as by one gain.

    This is so if all are far off to the same side, or if the slopes of several joints
    differ by less than the gate.
    """
    far = slopes.min() > SLOPE_FAR or slopes.max() < 1.0 / SLOPE_FAR
    near = slopes.max() / slopes.min() < SLOPE_CARE[1] / SLOPE_CARE[0]
    return bool(far or (near and len(slopes) > 1))


def slopes_of(fit: Fit, joints: Sequence[int]) -> str:
    """Return slopes of joints in words."""
    return ", ".join(f"{fit.joints[j]} {fit.slopes[j]:.2f}" for j in joints)


def where(mask: BoolArray) -> list[int]:
    """Return the indices of true entries."""
    return [int(j) for j in np.flatnonzero(mask)]

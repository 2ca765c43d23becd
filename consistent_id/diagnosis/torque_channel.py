"""The kind of torque in a channel, from its slopes on the parts of the nominal model.

A controller may log torque that is not the joint's: without gravity, without friction,
in amperes, times a gain, of the command, or external torque.  Each kind has a pattern
of slopes.  Nominal inertials may be wrong: if they could explain a slope, the finding
says so.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from consistent_id._support.arrays import BoolArray, Vector
from consistent_id.diagnosis.findings import LogFinding, Severity
from consistent_id.diagnosis.torque_parts import TorqueParts

# Nominal inertials are 10 to 20 % wrong in practice: a slope within these may be one.
_LOW, _HIGH = 0.8, 1.25
_ABSENT = 0.2  # slope below which a part is not in the torque
_THERE = 0.4  # above which it is
_COMMON = 1.15  # ratio within which slopes of joints are equal
_SEVERAL = 3  # joints whose slopes do not agree by chance
# Inertial torque over the model's from which on rotors do not explain it.  They make it
# 1.3 to 2.1 times as large in the first two joints of right logs of four real arms.
_BEYOND_ROTORS = 2.5
_FAR = 2.0  # errors of nominal inertials do not reach this ratio in all joints
_CLEAR = 0.1  # largest standard error over a slope that differs from the others
_EXPLAINED = 0.15  # of the torque: largest misfit of the nominal model's parts
_NO_FRICTION = 0.01  # of the torque: less is no friction
_EXACT = 0.05  # of the torque: largest misfit at which so little friction shows
_UNITS = {1e3: "N mm", 1e-3: "kN m"}
_UNIT = 1.6  # ratio within which a gain is a unit, allowing for model errors


@dataclass(frozen=True, slots=True)
class _Pattern:
    kind: str
    severity: Severity
    applies: Callable[[TorqueParts], bool]
    statement: str
    advice: str


def channel_findings(parts: TorqueParts) -> list[LogFinding]:
    """Find the kind of torque in a channel, if it is not the torque of the model.

    There is at most one finding for all joints; else one for each joint with a wrong
    gain.
    """
    for pattern in _PATTERNS:
        if pattern.applies(parts):
            return [_finding(pattern, parts)]
    return (
        _slow_clock(parts)
        or _common_gain(parts)
        or _currents(parts)
        or _single_gains(parts)
    )


def nothing_findings(parts: TorqueParts) -> list[LogFinding]:
    """Report a torque without any part of the nominal model.

    The motion of another robot looks the same, so other faults are sought first.
    """
    return [_finding(_NOTHING, parts)] if _nothing(parts) else []


def _finding(pattern: _Pattern, parts: TorqueParts) -> LogFinding:
    statement = f"{pattern.statement} ({_slopes(parts)})"
    where = "all joints"
    return LogFinding(
        pattern.kind, pattern.severity, where, statement, pattern.advice, 2.0
    )


def _slopes(p: TorqueParts) -> str:
    """Return the slopes that can be judged, with standard errors, in words."""
    texts = []
    for name, slope, error, shown in (
        ("gravity", p.gravity, p.gravity_error, p.gravity_shown),
        ("inertial part", p.inertial, p.inertial_error, p.inertial_shown),
    ):
        seen = [
            f"{joint} {a:.2f} +- {e:.2f}"
            for joint, a, e, s in zip(p.joints, slope, error, shown, strict=True)
            if s
        ]
        if seen:
            texts.append(f"slope on the nominal {name}: {', '.join(seen)}")
    texts.append(f"friction: {np.median(p.friction):.0%} of the torque")
    return "; ".join(texts)


def _all(values: Vector, shown: BoolArray, low: float, high: float) -> bool:
    """Return whether at least two slopes can be judged and all are within bounds.

    A single joint may have a spring or a counterbalance.
    """
    seen = values[shown]
    return len(seen) >= min(2, len(values)) and bool(
        ((seen >= low) & (seen <= high)).all()
    )


def _explained(p: TorqueParts) -> bool:
    return bool(np.median(p.rest) <= _EXPLAINED)


def _no_gravity(p: TorqueParts) -> bool:
    return (
        _all(p.gravity, p.gravity_shown, -_ABSENT, _ABSENT)
        and _all(p.inertial, p.inertial_shown, _THERE, np.inf)
        and _explained(p)
    )


def _gravity_only(p: TorqueParts) -> bool:
    return (
        _all(p.gravity, p.gravity_shown, _THERE, np.inf)
        and _all(p.inertial, p.inertial_shown, -_ABSENT, _ABSENT)
        and bool((p.friction <= 5 * _NO_FRICTION).all())
        and _explained(p)
    )


def _no_body(p: TorqueParts) -> bool:
    """Return whether a torque lacks the rigid-body part that it should have."""
    return _all(p.gravity, p.gravity_shown, -0.1, 0.1) and _all(
        p.inertial, p.inertial_shown, -0.1, 0.1
    )


def _friction_only(p: TorqueParts) -> bool:
    """Return whether the torque is friction alone.

    Slopes on bodies are also small in kN m.  Rotors add to the inertial part, and
    friction models may contain them.
    """
    most = 2 * max(np.median(p.rest), np.median(p.bodies))
    return (
        _all(p.gravity, p.gravity_shown, -0.1, 0.1)
        and _all(p.inertial, p.inertial_shown, -_ABSENT, _ABSENT)
        and bool(np.median(p.friction) >= most)
    )


def _nothing(p: TorqueParts) -> bool:
    return _no_body(p) and bool(np.median(p.rest) >= 0.8)


def _no_friction(p: TorqueParts) -> bool:
    return bool((p.friction <= _NO_FRICTION).all() and (p.rest <= _EXACT).all()) and (
        _all(p.whole, p.whole_shown, _THERE, 1.0 / _THERE)
    )


_NOTHING = _Pattern(
    "torque channel",
    "fault",
    _nothing,
    "the torque contains neither gravity nor inertia nor friction of the model: it "
    "is external torque or noise, or belongs to another motion",
    "log the torque or current of the motors during this motion",
)

_PATTERNS = (
    _Pattern(
        "torque channel",
        "fault",
        _friction_only,
        "the torque follows the velocity, and neither gravity nor inertia of the "
        "model: it is friction alone, a velocity error or the command of a controller",
        "log the torque or current of the motors",
    ),
    _Pattern(
        "torque channel",
        "fault",
        _no_gravity,
        "the torque contains inertia and friction, but not gravity: it is "
        "gravity-compensated, as some drivers log it, or the model's masses and "
        "gravity are not the robot's",
        "log the whole torque, or add the gravity torque that was subtracted",
    ),
    _Pattern(
        "torque channel",
        "fault",
        _gravity_only,
        "the torque contains gravity, but no inertia or friction: it is the gravity "
        "torque of a model, not a measured one",
        "log the torque or current of the motors",
    ),
    _Pattern(
        "torque channel",
        "warning",
        _no_friction,
        "the torque contains no friction: it is computed or friction-compensated, "
        "or measured behind the gears",
        "bodies can be identified from it; friction and the drives' torque cannot",
    ),
)


def _slow_clock(p: TorqueParts) -> list[LogFinding]:
    """Find inertial torque that is too large by one factor, where gravity is right.

    With a slow clock accelerations are too small by the square of its speed.  Rotors
    add to the inertial torque too, mostly by another factor in each joint.
    """
    slopes, heavy = p.inertial[p.inertial_shown], p.gravity[p.gravity_error <= _CLEAR]
    if len(slopes) < _SEVERAL or not len(heavy) or not _explained(p):
        return []
    common = float(np.median(slopes))
    alike = slopes.min() > 0.0 and slopes.max() <= _COMMON**2 * slopes.min()
    if not alike or common < _HIGH**2 or not _LOW <= np.median(heavy) <= _HIGH:
        return []
    speed = 1.0 / np.sqrt(common)
    rotors, clock = (
        "rotors add the same share to each joint",
        f"the clock runs at {speed:.2g} of its speed",
    )
    sure = common > _BEYOND_ROTORS
    first, second = (clock, rotors) if sure else (rotors, clock)
    return [
        LogFinding(
            "clock",
            "fault" if sure else "warning",
            "time",
            f"inertial torque is {common:.3g} times the model's, but gravity torque is "
            f"not: {first}, or {second} ({_slopes(p)})",
            "check the rate of the log, or the rotor inertias: time multiplied by "
            f"{speed:.2g} would fit",
            float(np.sqrt(common) / _HIGH),
        )
    ]


def _common_gain(p: TorqueParts) -> list[LogFinding]:
    """Find a common factor of all joints."""
    slopes = p.whole[p.whole_shown]
    if len(slopes) < 2 or not _explained(p):
        return []
    gain = float(np.median(slopes))
    heavy = _heavy(p)
    if len(heavy) and _LOW <= float(np.median(heavy)) <= _HIGH:
        return []  # the gravity part is right, only the inertial part is not
    # Slopes are uncertain where friction is large, so that not all have to agree.
    near = np.abs(np.log(np.maximum(slopes / gain, 1e-9))) <= np.log(_COMMON)
    alike = min(near.mean(), _agreeing(p)[p.whole_shown].mean())
    if gain <= 0.0 or alike < 0.75 or _LOW <= gain <= _HIGH:
        return []
    if len(heavy) and not 1 / _COMMON <= np.median(heavy) / gain <= _COMMON:
        return []  # a load adds to the gravity of some joints
    for unit, name in _UNITS.items():
        if 1 / _UNIT < gain / unit < _UNIT:
            statement = (
                f"all torques are {gain:.3g} times the model's: they are {name} "
                f"({_slopes(p)})"
            )
            return [_gain("torque unit", "fault", "all joints", statement, 1 / unit)]
    if gain > 1.0 and not len(heavy):
        return []
    load = "the robot carries a load that the model does not have, " * (gain > 1.0)
    statement = (
        f"all torques are {gain:.3g} times the model's: a gain or a gear ratio is "
        f"missing, {load}or all masses of the model are wrong by this factor "
        f"({_slopes(p)})"
    )
    return [_gain("torque gain", "fault", "all joints", statement, 1 / gain)]


def _currents(p: TorqueParts) -> list[LogFinding]:
    """Find positive factors that differ from joint to joint, all far from one."""
    slopes = p.whole[p.whole_shown]
    if len(slopes) < 2 or not _explained(p) or not (slopes > 0.0).all():
        return []
    heavy = _heavy(p)
    above = len(heavy) > 0 and bool((heavy > _FAR).all())
    far = (slopes < 1.0 / _FAR).all() or (above and (slopes > _FAR).all())
    sure = (p.whole_error <= _CLEAR * abs(p.whole))[p.whole_shown].all()
    unequal = slopes.max() >= _COMMON * slopes.min()
    if not (far and sure and unequal and _agreeing(p).all()):
        return []
    return [
        LogFinding(
            "torque channel",
            "fault",
            "all joints",
            "the torque follows the model with a different factor for each joint: it "
            "is motor currents or torques before the gears, or the model's inertials "
            f"are not the robot's ({_slopes(p)})",
            "give --torque-gain (torque_gain): N m per ampere, gear ratio included, "
            "for each joint",
            float(_FAR),
        )
    ]


def _heavy(p: TorqueParts) -> Vector:
    """Return the slopes on gravity, which show gains above one.

    Rotors of geared motors raise the inertial part, but nothing raises gravity.
    """
    return p.gravity[p.gravity_shown & p.whole_shown]


def _agreeing(p: TorqueParts) -> BoolArray:
    """Return where gravity and inertia have equal slopes, or only one can be judged."""
    both = p.gravity_shown & p.inertial_shown
    small = np.minimum(abs(p.gravity), abs(p.inertial))
    apart = abs(p.gravity - p.inertial) > (_COMMON - 1.0) * small
    return np.asarray(~(both & apart))


def _single_gains(p: TorqueParts) -> list[LogFinding]:
    """Warn of joints whose gravity and inertia have equal slopes other than one."""
    both = p.gravity_shown & p.inertial_shown & _agreeing(p)
    slopes = np.where(both, p.whole, 1.0)
    # With a rotor, only gravity shows a gain above one.  No second part confirms it, so
    # that the nominal mass and centre of mass may be wrong instead.
    high = np.where(p.rotors, _HIGH**2, _HIGH)
    above = np.where(p.rotors, np.minimum(p.gravity, slopes), slopes) > high
    off = both & (slopes > 0.0) & ((slopes < _LOW) | above)
    certain = p.gravity_shown | p.inertial_shown
    if not off.any() or off.sum() > 0.5 * certain.sum():
        return []
    return [
        _gain(
            "torque gain",
            "warning",
            p.joints[j],
            f"{p.joints[j]}: gravity and inertial torque are both {p.whole[j]:.2f} "
            f"(+- {p.whole_error[j]:.2f}) times the model's: its gain is wrong, or the "
            "masses that it carries",
            1.0 / float(p.whole[j]),
        )
        for j in np.flatnonzero(off & (p.rest <= _EXPLAINED))
    ]


def _gain(
    kind: str, severity: Severity, where: str, statement: str, factor: float
) -> LogFinding:
    advice = f"check the gain (times {factor:.3g} would fit), or the model's masses"
    size = f"{1.0 / factor:.3g}"
    return LogFinding(kind, severity, where, statement, advice, 1.5, size=size)

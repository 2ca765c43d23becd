"""What the torque channel is: judged by the parts of the nominal model that it holds.

A controller may log torque that is not the joint's: without gravity, without friction,
in amperes, times a gain, the command's or the external one.  Each has its own pattern
of slopes (`torque_parts`).  The nominal model's inertials may be wrong: what follows as
well from wrong inertials is said as such.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from consistent_id._support.arrays import BoolArray, Matrix, Vector
from consistent_id.diagnosis.findings import LogFinding, Severity
from consistent_id.diagnosis.linearise import Fitted, jackknife
from consistent_id.recordings.recording import Recording
from consistent_id.regression.drive.laws import RotorInertia, Spring
from consistent_id.regression.drive.term import DriveTerm
from consistent_id.regression.regressor import TorqueModel
from consistent_id.robot.scaling import reference_bodies

_CREEP = 0.02  # rad/s or m/s, of the smooth Coulomb term
# Of what changes in the torque: a part that is expected to be, or is, so large counts.
# What is constant, as the weight that a sliding trunk carries, is an offset as well.
_SHOWN = 0.3
_SURE = 0.15  # standard error of a slope over the slope's scale that can be judged


@dataclass(frozen=True, slots=True, eq=False)
class TorqueParts:
    """Slopes on the parts of the nominal model, per torque joint.

    Parameters
    ----------
    gravity, inertial, whole : ndarray, shape (joints,)
        Slopes on the gravity torque, on the inertial torque (Coriolis included), and on
        their sum.
    gravity_error, inertial_error, whole_error : ndarray, shape (joints,)
        Standard errors, by leaving segments out: residual correlation is counted.
    gravity_shown, inertial_shown, whole_shown : ndarray of bool, shape (joints,)
        Whether the part is large enough, and the slope sure enough, to be judged.
    friction : ndarray, shape (joints,)
        Root mean square of the friction's part over the torque's standard deviation.
    bodies : ndarray, shape (joints,)
        Root mean square of what changes in the bodies' parts, as fitted, likewise.
    rest : ndarray, shape (joints,)
        What no part explains, likewise.
    rotors : ndarray of bool, shape (joints,)
        Whether the model has a rotor there, which adds to the inertial part.
    """

    joints: tuple[str, ...]
    gravity: Vector
    gravity_error: Vector
    gravity_shown: BoolArray
    inertial: Vector
    inertial_error: Vector
    inertial_shown: BoolArray
    whole: Vector
    whole_error: Vector
    whole_shown: BoolArray
    friction: Vector
    bodies: Vector
    rest: Vector
    rotors: BoolArray


def torque_parts(model: TorqueModel, prepared: Recording) -> TorqueParts:
    """Regress a prepared log's torque on the parts of the nominal model."""
    g, inertial = nominal_parts(model, prepared)
    log = prepared.of(model.torque_joints)
    torque, speed = np.asarray(log.torque), np.asarray(log.velocity)
    sprung, rotors = _having(model, Spring), _having(model, RotorInertia)
    rows = [
        (
            *_of_joint(
                g[:, j],
                inertial[:, j],
                speed[:, j],
                torque[:, j],
                log.position[:, [j]] if joint in sprung else None,
            ),
            joint in rotors,
        )
        for j, joint in enumerate(model.torque_joints)
    ]
    return TorqueParts(model.torque_joints, *map(np.array, zip(*rows, strict=True)))


def nominal_parts(model: TorqueModel, prepared: Recording) -> tuple[Matrix, Matrix]:
    """Return gravity and inertial torque of the nominal robot, (samples, joints)."""
    rigid = TorqueModel(model.robot, torque_joints=model.torque_joints)
    bodies = reference_bodies(model.robot).ravel()
    log = prepared.of(model.robot.joint_names)
    rates = np.asarray(log.velocity), np.asarray(log.acceleration)
    gravity = rigid.rigid_torque(bodies, (log.position, None, None))
    whole = rigid.rigid_torque(bodies, (log.position, *rates))
    return gravity, whole - gravity


def _having(model: TorqueModel, law: type[DriveTerm]) -> set[str]:
    """Return the joints whose drive the model gives a term, such as a spring."""
    return {
        joint
        for joint, drive in zip(model.robot.joint_names, model.terms, strict=True)
        if any(isinstance(term, law) for term in drive.terms)
    }


def _of_joint(
    g: Vector, inertial: Vector, speed: Vector, torque: Vector, spring: Matrix | None
) -> tuple[float | bool, ...]:
    changing = float(np.std(torque)) or 1.0
    friction = [speed, np.tanh(speed / _CREEP), np.ones_like(speed)]
    friction += [] if spring is None else [spring]
    parts = np.column_stack([g, inertial, *friction])
    fit = _fitted(parts, torque)
    whole = _fitted(np.column_stack([g + inertial, *friction]), torque)
    a, b = fit.solution[:2]
    rubbed = parts[:, 2:4] @ fit.solution[2:4]
    return (
        *_judged(a, fit.errors[0], g, changing),
        *_judged(b, fit.errors[1], inertial, changing),
        *_judged(whole.solution[0], whole.errors[0], g + inertial, changing),
        float(np.sqrt(np.mean(rubbed**2))) / changing,
        float(np.std(parts[:, :2] @ fit.solution[:2])) / changing,
        fit.misfit / (changing * float(np.sqrt(len(torque)))),
    )


def _judged(
    slope: float, error: float, part: Vector, changing: float
) -> tuple[float, float, bool]:
    """Return a slope, its standard error, and whether it can be judged."""
    size = float(np.std(part))
    large = max(1.0, abs(slope)) * size >= _SHOWN * changing
    # Of a torque in other units, a slope is known beside what would fill the torque.
    scale = max(abs(slope), min(1.0, changing / size if size > 0.0 else 1.0))
    return float(slope), float(error), bool(large and error <= _SURE * scale)


def _fitted(columns: Matrix, torque: Vector) -> Fitted:
    return jackknife(columns[None], torque[None]).fitted(list(range(columns.shape[1])))


# Nominal inertials are 10 to 20 % off in practice, so that a slope within these is one.
_LOW, _HIGH = 0.8, 1.25
_ABSENT = 0.2  # slope below which a part is not in the torque
_THERE = 0.4  # above which it is
_COMMON = 1.15  # ratio within which the slopes of joints are equal
_SEVERAL = 3  # joints that do not agree by chance
_FAR = 2.0  # ratio to one that no drawing's error reaches in all joints
_CLEAR = 0.1  # standard error over a slope that is a factor of its own
_EXPLAINED = 0.15  # of the torque, that the nominal model's parts may leave
_NO_FRICTION = 0.01  # of the torque: friction that is not in it
_EXACT = 0.05  # of the torque: misfit beside which so little friction would show
_UNITS = {1e3: "N mm", 1e-3: "kN m"}
_UNIT = 1.6  # ratio within which a gain is a unit: friction and drawing considered


@dataclass(frozen=True, slots=True)
class _Pattern:
    kind: str
    severity: Severity
    applies: Callable[[TorqueParts], bool]
    statement: str
    advice: str


def channel_findings(parts: TorqueParts) -> list[LogFinding]:
    """Say what the torque channel is, where it is not the torque of the model.

    One finding at most for all joints; else one for each joint whose gain is off.
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
    """Say that nothing of the nominal model is in the torque, if that is so.

    Motion that is not the robot's looks the same: to be asked last.
    """
    return [_finding(_NOTHING, parts)] if _nothing(parts) else []


def _finding(pattern: _Pattern, parts: TorqueParts) -> LogFinding:
    statement = f"{pattern.statement} ({_slopes(parts)})"
    where = "all joints"
    return LogFinding(
        pattern.kind, pattern.severity, where, statement, pattern.advice, 2.0
    )


def _slopes(p: TorqueParts) -> str:
    """Return the slopes that can be judged, with their standard errors."""
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
    """Return whether slopes that can be judged are within bounds; there are two.

    One joint alone may have a spring or a counterbalance.
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
    """Return whether nothing of a rigid body is in a torque that should have it."""
    return _all(p.gravity, p.gravity_shown, -0.1, 0.1) and _all(
        p.inertial, p.inertial_shown, -0.1, 0.1
    )


def _friction_only(p: TorqueParts) -> bool:
    """Return whether friction is all there is: in kN m, slopes on bodies are small.

    Rotors, which a friction model may hold, add to the inertial part.
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
    "is external torque, noise, or belongs to another motion",
    "log the torque, or the current, that the motors gave, during this motion",
)

_PATTERNS = (
    _Pattern(
        "torque channel",
        "fault",
        _friction_only,
        "the torque follows the velocity, and neither gravity nor inertia of the "
        "model: it is friction alone, a velocity error or the command of a controller",
        "log the torque, or the current, that the motors gave",
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
        "log the torque, or the current, that the motors gave",
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

    By a clock that runs at a share of its speed, accelerations are too small by its
    square.  Rotors add to the inertial torque too, but to that of each joint otherwise.
    """
    slopes, heavy = p.inertial[p.inertial_shown], p.gravity[p.gravity_error <= _CLEAR]
    if len(slopes) < _SEVERAL or not len(heavy) or not _explained(p):
        return []
    common = float(np.median(slopes))
    alike = slopes.min() > 0.0 and slopes.max() <= _COMMON**2 * slopes.min()
    if not alike or common < _HIGH**2 or not _LOW <= np.median(heavy) <= _HIGH:
        return []
    speed = 1.0 / np.sqrt(common)
    return [
        LogFinding(
            "clock",
            "fault",
            "time",
            f"inertial torque is {common:.3g} times the model's in all joints, but "
            f"gravity torque is not: the clock runs at {speed:.2g} of its speed, or "
            f"rotors add as much to each joint ({_slopes(p)})",
            f"check the rate of the log: its time multiplied by {speed:.2g} would fit",
            float(np.sqrt(common) / _HIGH),
        )
    ]


def _common_gain(p: TorqueParts) -> list[LogFinding]:
    """Find a factor that all joints share."""
    slopes = p.whole[p.whole_shown]
    if len(slopes) < 2 or not _explained(p):
        return []
    gain = float(np.median(slopes))
    heavy = _heavy(p)
    if len(heavy) and _LOW <= float(np.median(heavy)) <= _HIGH:
        return []  # gravity is as it should be: what is off is the inertial part
    # Where friction is large, the body's part is the less sure: half of the joints.
    near = np.abs(np.log(np.maximum(slopes / gain, 1e-9))) <= np.log(_COMMON)
    alike = min(near.mean(), _agreeing(p)[p.whole_shown].mean())
    if gain <= 0.0 or alike < 0.75 or _LOW <= gain <= _HIGH:
        return []
    if len(heavy) and not 1 / _COMMON <= np.median(heavy) / gain <= _COMMON:
        return []  # a load adds to the gravity of some joints
    for unit, name in _UNITS.items():
        if 1 / _UNIT < gain / unit < _UNIT:
            statement = f"all torques are {gain:.3g} times the model's: they are {name}"
            return [_gain("torque unit", "fault", "all joints", statement, 1 / unit, p)]
    if gain > 1.0 and not len(heavy):
        return []
    load = "the robot carries a load that the model does not have, " * (gain > 1.0)
    statement = (
        f"all torques are {gain:.3g} times the model's: a gain or a gear ratio is "
        f"missing, {load}or all masses of the model are wrong by this factor"
    )
    return [_gain("torque gain", "fault", "all joints", statement, 1 / gain, p)]


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
            "the torque follows the model with another factor for each joint: it is "
            "motor currents or torques before the gears, or the model's inertials are "
            f"not the robot's ({_slopes(p)})",
            "give --torque-gain (torque_gain): N m per ampere, gear ratio included, "
            "for each joint",
            float(_FAR),
        )
    ]


def _heavy(p: TorqueParts) -> Vector:
    """Return the slopes on gravity by which a gain above one can be told.

    Rotors of geared motors raise the inertial part, and nothing raises gravity.
    """
    return p.gravity[p.gravity_shown & p.whole_shown]


def _agreeing(p: TorqueParts) -> BoolArray:
    """Return where gravity and inertia have one slope, or only one of them shows."""
    both = p.gravity_shown & p.inertial_shown
    small = np.minimum(abs(p.gravity), abs(p.inertial))
    apart = abs(p.gravity - p.inertial) > (_COMMON - 1.0) * small
    return np.asarray(~(both & apart))


def _single_gains(p: TorqueParts) -> list[LogFinding]:
    """Warn of joints whose gravity and inertia have one slope, and not one."""
    both = p.gravity_shown & p.inertial_shown & _agreeing(p)
    slopes = np.where(both, p.whole, 1.0)
    # Beside a rotor, gravity alone tells of a gain above one.  No second part agrees
    # with it then, so that a drawing's mass and centre may both be off.
    high = np.where(p.rotors, _HIGH**2, _HIGH)
    above = np.where(p.rotors, np.minimum(p.gravity, slopes), slopes) > high
    off = both & (slopes > 0.0) & ((slopes < _LOW) | above)
    judged = p.gravity_shown | p.inertial_shown
    if not off.any() or off.sum() > 0.5 * judged.sum():
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
            p,
        )
        for j in np.flatnonzero(off & (p.rest <= _EXPLAINED))
    ]


def _gain(
    kind: str,
    severity: Severity,
    where: str,
    statement: str,
    factor: float,
    parts: TorqueParts,
) -> LogFinding:
    advice = f"check the gain (times {factor:.3g} would fit), or the model's masses"
    if where == "all joints":
        statement = f"{statement} ({_slopes(parts)})"
    return LogFinding(kind, severity, where, statement, advice, 1.5)

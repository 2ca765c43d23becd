"""Values beyond what a model states: travel, speed and torque; impossible models.

Far beyond its limits, they are in other units.
"""

import shlex

import numpy as np

from consistent_id._support.arrays import BoolArray, Vector
from consistent_id._support.tables import some_of
from consistent_id.diagnosis.clock import velocity_findings
from consistent_id.diagnosis.findings import FoundUnit, LogFinding
from consistent_id.errors import RecordingError
from consistent_id.recordings.readers.units import COUNTS, Units
from consistent_id.recordings.recording import Recording, velocities
from consistent_id.recordings.signals.drive_limits import SPEED_ROUNDING, beyond_speed
from consistent_id.robot.model import RobotModel
from consistent_id.robot.scaling import placeholders

_TRAVEL = 2.0  # times the range of a joint's limits: more than careless limits err
_ONE_TRAVEL = 5.0  # the same for a single joint, whose limits may be a guess
_MOST = 0.5  # of the joints
_DEGREES = 180.0 / np.pi
_LENGTHS = {"mm": 1e-3, "cm": 1e-2}
_TURN = 360.0  # degrees

_BITS = range(9, 25)  # of encoders that count a turn from zero

_USUAL = 0.95  # quantile of the absolute torque, which a few outliers do not move
_TORQUE = 10.0  # times the effort limit: more than careless limits err
# Times the share of any other joint.  Limits may be equal placeholders for joints that
# carry 1 to 1000 N m; a torque in N mm is a thousand times too large.
_ONE_TORQUE = 100.0
_EVERY_TORQUE = 3.0  # times every limit, if limits differ and so are no placeholders


def travel_findings(robot: RobotModel, log: Recording) -> list[LogFinding]:
    """Find travel far beyond the limits of joints.

    If most joints travel too far, all are in another unit, see `travel_unit`.  If few
    do, each of these has a unit of its own.

    Parameters
    ----------
    log : Recording
        With the robot's joints, in their order.
    """
    slid = [
        _travel_of_sliding(name, share)
        for name, share in zip(*_shares_of_limits(robot, log, "prismatic"), strict=True)
        if share > _ONE_TRAVEL
    ]
    if (unit := travel_unit(robot, log)) is not None:
        return [unit.finding, *slid]
    names, share = _shares_of_limits(robot, log)
    alone = share > _ONE_TRAVEL
    if alone.sum() > _MOST * len(share):
        return slid
    places = np.flatnonzero(alone)
    return [*(_travel_of_one(names[j], float(share[j])) for j in places), *slid]


def travel_unit(robot: RobotModel, log: Recording) -> FoundUnit | None:
    """Return the unit of positions of which most travel far beyond joints' limits.

    Degrees where that fits, else counts of encoders, which are whole numbers.

    Parameters
    ----------
    log : Recording
        With the robot's joints, in their order.
    """
    _, share = _shares_of_limits(robot, log)
    beyond = share > _TRAVEL
    if beyond.sum() <= _MOST * len(share):
        return None
    whole = bool((log.position == np.round(log.position)).all())
    degrees = share.max() <= _DEGREES
    if whole and degrees and abs(log.position).max() <= _TURN:
        return _travel_in_either(share, beyond)
    if degrees and not whole:
        return _travel_in_degrees(share, beyond)
    if whole or np.median(share) > _DEGREES:
        return _travel_in_counts(share[beyond], log)
    return None


def _shares_of_limits(
    robot: RobotModel, log: Recording, kind: str = "revolute"
) -> tuple[tuple[str, ...], Vector]:
    """Return the limited joints of a kind, and their travel over its limits' range."""
    limits = [joint.limits for joint in robot.driven]
    width = np.array([limit.upper - limit.lower for limit in limits])
    alike = np.array([joint.kind == kind for joint in robot.driven])
    limited = alike & np.isfinite(width) & (width > 0.0)
    share = np.ptp(log.position, axis=0)[limited] / width[limited]
    return tuple(np.array(robot.joint_names)[limited].tolist()), share


def _travel_in_degrees(share: Vector, beyond: BoolArray) -> FoundUnit:
    options = "--units deg"
    finding = LogFinding(
        "degrees",
        "fault",
        "all joints",
        f"joints travel up to {share.max():.3g} times the range of their limits, "
        f"and {share.max() / _DEGREES:.0%} of it if positions are in degrees",
        f"read them as degrees ({options}), or multiply positions and velocities by "
        "pi / 180",
        float(np.median(share[beyond])) / _TRAVEL,
    )
    return FoundUnit(finding, options)


def _travel_in_either(share: Vector, beyond: BoolArray) -> FoundUnit:
    finding = LogFinding(
        "degrees",
        "fault",
        "all joints",
        f"joints travel up to {share.max():.3g} times the range of their limits in "
        "whole numbers: they are degrees without decimals (--units deg), or counts of "
        f"encoders (--units position=rev/{COUNTS})",
        "state which of the two they are",
        float(np.median(share[beyond])) / _TRAVEL,
    )
    return FoundUnit(finding, "")


def _travel_in_counts(share: Vector, log: Recording) -> FoundUnit:
    # A velocity that is the position's rate is in the same counts.
    both = log.velocity is not None and not velocity_findings(log)
    options = units = _units_of_counts(COUNTS, both)
    zeros, likely = "--position-offset JOINT=VALUE", ""
    where = f"where the log's zero is, in rad ({zeros})"
    if counts := _counts_of_a_turn(log):
        units = _units_of_counts(str(counts), both)
        middle = (shlex.quote(f"{joint}={-np.pi:.6g}") for joint in log.joints)
        zeros = f"--position-offset {' '.join(middle)}"
        options = f"{units} {zeros}"
        likely = (
            f", of {counts} a turn if that is the next power of two, with zero in the "
            "middle; the encoder's datasheet says"
        )
        where = f"where the log's zero is: in the middle of their range, if {zeros}"
    finding = LogFinding(
        "encoder scale",
        "fault",
        "all joints",
        f"joints travel {share.min():.3g} to {share.max():.3g} times the range of "
        f"their limits: positions are counts of encoders{likely}",
        f"state the counts of a turn of the joint ({units}), and {where}",
        float(np.median(share)) / _TRAVEL,
    )
    return FoundUnit(finding, options)


def _units_of_counts(counts: str, with_velocity: bool) -> str:
    of_velocity = f" velocity=rev/{counts}/s" * with_velocity
    return f"--units position=rev/{counts}{of_velocity}"


def _counts_of_a_turn(log: Recording) -> int:
    """Return the power of two that whole positions from zero on stay below; else 0."""
    position = log.position
    if (position != np.round(position)).any() or position.min() < 0.0:
        return 0
    bits = int(np.ceil(np.log2(position.max() + 1.0)))
    return 2**bits if bits in _BITS else 0


def _travel_of_one(joint: str, share: float) -> LogFinding:
    return LogFinding(
        "encoder scale",
        "fault",
        joint,
        f"{joint} travels {share:.3g} times the range of its limits, as most "
        f"joints do not: {share / _DEGREES:.2g} times if its position is in degrees",
        "check unit and gear ratio of its position and velocity (--position-scale "
        f"{joint}=FACTOR), or correct its limits",
        share / _ONE_TRAVEL,
    )


def _travel_of_sliding(joint: str, share: float) -> LogFinding:
    return LogFinding(
        "encoder scale",
        "fault",
        joint,
        f"{joint} slides {share:.3g} times the range of its limits, which are in m: "
        f"{share / 1000.0:.2g} times if its position is in mm",
        f"state its unit alone (--position-scale {joint}=0.001 for mm), or correct its "
        "limits",
        share / _ONE_TRAVEL,
    )


def require_lengths_of_sliding(robot: RobotModel, units: Units) -> None:
    """Refuse one unit of length for the positions of joints of which some turn.

    Raises
    ------
    RecordingError
        With these joints, and the options for those that slide.
    """
    unit = units.get("position", "")
    turning = [joint.name for joint in robot.driven if joint.kind == "revolute"]
    if not isinstance(unit, str) or unit not in _LENGTHS or not turning:
        return
    sliding = [joint.name for joint in robot.driven if joint.kind == "prismatic"]
    scales = " ".join(f"{name}={_LENGTHS[unit]:g}" for name in sliding)
    do = f"; leave it out, and state --position-scale {scales}" * bool(sliding)
    raise RecordingError(
        f"positions are stated to be in {unit}, but {some_of(turning)} turn{do}"
    )


def effort_findings(robot: RobotModel, torque: Recording) -> list[LogFinding]:
    """Find torque far beyond effort limits, of all joints or of a single one.

    Parameters
    ----------
    torque : Recording
        With the joints whose torque is examined.
    """
    limits = {joint.name: joint.limits.effort for joint in robot.driven}
    known = [name for name in torque.joints if 0.0 < limits[name] < np.inf]
    if len(known) < 2:
        return []
    usual = np.quantile(abs(np.asarray(torque.of(known).torque)), _USUAL, axis=0)
    most = np.array([limits[name] for name in known])
    shares = usual / most
    if (
        np.ptp(most) > 0.0
        and shares.min() > _EVERY_TORQUE
        and np.median(shares) > _TORQUE
    ):
        return [_torques_of_all(shares)]
    j = int(np.argmax(shares))
    share, others = float(shares[j]), float(np.delete(shares, j).max())
    if share <= _TORQUE or share <= _ONE_TORQUE * others:
        return []
    return [
        LogFinding(
            "torque unit",
            "fault",
            known[j],
            f"{known[j]}: the torque is up to {share:.3g} times the effort limit, in "
            f"other joints at most {others:.2g} times: it is in another unit, "
            f"{share / 1e3:.2g} times the limit if in N mm",
            f"check the unit and the gain of {known[j]}, or correct its effort limit",
            share / _TORQUE,
        )
    ]


_SMALL_UNITS = {"Ncm": 1e-2, "mNm": 1e-3}  # as the option states them
_ABOVE_LIMIT = 1.2  # usual torque over limits, which are rounded down


def _torques_of_all(shares: Vector) -> LogFinding:
    typical = float(np.median(shares))
    within = [u for u, f in _SMALL_UNITS.items() if f * shares.max() <= _ABOVE_LIMIT]
    option = f"--units torque={within[0]}" if within else f"times {1.0 / typical:.1g}"
    return LogFinding(
        "torque unit",
        "fault",
        "all joints",
        f"torques are {shares.min():.3g} to {shares.max():.3g} times the effort "
        "limits: they are in another unit, a gain is missing, or the limits are wrong",
        f"check unit and gain ({option}?), or correct the limits",
        typical / _TORQUE,
    )


_FAST = 0.01  # of the samples


def speed_findings(robot: RobotModel, prepared: Recording) -> list[LogFinding]:
    """Find joints that are faster than their speed limits for a part of the log.

    Limits that are equal for all joints may be placeholders: that is only a note.

    Parameters
    ----------
    prepared : Recording
        With the robot's joints and velocity, filtered.  Samples whose torque is left
        out do not count.
    """
    joints = [joint for joint in robot.driven if joint.name in prepared.joints]
    limits = np.array([joint.limits.velocity for joint in joints])
    names = tuple(joint.name for joint in joints)
    log = prepared.of(names)
    beyond = beyond_speed(log, SPEED_ROUNDING * limits)
    if log.torque_known is not None:
        beyond = beyond & log.torque_known
    shares = beyond.mean(axis=0)
    fast = np.flatnonzero(shares >= _FAST)
    if not len(fast):
        return []
    most = np.where(beyond, abs(velocities(log)), 0.0).max(axis=0)[fast] / limits[fast]
    said = ", ".join(
        f"{names[j]} up to {times:.3g} times, in {shares[j]:.0%} of the samples"
        for j, times in zip(fast, most, strict=True)
    )
    alike = len(limits) > 1 and float(np.ptp(limits)) == 0.0
    return [
        LogFinding(
            "speed limit",
            "note" if alike else "warning",
            ", ".join(names[j] for j in fast),
            f"joints are faster than the model's speed limits: {said}",
            "check the unit of the clock, and the limits; if both are right, leave "
            "these samples out, as drives lack voltage there: --most-joint-speed model "
            '(most_joint_speed = "model" in [data.preparation])',
            float(shares.max()) / _FAST,
        )
    ]


_FAR = 50.0  # m between neighbouring joints: more than any robot has
_HEAVY = 2.3e4  # kg/m^3: osmium, the densest metal


def model_findings(robot: RobotModel) -> list[LogFinding]:
    """Find faults of a model, without a log."""
    return _lengths(robot) or _masses(robot) or _placeholders(robot)


def _lengths(robot: RobotModel) -> list[LogFinding]:
    farthest = max(float(np.linalg.norm(j.translation)) for j in robot.joints)
    if farthest < _FAR:
        return []
    return [
        LogFinding(
            "units",
            "fault",
            "model",
            f"two joints of the model are {farthest:.4g} m apart: its lengths are in "
            "millimetres",
            "divide lengths by 1000, and inertias by 1e6",
            farthest / _FAR,
        )
    ]


def _masses(robot: RobotModel) -> list[LogFinding]:
    """Find links that are denser than any metal."""
    dense = []
    for link in robot.links:
        body = link.nominal
        if body is None or body.mass <= 0.0:
            return []
        # Density of a box with this mass and inertia; a shell or a frame is less dense.
        central = np.linalg.eigvalsh(body.central_inertia)
        sides = 12.0 * (central.sum() / 2.0 - central) / body.mass
        if (sides <= 0.0).any():
            return []
        dense.append(body.mass / float(np.sqrt(np.prod(sides))))
    if min(dense) < _HEAVY or len(dense) < 2 or min(dense) > 1e3 * _HEAVY:
        return []
    return [
        LogFinding(
            "units",
            "fault",
            "model",
            f"bodies with the masses and inertias of the model's links are denser than "
            f"{_HEAVY:.3g} kg/m^3, the densest metal: its masses are in grams",
            "divide masses and inertias by 1000",
            min(dense) / _HEAVY,
        )
    ]


def _placeholders(robot: RobotModel) -> list[LogFinding]:
    if not placeholders(robot):
        return []
    said = "the same mass and inertia: they are placeholders"
    advice = (
        "write the masses of the datasheet into the robot's file, or leave masses free "
        '(masses = "free", --masses free); if the links are alike, --accept '
        '"placeholder inertials"'
    )
    if not any(link.nominal and link.nominal.mass for link in robot.links):
        said = "no mass and no inertia: the log alone says what they are"
        advice = "state masses that are known, such as those of the datasheet"
    return [
        LogFinding(
            "placeholder inertials",
            "warning",
            "model",
            f"all {len(robot)} links of the model have {said}",
            advice,
            2.0,
        )
    ]

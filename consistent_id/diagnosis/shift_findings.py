"""What is said of zeros and gains that are off, and of torque that lags."""

from dataclasses import replace

import numpy as np

from consistent_id.diagnosis.findings import LogFinding
from consistent_id.diagnosis.linearise import Linearised
from consistent_id.diagnosis.small_shifts import SURE, Moved, estimate_lag, small_shifts
from consistent_id.regression.regressor import TorqueModel
from consistent_id.robot.model import Joint

_BLIND = 10.0  # times these sizes, from which on a zero that hides is worth a note
_LAG = 0.012  # s: less is what filters of currents do
LONG = 0.04  # s: a drive's filters and a bus reach 15 to 40 ms in real robots
_LATE = 0.05  # s: more makes estimates wrong
# Of the torque, that a shorter lag changes: in real robots filters of currents reach
# 0.03, in their usual motions.
_EFFECT = 0.04


def shift_findings(model: TorqueModel, moved: Moved) -> list[LogFinding]:
    """Report zeros and gains that are off.

    Where zeros and gains explain a log alike, neither is named as the cause.
    """
    found = []
    for k in np.flatnonzero(moved.sizes):
        finding = _shift(model, moved, int(k))
        others = [_shift(model, moved, i) for i in moved.rivals.get(int(k), ())]
        names = ", ".join(dict.fromkeys(f.where for f in (finding, *others)))
        if {f.kind for f in others} - {finding.kind}:
            finding = replace(
                finding,
                kind="model does not explain",
                where=names,
                statement=f"{finding.statement}; or what looks alike: {names}",
            )
        elif others:
            finding = replace(
                finding,
                where=names,
                statement=f"{finding.statement}; or another of {names} is off instead",
            )
        found.append(finding)
    return found


def _shift(model: TorqueModel, moved: Moved, place: int) -> LogFinding:
    joints = model.robot.driven
    size, score = float(moved.sizes[place]), float(moved.scores[place])
    if place < len(joints):
        return _zero(joints[place], size, score)
    return _gain(model.torque_joints[place - len(joints)], size, score)


def hidden_zeros(model: TorqueModel, moved: Moved) -> list[LogFinding]:
    """Note the joints whose zero offset the recordings do not identify."""
    joints = model.robot.driven
    reach = SURE * moved.shifts.errors
    hidden = [
        f"{joint.name} ({_from_where(joint, size)})"
        for joint, size, least in zip(joints, reach, small_shifts(model), strict=False)
        if size >= _BLIND * least
    ]
    if not hidden:
        return []
    return [
        LogFinding(
            "hidden zero",
            "note",
            "some joints",
            f"the log does not identify the zero offsets of {', '.join(hidden)}",
            "if they matter, move more widely and faster; no motion identifies the "
            "zero of an axis along gravity at the base, nor that of the last joint",
        )
    ]


def _from_where(joint: Joint, size: float) -> str:
    if joint.kind == "prismatic":
        return f"below {size:.2g} m" if np.isfinite(size) else "any length"
    degrees = float(np.degrees(size))
    return f"below {degrees:.2g} degrees" if degrees < 90.0 else "any angle"


def _zero(joint: Joint, d: float, score: float) -> LogFinding:
    slides = joint.kind == "prismatic"
    size = f"{abs(d):.2g} m" if slides else f"{np.degrees(abs(d)):.2g} degrees"
    larger, change = ("larger", "add {} to") if d > 0.0 else ("smaller", "take {} from")
    return LogFinding(
        "offset zero",
        "fault",
        joint.name,
        f"{joint.name}: its torque fits a position some {size} {larger}",
        f"{change.format(size)} the position of {joint.name}, or calibrate its zero; "
        "check again afterwards",
        float(score),
    )


def _gain(joint: str, c: float, score: float) -> LogFinding:
    return LogFinding(
        "torque gain",
        "fault",
        joint,
        f"{joint}: its torque is {1.0 + c:.3g} times what the other joints' torque "
        "says",
        f"check the gain and gear ratio of {joint} (times {1.0 / (1.0 + c):.3g} would "
        "fit)",
        float(score),
    )


def lag_findings(system: Linearised) -> list[LogFinding]:
    """Report torque that is later or earlier than the motion."""
    fit = estimate_lag(system)
    lag, error = abs(float(fit.solution[0])), float(fit.errors[0])
    score = min(lag / _LAG, lag / (SURE * error))
    if score < 1.0:
        return []
    effect = lag * system.quickness
    matters = lag >= LONG or effect >= _EFFECT
    later = "later" if fit.solution[0] > 0.0 else "earlier"
    return [
        LogFinding(
            "lag",
            "fault" if lag >= _LATE else "warning" if matters else "note",
            "all joints",
            f"the torque is {1e3 * lag:.3g} ms {later} than the motion, which changes "
            f"it by {effect:.1%}",
            "shift torque or motion in time before filtering",
            score,
        )
    ]

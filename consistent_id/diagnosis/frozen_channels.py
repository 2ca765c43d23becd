"""Channels that stand still while the robot moves, and logs that stand still."""

from dataclasses import replace

import numpy as np

from consistent_id._support.arrays import Vector
from consistent_id.diagnosis.findings import LogFinding
from consistent_id.diagnosis.signal_faults import (
    COARSE_TORQUE,
    MOVING,
    position_steps,
    step_of,
)
from consistent_id.recordings.recording import Recording, instant

_REPEATS = 0.02  # share of rows that repeat others: a fault
_FROZEN = 0.1  # share of the log with one constant value that is reported
_STEPS = 2.0  # of the encoder, within which a position stays constant
_UNIFORM = 0.05  # share of the way by which a joint at one speed leaves its line
_WHOLE = 0.2  # s for which all channels stay as they are,
_ENOUGH = 100  # samples in motion, which show what changes of speed are usual,
_SUDDEN = 5.0  # times a large change of speed in one sample: the log stood, no robot
_FEW = 10  # samples that show no noise
_GROWS = 2.0  # growth of differences by two orders: 3.4 of white noise
_ROUNDED = 2.0  # second difference over rounding that is more than this: noise
_ROUNDING = 1e-9  # of the largest value: rounding, at least
_ONE_STEP = 1.5  # steps between one and two
_OF_POSITIONS = ("encoder scale", "degrees", "position sign", "offset zero")
_CONSTANT = 1e-9  # rad or m: rounding of a filter
_TINY = 1e-300  # s^2: least divisor


def frozen_findings(recording: Recording) -> list[LogFinding]:
    """Find channels that stay constant for a part of the log while the joint moves.

    A joint at one speed has one velocity, and its torque may be one, too, unless it is
    noisy elsewhere.
    """
    moved = recording.position
    if recording.velocity is not None:
        steps = np.diff(recording.time, prepend=recording.time[0])
        moved = np.cumsum(recording.velocity * steps[:, None], axis=0)
    found = []
    least = np.maximum(MOVING, _STEPS * position_steps(recording))
    for k, joint in enumerate(recording.joints):
        for name in ("torque", "position", "velocity"):
            values = getattr(recording, name)
            if values is None:
                continue
            motion = (moved if name == "position" else recording.position)[:, k]
            for run in _constant_runs(values[:, k]):
                path = motion[run] - motion[run.start]
                if not _constant_as_it_is(
                    name, values[:, k], run, path, recording.time[run], least[k]
                ):
                    value = float(values[run.start, k])
                    found.append(_frozen(recording, joint, name, run, value))
                    break
    return found


def _constant_as_it_is(
    name: str, values: Vector, run: slice, path: Vector, time: Vector, least: float
) -> bool:
    """Return whether the robot itself, a limit or coarse steps keep values constant.

    Parameters
    ----------
    path : ndarray, [rad or m]
        The way of the joint in this run, by another channel.
    least : float, [rad or m]
        A longer way is motion.
    """
    value, still = float(values[run.start]), float(np.ptp(path)) < least
    passed = time - time[0]
    if name == "velocity":
        return still or _follows(path, value * passed, least)
    if name == "position":
        return still
    if _at_limit(values, value) or _between_steps(values, run):
        return True
    # A torque that is always constant is dead, whether the joint moves or not.
    if run.stop - run.start == len(values):
        return False
    if still or value == 0.0 or _noisy(values):
        return still
    speed = float(path @ passed / max(float(passed @ passed), _TINY))
    return _follows(path, speed * passed, least)


def _follows(path: Vector, line: Vector, least: float) -> bool:
    """Return whether a joint moves along a line."""
    return float(np.ptp(path - line)) < max(least, _UNIFORM * float(np.ptp(path)))


def _noisy(values: Vector) -> bool:
    """Return whether a signal has white noise, but for runs of equal values.

    Differences of white noise grow with their order; those of smooth signals shrink.
    """
    changing = np.ones(len(values), dtype=np.bool_)
    for run in _constant_runs(values):
        changing[run] = False
    others = values[changing]
    if len(others) < _FEW:
        return False
    second, fourth = (np.median(abs(np.diff(others, n))) for n in (2, 4))
    rounding = max(step_of(values), _ROUNDING * float(abs(values).max()))
    return bool(fourth > _GROWS * second and second > _ROUNDED * rounding)


def _constant_runs(values: Vector) -> list[slice]:
    """Return the runs of equal values that are long enough to be reported."""
    edges = np.flatnonzero(np.diff(values) != 0.0) + 1
    ends = np.concatenate([[0], edges, [len(values)]])
    long = np.flatnonzero(np.diff(ends) >= _FROZEN * len(values))
    return [slice(int(ends[k]), int(ends[k + 1])) for k in long]


def _at_limit(values: Vector, value: float) -> bool:
    """Return whether a torque stays at a limit, where it is cut off.

    No torque is larger.  If only one sign is limited, the torque leaves the limit and
    comes back to it; a frozen channel does not.
    """
    if abs(value) >= abs(values).max() > 0.0:
        return True
    at = values == value
    stays = at & np.roll(at, 1)  # two equal values in sequence
    returns = int(np.count_nonzero(stays[1:] & ~stays[:-1])) > 1
    return returns and value in (values.min(), values.max()) and value != 0.0


def _between_steps(values: Vector, run: slice) -> bool:
    """Return whether a coarse signal changes by one step before and after a run."""
    step = step_of(values)
    if step <= COARSE_TORQUE * float(np.std(values)):
        return False
    if run.start == 0 or run.stop == len(values):
        return False
    changes = values[[run.start - 1, run.stop]] - values[run.start]
    return bool((abs(changes) < _ONE_STEP * step).all())


def _frozen(
    log: Recording, joint: str, name: str, run: slice, value: float
) -> LogFinding:
    whole = run.stop - run.start == len(log)
    when = "throughout"
    if not whole:
        ends = log.time[[run.start, run.stop - 1]]
        first, last = (instant(end, log.time) for end in ends)
        when = f"from {first} s to {last} s"
    return LogFinding(
        "dead channel" if whole else "frozen channel",
        "fault",
        joint,
        f"{joint}: {name} is {value + 0.0:.4g} {when}, while the joint moves",
        "check the column and its sensor; leave the rows out, or the joint out of "
        "torque_joints",
        10.0,
    )


def named_as_constant(finding: LogFinding, log: Recording) -> LogFinding:
    """Return a finding about a joint's position, or that this position never changes.

    Without a velocity, a joint that stands still and a dead channel look alike, until
    another position explains the torque better.

    Parameters
    ----------
    finding : LogFinding
        A scale, sign, unit or zero that explains the log.
    log : Recording
        In which it was found.
    """
    if finding.kind not in _OF_POSITIONS or finding.where not in log.joints:
        return finding
    joint = finding.where
    position = log.position[:, log.joints.index(joint)]
    if np.ptp(position) > _CONSTANT:
        return finding
    return replace(
        finding,
        kind="dead channel",
        statement=f"{joint}: position is {position[0] + 0.0:.4g} throughout: the "
        f"channel never changes, and the torque is that of another position "
        f"({finding.statement})",
        advice=f"check the column of {joint} and its encoder; if it stood still "
        f"elsewhere, state where: --lock {joint}=POSITION",
        size="",
    )


def standing_findings(recording: Recording) -> list[LogFinding]:
    """Find times at which a log repeats one row, though the robot was in motion.

    Robots brake.  A logger that repeats its last row stops all joints in one sample.
    Without torque, robots that follow drawn paths may stop as suddenly.
    """
    if recording.torque is None:
        return []
    rows = np.column_stack([recording.position, recording.torque])
    same = (np.diff(rows, axis=0) == 0.0).all(axis=1)
    turns = abs(np.diff(recording.position, 2, axis=0))
    in_motion = turns[~(same[:-1] | same[1:])]
    if len(in_motion) < _ENOUGH:
        return []
    usual = np.quantile(in_motion, 0.99, axis=0)
    far = _SUDDEN * usual + _STEPS * position_steps(recording)
    sudden = np.zeros(len(rows), dtype=bool)
    sudden[1:-1] = (turns > far).any(axis=1)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], same, [False]])))
    lost = [
        (int(first), int(last))
        for first, last in edges.reshape(-1, 2)
        if recording.time[last] - recording.time[first] >= _WHOLE
        and (sudden[first] or sudden[last])
    ]
    if not lost:
        return []
    share = sum(last - first for first, last in lost) / len(rows)
    time = recording.time
    when = ", ".join(
        f"{instant(time[a], time)} to {instant(time[b], time)} s" for a, b in lost[:3]
    )
    return [
        LogFinding(
            "frozen channel",
            "fault" if share >= _REPEATS else "warning",
            recording.name,
            f"all positions and torques stay the same ({when}), and joints stop or "
            f"start within one sample: the log stood still in {share:.0%} of its rows",
            "leave these rows out, and take the parts as recordings of their own: "
            "what lies between them was not recorded",
            10.0,
        )
    ]

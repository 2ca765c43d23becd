"""Faults of single channels: jumps, spikes, steps and noise.

Positions may jump by whole turns, as those of encoders that count from 0 to 360 do.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from consistent_id._support.arrays import BoolArray, IntArray, Matrix, Vector
from consistent_id.diagnosis.findings import LogFinding
from consistent_id.recordings.recording import Recording, instant
from consistent_id.recordings.signals.masks import held_samples, quantum

TURN = 2.0 * np.pi
"""Size of a jump that is undone [rad]."""


def unwrapped(recording: Recording) -> Recording:
    """Return a recording whose positions do not jump by whole turns.

    A multiple of a turn is added to each position, so that it is nearest to the
    position before.  Commands of position become nearest to the position.  The dynamics
    of revolute joints do not depend on whole turns.

    Parameters
    ----------
    recording : Recording
        As it was read; joints move by less than half a turn between samples.

    Examples
    --------
    >>> log = Recording(("a",), [0.0, 1.0, 2.0], [[3.0], [-3.1], [-2.9]])
    >>> unwrapped(log).position[:, 0].round(3).tolist()
    [3.0, 3.183, 3.383]
    """
    position = np.unwrap(recording.position, axis=0)
    command = recording.position_command
    if command is not None:
        command = command + TURN * np.round((position - command) / TURN)
    return replace(recording, position=position, position_command=command)


MOVING = 0.01
"""Travel that shows motion [rad or m]."""

COARSE_TORQUE = 0.1
"""Step over a torque's standard deviation, above which it is coarse."""

_SPIKE = 15.0  # times the median distance from neighbouring samples,
_TALL = 1.5  # and times the span of nine tenths of the values: a spike
_CHANCE = 2.0  # standard deviations of a count beyond chance
_RARE = 2e-3  # share of samples up to which spikes are only a warning
_ENDS = 3  # samples at either end, which have too few neighbours
_JUMP = 5.0  # times a fast step of the position,
_WIDE = 0.02  # and share of the joint's travel: a jump
_LONGER = 1.5  # times the median step of the clock: samples are missing
_FEW = 0.02  # of the samples: more frequent jumps are steps of the encoder
_HALF = 0.4  # of the travel: a wrapped encoder jumps further
_EQUAL = 0.1  # relative difference of jumps of a wrapped encoder
_COARSE_POSITION = 1.0 / 400.0  # step over the travel: accelerations are noise
# s for which a torque stays constant: it is late by half of this, which is more than
# filters of currents cause.
_HELD = 0.025
_LOST = 0.1  # of all torque, between the times at which it is updated: a fault
_NOISY = 0.5  # white noise over the torque's standard deviation that is reported
_ALL_NOISE = 0.9  # the same, above which there is no signal
_TINY = 1e-300  # N m or N: least divisor in place of a size of zero


def spike_findings(
    recording: Recording, besides: Sequence[Recording] = ()
) -> list[LogFinding]:
    """Find torques that jump away from their neighbours for one or two samples.

    They are a fault only if their share is certainly large.

    Parameters
    ----------
    besides : sequence of Recording
        Other recordings of the same torque channels.  In a part with little motion a
        value may look like a spike that is common elsewhere.
    """
    torque = recording.torque
    if torque is None:
        return []
    found = []
    for joint, tau in zip(recording.joints, torque.T, strict=True):
        count = int(spikes(tau, _widest(joint, besides)).sum())
        if count:
            sure = count - _CHANCE * np.sqrt(count)  # of a Poisson count
            found.append(
                LogFinding(
                    "outliers",
                    "fault" if sure > _RARE * len(tau) else "warning",
                    joint,
                    f"{joint}: {count} of {len(tau)} torques are far from those "
                    "before and after them",
                    "leave these rows out, or fit with method huber",
                    max(1.0, 100.0 * count / len(tau)),
                )
            )
    return found


def torque_spikes(
    recording: Recording, joint: str, besides: Sequence[Recording] = ()
) -> BoolArray:
    """Return the samples of a joint's torque that `spike_findings` counts.

    Parameters
    ----------
    recording : Recording
        With torque of the joint.
    joint : str
    besides : sequence of Recording
        See `spike_findings`.
    """
    tau = np.asarray(recording.of((joint,)).torque)[:, 0]
    return spikes(tau, _widest(joint, besides))


def without_spikes(recording: Recording) -> Recording:
    """Return a recording whose torque is interpolated where `spikes` finds some."""
    torque = np.array(recording.torque)
    for tau in torque.T:
        far = spikes(tau)
        if far.any():
            tau[far] = np.interp(recording.time[far], recording.time[~far], tau[~far])
    if np.array_equal(torque, np.asarray(recording.torque)):
        return recording
    return replace(recording, torque=torque)


def _widest(joint: str, besides: Sequence[Recording]) -> float:
    others = (_channel(log, joint) for log in besides)
    return max((_span(t) for t in others if t is not None), default=0.0)


def spikes(values: Vector, widest: float = 0.0) -> BoolArray:
    """Return where a signal jumps for one or two samples; steps do not count.

    `widest` is the span of nine tenths of the channel's values in other recordings.
    """
    away = abs(values - _median_of_five(values))
    usual = float(np.median(away))
    span = max(_span(values), widest)
    leaps = away > max(_SPIKE * usual, _TALL * span, 1e-12)
    leaps[:_ENDS] = leaps[-_ENDS:] = False
    return np.asarray(leaps)


def _span(values: Vector) -> float:
    """Return the span of nine tenths of the values."""
    low, high = np.quantile(values, [0.05, 0.95])
    return float(high - low)


def _channel(log: Recording, joint: str) -> Vector | None:
    """Return a joint's torque, if a log has it."""
    if log.torque is None or joint not in log.joints:
        return None
    return np.asarray(log.torque[:, log.joints.index(joint)])


def _median_of_five(values: Vector) -> Vector:
    """Return running medians of five samples; the ends are continued."""
    around = np.lib.stride_tricks.sliding_window_view(np.pad(values, 2, "edge"), 5)
    return np.asarray(np.partition(around, 2, axis=1)[:, 2])


def jump_findings(recording: Recording) -> list[LogFinding]:
    """Find positions that jump: lost rows, or encoders that wrap.

    Where time stamps are missing too, the log is cut or resampled: that is no fault.
    """
    jumps = np.column_stack([_jumps(q) for q in recording.position.T])
    steps = np.diff(recording.time)
    jumps &= (steps < _LONGER * np.median(steps))[:, None]
    # The last digit of an encoder steps while its joint rests.
    moving = np.ptp(recording.position, axis=0) > MOVING
    jumps &= moving
    lost = jumps[:, moving].sum(axis=1) >= max(0.5 * moving.sum(), 2.0)
    if lost.any():
        time = recording.time
        times = ", ".join(instant(at, time) for at in time[1:][lost][:3])
        return [
            LogFinding(
                "gap",
                "fault",
                recording.name,
                f"most joints jump at once ({times} s), but the time stamps do not",
                "samples were lost: cut the log there and use the parts",
                10.0,
            )
        ]
    return [
        _jumping(recording, k, jumps[:, k])
        for k in range(len(recording.joints))
        if jumps[:, k].any()
    ]


def _jumps(q: Vector) -> BoolArray:
    """Return where a position step is far larger than the steps around it."""
    steps = np.diff(q)
    fast = float(np.quantile(abs(steps), 0.95))
    away = abs(steps - _median_of_five(steps))
    fine = 3.0 * quantum(q)
    jumps = away > max(_JUMP * fast, _WIDE * float(np.ptp(q)), fine, 1e-9)
    return np.asarray(jumps & (jumps.mean() <= _FEW))


def _jumping(recording: Recording, k: int, jumps: BoolArray) -> LogFinding:
    q, joint = recording.position[:, k], recording.joints[k]
    sizes = abs(np.diff(q)[jumps])
    alike = bool(np.ptp(sizes) <= _EQUAL * sizes.max())
    alike = alike and bool(sizes.max() >= _HALF * np.ptp(q))
    turns = alike and abs(np.median(sizes) - TURN) <= _EQUAL * TURN
    undone = "undo the missing turns: --wraps undo (wraps of [data])"
    kind = "wrapped encoder" if alike else "gap" if len(sizes) == 1 else "outliers"
    return LogFinding(
        kind,
        "fault",
        joint,
        f"{joint}: the position jumps {len(sizes)} times"
        + (f", each time by {np.median(sizes):.4g}" if alike else ""),
        undone
        if turns
        else f"add or subtract {np.median(sizes):.4g} after each jump (numpy.unwrap)"
        if alike
        else "cut the log there, or leave these rows out",
        10.0,
    )


def resolution_findings(recording: Recording, torque: Recording) -> list[LogFinding]:
    """Warn of channels with a coarse resolution relative to their range."""
    found = []
    travel = np.ptp(recording.position, axis=0)
    steps = position_steps(recording)
    for joint, step, way in zip(recording.joints, steps, travel, strict=True):
        # Readings of a resting joint only flicker.
        if way >= MOVING and step > _COARSE_POSITION * way:
            found.append(_steps("encoder resolution", joint, "position", step, way))
    for joint, tau in zip(torque.joints, np.asarray(torque.torque).T, strict=True):
        size = float(np.std(tau))
        # A torque that is updated seldom has few values, whatever its resolution.
        step = step_of(tau) if held_samples(tau) == 1 else quantum(tau)
        if step > COARSE_TORQUE * size > 0.0:
            found.append(_steps("torque resolution", joint, "torque", step, size))
    return found


def position_steps(recording: Recording) -> Vector:
    """Return the steps of positions, shape (joints,), [rad or m]; zero if unknown."""
    return np.array([step_of(values) for values in recording.position.T])


def step_of(values: Vector) -> float:
    """Return the step between values; zero if unknown."""
    return quantum(values) or _levels(values)


def _levels(values: Vector) -> float:
    """Return the step between few distinct values; zero if there are many."""
    levels = np.unique(values)
    return float(np.median(np.diff(levels))) if 1 < len(levels) <= 50 else 0.0


def _steps(kind: str, joint: str, name: str, step: float, size: float) -> LogFinding:
    return LogFinding(
        kind,
        "warning",
        joint,
        f"{joint}: the {name} has steps of {step:.3g}, and the motion of the log "
        f"changes it by only {size:.3g}",
        "log it with more digits, or move more widely; a lower cut-off averages steps",
        step / size / (_COARSE_POSITION if name == "position" else COARSE_TORQUE),
    )


def hold_findings(torque: Recording) -> list[LogFinding]:
    """Warn of torques that are sampled faster than they are updated."""
    step, values = float(np.median(np.diff(torque.time))), np.asarray(torque.torque)
    holds = np.array([held_samples(tau) for tau in values.T])
    held = (holds > 1) & (holds * step >= _HELD)
    if not held.any():
        return []
    longest = float(holds[held].max()) * step
    lost = _lost_between(values, holds)
    repeats = (np.diff(values[:, held], axis=0) == 0.0).mean()
    return [
        LogFinding(
            "torque resolution",
            "fault" if lost >= _LOST else "warning",
            ", ".join(np.array(torque.joints)[held]),
            f"{repeats:.0%} of the torque samples repeat the one before: the torque "
            f"is updated only every {longest:.3g} s, and {lost:.0%} of it is lost in "
            "between",
            "log the torque as often as the motion; now it is late by half that time",
            longest / _HELD,
            size=f"{longest:.3g}",
        )
    ]


def _lost_between(torque: Matrix, holds: IntArray) -> float:
    """Return what a torque that is held loses, over the torque of all joints.

    A line from one value to the next, ``d`` apart, differs from a stair that is as
    early as late by ``d / sqrt(12)`` in the root mean square.
    """
    squares = 0.0
    for tau, hold in zip(torque.T, holds, strict=True):
        if hold > 1:
            steps = np.diff(tau)
            squares += float(np.sum(steps**2)) * hold / 12.0 / len(tau)
    whole = float(np.sum(np.mean(torque**2, axis=0)))
    return float(np.sqrt(squares / max(whole, _TINY)))


def noise_findings(
    torque: Recording, besides: Sequence[Recording] = ()
) -> list[LogFinding]:
    """Warn of torques that are mostly noise.

    Parameters
    ----------
    besides : sequence of Recording
        Other recordings of the same torque channels.  A part in which a joint hardly
        moves is mostly noise, although its channel has a signal elsewhere.
    """
    return list(_noisy(torque, besides))


def _noisy(torque: Recording, besides: Sequence[Recording]) -> Iterator[LogFinding]:
    values = np.asarray(torque.torque)
    shares = noise_share(values)
    for j, joint in enumerate(torque.joints):
        others = (_channel(log, joint) for log in besides)
        largest = max((float(np.std(t)) for t in others if t is not None), default=0.0)
        size = float(np.std(values[:, j]))
        share = shares[j] * size / max(size, largest, _TINY)
        if share < _NOISY:
            continue
        nothing = share >= _ALL_NOISE
        yield LogFinding(
            "torque channel" if nothing else "noise",
            "fault" if nothing else "warning",
            joint,
            f"{joint}: white noise is {share:.0%} of the torque's "
            "standard deviation" + (": there is no signal in it" if nothing else ""),
            "check that this column is the joint's torque"
            if nothing
            else "average more: longer logs, lower cut-offs; see the standard errors",
            share / _NOISY,
        )


def noise_share(torque: Matrix) -> Vector:
    """Return white noise over the standard deviation, shape (joints,).

    Second differences of a smooth signal are small; those of white noise of standard
    deviation ``s`` have ``sqrt(6) s``.
    """
    size = np.std(torque, axis=0)
    # The median ignores spikes and edges of friction.  It is 0.6745 standard deviations
    # of a normal distribution.
    second = np.median(abs(np.diff(torque, 2, axis=0)), axis=0)
    white = second / (0.6745 * np.sqrt(6.0))
    return np.asarray(white / np.where(size > 0.0, size, 1.0))

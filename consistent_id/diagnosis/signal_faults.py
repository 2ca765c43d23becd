"""Channels that stop, jump, spike, step or hiss: seen in the signals alone."""

from collections.abc import Iterator, Sequence

import numpy as np

from consistent_id._support.arrays import BoolArray, Matrix, Vector
from consistent_id.diagnosis.findings import LogFinding
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals.masks import held_samples, quantum

_FROZEN = 0.1  # share of the log in one run of one value that is no chance
_MOVING = 0.01  # rad or m, above which a joint's other channel says that it moves,
_STEPS = 2.0  # and steps of its encoder, within which a position holds one value
_SPIKE = 15.0  # times the usual distance from the neighbours' median,
_TALL = 1.5  # and of the span of nine tenths of the values: a spike
_CHANCE = 2.0  # standard deviations of a count that are no chance
_RARE = 2e-3  # share of samples up to which they are no more than a nuisance
_ENDS = 3  # samples at either end, which have too few neighbours to be judged
_JUMP = 5.0  # times a fast step of the position,
_WIDE = 0.02  # and of the joint's travel: a jump
_LONGER = 1.5  # times the usual step of the clock: a sample or more is missing
_FEW = 0.02  # of the samples, at the most: more are steps of the encoder
_HALF = 0.4  # of the travel: less than a wrapped encoder jumps
_EQUAL = 0.1  # by which jumps of a wrapped encoder may differ
_COARSE_TORQUE = 0.1  # step over the torque's standard deviation
_COARSE_POSITION = 1.0 / 400.0  # step over the travel: accelerations are noise
# s, for which a torque is held: by half of it, it is late, which is more than what
# filters of currents make.
_HELD = 0.025
_NOISY = 0.5  # white noise over the torque's standard deviation, worth a warning
_ALL_NOISE = 0.9  # beyond which there is hardly anything else
_TINY = 1e-300  # N m or N, instead of a size of zero, by which one could not divide


def frozen_findings(recording: Recording) -> list[LogFinding]:
    """Find channels that hold one value for a part of the log while the joint moves."""
    moved = recording.position
    if recording.velocity is not None:
        steps = np.diff(recording.time, prepend=recording.time[0])
        moved = np.cumsum(recording.velocity * steps[:, None], axis=0)
    found = []
    least = np.maximum(_MOVING, _STEPS * position_steps(recording))
    for k, joint in enumerate(recording.joints):
        for name, motion in (
            ("torque", recording.position),
            ("position", moved),
            ("velocity", recording.position),
        ):
            values = getattr(recording, name)
            if values is None:
                continue
            run = longest_run(values[:, k])
            length = run.stop - run.start
            value = values[run.start, k]
            limit = name == "torque" and abs(value) >= abs(values[:, k]).max() > 0.0
            still = float(np.ptp(motion[run, k])) < least[k]
            # A torque without any signal is none, moving or not.
            dead = name == "torque" and length == len(recording)
            if limit or (still and not dead):
                continue
            if length >= _FROZEN * len(recording):
                found.append(_frozen(recording, joint, name, run, float(value)))
    return found


def _frozen(
    log: Recording, joint: str, name: str, run: slice, value: float
) -> LogFinding:
    whole = run.stop - run.start == len(log)
    when = "throughout"
    if not whole:
        last = log.time[run.stop - 1]
        when = f"from {log.time[run.start]:.4g} s to {last:.4g} s"
    return LogFinding(
        "dead channel" if whole else "frozen channel",
        "fault",
        joint,
        f"{joint}: {name} is {value:.4g} {when}, while the joint moves",
        "check the column and its sensor; leave the rows out, or the joint out of "
        "torque_joints",
        10.0,
    )


def longest_run(values: Vector) -> slice:
    """Return the longest run of one value."""
    edges = np.flatnonzero(np.diff(values) != 0.0) + 1
    ends = np.concatenate([[0], edges, [len(values)]])
    k = int(np.argmax(np.diff(ends)))
    return slice(int(ends[k]), int(ends[k + 1]))


def spike_findings(
    recording: Recording, besides: Sequence[Recording] = ()
) -> list[LogFinding]:
    """Find torques that leap for a sample or two, away from those around them.

    So few in a short log that their share may be small all the same are no fault.

    Parameters
    ----------
    besides : sequence of Recording
        Of the same torque channels: in a stretch that moves little, what is tall beside
        it alone is not.
    """
    torque = recording.torque
    if torque is None:
        return []
    found = []
    for joint, tau in zip(recording.joints, torque.T, strict=True):
        others = (_channel(log, joint) for log in besides)
        widest = max((_span(t) for t in others if t is not None), default=0.0)
        count = int(spikes(tau, widest).sum())
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


def spikes(values: Vector, widest: float = 0.0) -> BoolArray:
    """Return where a signal leaps for one sample or two; steps are none.

    `widest` is the span of the channel elsewhere, of nine tenths of its values.
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
    """Return running medians of five samples; the ends go on as they are."""
    around = np.lib.stride_tricks.sliding_window_view(np.pad(values, 2, "edge"), 5)
    return np.asarray(np.partition(around, 2, axis=1)[:, 2])


def jump_findings(recording: Recording) -> list[LogFinding]:
    """Find positions that jump: rows that were lost, or encoders that wrap.

    Where stamps are missing too, a log is cut or resampled there: that is no fault.
    """
    jumps = np.column_stack([_jumps(q) for q in recording.position.T])
    steps = np.diff(recording.time)
    jumps &= (steps < _LONGER * np.median(steps))[:, None]
    # Of a joint at rest, what steps is the encoder's last digit.
    moving = np.ptp(recording.position, axis=0) > _MOVING
    jumps &= moving
    lost = jumps[:, moving].sum(axis=1) >= max(0.5 * moving.sum(), 2.0)
    if lost.any():
        times = ", ".join(f"{t:.4g}" for t in recording.time[1:][lost][:3])
        return [
            LogFinding(
                "gap",
                "fault",
                recording.name,
                f"most joints jump at once ({times} s), but the time stamps do not",
                "samples were lost: cut the log there, and use the parts",
                10.0,
            )
        ]
    return [
        _jumping(recording, k, jumps[:, k])
        for k in range(len(recording.joints))
        if jumps[:, k].any()
    ]


def _jumps(q: Vector) -> BoolArray:
    """Return where a position steps far beyond its steps before and after."""
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
    kind = "wrapped encoder" if alike else "gap" if len(sizes) == 1 else "outliers"
    return LogFinding(
        kind,
        "fault",
        joint,
        f"{joint}: the position jumps {len(sizes)} times"
        + (f", each time by {np.median(sizes):.4g}" if alike else ""),
        "add or subtract the missing turn after each jump (numpy.unwrap)"
        if alike
        else "cut the log there, or leave these rows out",
        10.0,
    )


def resolution_findings(recording: Recording, torque: Recording) -> list[LogFinding]:
    """Warn of steps that are coarse relative to the channel's range."""
    found = []
    travel = np.ptp(recording.position, axis=0)
    steps = position_steps(recording)
    for joint, step, way in zip(recording.joints, steps, travel, strict=True):
        # Of a joint at rest, readings flicker: it has nothing to tell.
        if way >= _MOVING and step > _COARSE_POSITION * way:
            found.append(_steps("encoder resolution", joint, "position", step, way))
    for joint, tau in zip(torque.joints, np.asarray(torque.torque).T, strict=True):
        size = float(np.std(tau))
        # Of a torque that is held there are few values, whatever their resolution.
        step = _step(tau) if held_samples(tau) == 1 else quantum(tau)
        if step > _COARSE_TORQUE * size > 0.0:
            found.append(_steps("torque resolution", joint, "torque", step, size))
    return found


def position_steps(recording: Recording) -> Vector:
    """Return the steps in which positions come, shape (joints,), [rad or m], or 0."""
    return np.array([_step(values) for values in recording.position.T])


def _step(values: Vector) -> float:
    """Return the step in which values come, or 0."""
    return quantum(values) or _levels(values)


def _levels(values: Vector) -> float:
    """Return the step between so few values that no quantum shows, or 0."""
    levels = np.unique(values)
    return float(np.median(np.diff(levels))) if 1 < len(levels) <= 50 else 0.0


def _steps(kind: str, joint: str, name: str, step: float, size: float) -> LogFinding:
    return LogFinding(
        kind,
        "warning",
        joint,
        f"{joint}: the {name} comes in steps of {step:.3g}, the motion of the log is "
        f"worth {size:.3g}",
        "log it with more digits, or move more widely; lower cut-offs average steps",
        step / size / (_COARSE_POSITION if name == "position" else _COARSE_TORQUE),
    )


def hold_findings(torque: Recording) -> list[LogFinding]:
    """Warn of torques that are sampled faster than they are updated."""
    step, values = float(np.median(np.diff(torque.time))), np.asarray(torque.torque)
    holds = np.array([held_samples(tau) for tau in values.T])
    held = (holds > 1) & (holds * step >= _HELD)
    if not held.any():
        return []
    longest = float(holds[held].max()) * step
    repeats = (np.diff(values[:, held], axis=0) == 0.0).mean()
    return [
        LogFinding(
            "torque resolution",
            "warning",
            ", ".join(np.array(torque.joints)[held]),
            f"{repeats:.0%} of the torque samples repeat the one before: the torque "
            f"is updated only every {longest:.3g} s",
            "log the torque as often as the motion; now it is late by half that time",
            longest / _HELD,
        )
    ]


def noise_findings(
    torque: Recording, besides: Sequence[Recording] = ()
) -> list[LogFinding]:
    """Warn of torques that are mostly noise.

    Parameters
    ----------
    besides : sequence of Recording
        Of the same torque channels: a stretch in which a joint hardly moves has little
        but noise, and a channel with a signal elsewhere is no noise.
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
    # The median, so that spikes and edges of friction do not count; of a normal
    # deviation it is 0.6745 standard deviations.
    second = np.median(abs(np.diff(torque, 2, axis=0)), axis=0)
    white = second / (0.6745 * np.sqrt(6.0))
    return np.asarray(white / np.where(size > 0.0, size, 1.0))

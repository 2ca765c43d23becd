"""Clocks that are not in seconds, velocities that disagree with positions."""

import numpy as np

from consistent_id._support.arrays import Array, BoolArray, Vector
from consistent_id.diagnosis.findings import Finding
from consistent_id.recordings.recording import Recording

_SLOW = 0.5  # s between samples, above which the clock is hardly in seconds
_AGREED = 0.8  # correlation of two rates that belong to one joint
_NEAR = 1.3  # factor within which a ratio is taken for a known one

_RATIOS = {
    1e3: ("clock", "the clock counts milliseconds", "divide the time by 1000"),
    1e6: ("clock", "the clock counts microseconds", "divide the time by 1e6"),
    180 / np.pi: (
        "degrees",
        "velocities are in degrees per second, positions in radians",
        "multiply the velocities by pi / 180",
    ),
    np.pi / 180: (
        "degrees",
        "positions are in degrees, velocities in radians per second",
        "multiply the positions by pi / 180",
    ),
}


def clock_findings(recording: Recording) -> list[Finding]:
    """Judge stamps by themselves."""
    step = float(np.median(np.diff(recording.time)))
    if step < _SLOW:
        return []
    unit, factor = ("milliseconds", 1e3) if step < 500.0 else ("microseconds", 1e6)
    return [
        Finding(
            "clock",
            "fault",
            recording.name,
            f"the median step between samples is {step:g}, which as seconds is no "
            f"robot's log; it looks like {unit}",
            f"divide the time by {factor:g}",
            step / _SLOW,
        )
    ]


def velocity_findings(recording: Recording) -> list[Finding]:
    """Hold the velocity channel against the position's differences."""
    if recording.velocity is None:
        return []
    from_position = np.gradient(recording.position, recording.time, axis=0)
    ratios, agreed = _ratios(recording.velocity, from_position)
    known = [np.inf] if not agreed.any() else ratios[agreed]
    common = float(np.median(known))
    for ratio, (kind, statement, advice) in _RATIOS.items():
        if 1 / _NEAR < common / ratio < _NEAR:
            seen = f"velocity over the position's rate is {common:.4g}: {statement}"
            return [Finding(kind, "fault", "all joints", seen, advice, 10.0)]
    return [
        *_signs(recording, ratios, agreed),
        *_swaps(recording, recording.velocity, from_position, agreed),
    ]


def _ratios(velocity: Array, rate: Array) -> tuple[Vector, BoolArray]:
    """Return velocity over rate of each joint, and whether they are correlated."""
    both = np.sum(velocity * rate, axis=0)
    sizes = np.linalg.norm(velocity, axis=0) * np.linalg.norm(rate, axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        correlation = np.nan_to_num(both / sizes)
        ratios = np.nan_to_num(both / np.sum(rate**2, axis=0))
    return ratios, abs(correlation) >= _AGREED


def _signs(recording: Recording, ratios: Vector, agreed: BoolArray) -> list[Finding]:
    return [
        Finding(
            "velocity sign",
            "fault",
            joint,
            f"{joint}: velocity is {ratio:.3g} times the position's rate",
            "reverse the velocity channel, or the position's",
            10.0,
        )
        for joint, ratio, sure in zip(recording.joints, ratios, agreed, strict=True)
        if sure and ratio < 0.0
    ]


def _swaps(
    recording: Recording, velocity: Array, rate: Array, agreed: BoolArray
) -> list[Finding]:
    """Find joints whose velocity is another joint's."""
    lost = np.flatnonzero(~agreed)
    if len(lost) < 2:
        return []
    v = velocity / np.maximum(np.linalg.norm(velocity, axis=0), 1e-300)
    r = rate / np.maximum(np.linalg.norm(rate, axis=0), 1e-300)
    match = abs(v.T @ r)
    found = []
    for i in lost:
        j = int(np.argmax(match[i]))
        if j != i and match[i, j] >= _AGREED:
            a, b = recording.joints[i], recording.joints[j]
            found.append(
                Finding(
                    "channel order",
                    "fault",
                    f"{a}, {b}",
                    f"the velocity of {a} is the rate of {b} (correlation "
                    f"{match[i, j]:.2f}), not its own ({match[i, i]:.2f})",
                    "name the columns in the order of the joints they belong to",
                    match[i, j] / _AGREED,
                )
            )
    return found

"""Clocks that are not in seconds, velocities that disagree with positions."""

import numpy as np

from consistent_id._support.arrays import Array, BoolArray, Vector
from consistent_id.diagnosis.findings import FoundUnit, LogFinding
from consistent_id.recordings.recording import Recording

_SLOW = 0.5  # s between samples: with more the clock is not in seconds,
_SLOWLY = 0.1  # nor with this, if joints creep:
_CREEPING = 0.02  # rad/s or m/s: no joint is faster for long,
_WIDELY = 0.2  # rad or m, but one travels further
_AGREED = 0.8  # least correlation of two rates of one joint
_NEAR = 1.3  # factor within which a ratio equals a known one

_SAME = 0.05  # relative difference within which ratios are equal
_LATE = 0.012  # s: filters of velocities cause less
_CLEAR = 0.25  # share of the squared misfit that a lag may leave
_SPAN = 0.1  # s, over which rates are averaged
_CHANCE = 3.0  # standard errors beyond chance
_COUNTS = 30.0  # ratio above which the clock is not the cause

_RATIOS = {
    1e3: (
        "clock",
        "the clock counts milliseconds",
        "divide the time by 1000 (--units time=ms)",
    ),
    1e6: (
        "clock",
        "the clock counts microseconds",
        "divide the time by 1e6 (--units time=us)",
    ),
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


def clock_findings(recording: Recording) -> list[LogFinding]:
    """Find time stamps that are not in seconds."""
    found = clock_unit(recording)
    return [] if found is None else [found.finding]


def clock_unit(recording: Recording) -> FoundUnit | None:
    """Return the unit of time stamps that are not in seconds; None if they are."""
    step = float(np.median(np.diff(recording.time)))
    if step < _SLOW and not (step >= _SLOWLY and _creeps(recording)):
        return None
    # Robots log at 10 Hz to 10 kHz: the unit is the one in which the step fits.
    units = (
        ("milliseconds", "ms", 1e3),
        ("microseconds", "us", 1e6),
        ("nanoseconds", "ns", 1e9),
    )
    unit, short, factor = next((u for u in units if step / u[2] < _SLOW), units[-1])
    options = f"--units time={short}"
    finding = LogFinding(
        "clock",
        "fault",
        recording.name,
        f"the median step between samples is {step:g}, too long for a log in "
        f"seconds; it looks like {unit}",
        f"divide the time by {factor:g} ({options})",
        step / _SLOW,
    )
    return FoundUnit(finding, options)


def _creeps(recording: Recording) -> bool:
    """Return whether joints travel far although none is ever fast.

    A log of 5 kHz in milliseconds has steps of 0.2 s, and joints that creep.
    """
    rates = np.gradient(recording.position, recording.time, axis=0)
    fastest = float(np.quantile(abs(rates), 0.95, axis=0).max())
    widest = float(np.ptp(recording.position, axis=0).max())
    return fastest <= _CREEPING and widest >= _WIDELY


def velocity_findings(recording: Recording) -> list[LogFinding]:
    """Compare the velocity channel with the position's differences."""
    if recording.velocity is None:
        return []
    from_position = np.gradient(recording.position, recording.time, axis=0)
    # Averaging removes the steps of encoders, which make ratios too small.
    span = max(int(_SPAN * recording.rate), 1)
    ratios, correlation = _ratios(
        _averaged(recording.velocity, span), _averaged(from_position, span)
    )
    agreed = abs(correlation) >= _AGREED
    known = [np.inf] if not agreed.any() else ratios[agreed]
    common = float(np.median(known))
    errors = _ratio_errors(recording, correlation)
    for ratio, (kind, statement, advice) in _RATIOS.items():
        if 1 / _NEAR < common / ratio < _NEAR:
            seen = f"velocity over the position's rate is {common:.4g}: {statement}"
            return [LogFinding(kind, "fault", "all joints", seen, advice, 10.0)]
    return (
        _late(recording, recording.velocity, from_position)
        or _common_ratio(ratios[agreed], errors[agreed])
        or [
            *_signs(recording, ratios, agreed),
            *_swaps(recording, recording.velocity, from_position, agreed),
            *_scales(recording, ratios, correlation, errors),
        ]
    )


def _averaged(values: Array, span: int) -> Array:
    """Return means over `span` samples."""
    sums = np.cumsum(values, axis=0)
    return np.asarray(sums[span:] - sums[:-span]) / span


def _ratio_errors(recording: Recording, correlation: Vector) -> Vector:
    """Return standard errors of the logarithms of ratios, shape (joints,).

    The number of independent pairs is that of averages while the joint moves.
    """
    speed = np.asarray(recording.velocity) ** 2
    moving = np.sum(speed, axis=0) ** 2 / np.maximum(np.sum(speed**2, axis=0), 1e-300)
    pairs = np.maximum(moving / max(_SPAN * recording.rate, 1.0) - 1.0, 0.5)
    r = np.clip(abs(correlation), 1e-6, 1.0)
    return np.asarray(np.sqrt((1.0 / r**2 - 1.0) / pairs))


def _common_ratio(ratios: Vector, errors: Vector) -> list[LogFinding]:
    """Find a common factor between velocities and the rates of positions.

    It has to be larger than chance explains.
    """
    if not len(ratios):
        return []
    chance = float(np.median(errors))
    common = float(np.median(ratios))
    alike = abs(ratios / common - 1.0) <= _SAME
    if common <= 0.0 or not alike.all() or abs(common - 1.0) <= _SAME:
        return []
    if abs(np.log(common)) <= _CHANCE * chance:
        return []
    seen = f"velocity over the position's rate is {common:.4g} in all joints: "
    if 1.0 / _COUNTS < common < _COUNTS:
        kind = "clock"
        cause = "the clock has a wrong speed, or velocities are scaled"
        advice = "find out which: multiply the time, or the velocities, by {:.4g}"
    else:
        kind = "encoder scale"
        cause = "positions are in counts of an encoder, or velocities in another unit"
        advice = "multiply the positions by {:.4g} if the velocities are right"
    return [
        LogFinding(
            kind,
            "fault",
            "all joints",
            seen + cause,
            advice.format(1.0 / common if kind == "clock" else common),
            abs(float(np.log(common))) / _SAME,
        )
    ]


def _scales(
    recording: Recording, ratios: Vector, correlation: Vector, errors: Vector
) -> list[LogFinding]:
    """Find joints whose position and velocity have different scales.

    Noise in the position's rate lowers a ratio, at most by the squared correlation;
    noise in the velocity does not.  A scale that noise or chance explains is one.
    """
    found = []
    rows = zip(recording.joints, ratios, correlation, errors, strict=True)
    for joint, ratio, r, error in rows:
        if r < _AGREED:
            continue
        scale = float(np.clip(1.0, ratio, ratio / r**2))
        if abs(np.log(scale)) > max(2.0 * _SAME, _CHANCE * error):
            found.append(
                LogFinding(
                    "encoder scale",
                    "fault",
                    joint,
                    f"{joint}: velocity is {ratio:.4g} times the position's rate, but "
                    "not in other joints",
                    "check the gear ratio and the unit of both channels",
                    abs(float(np.log(scale))) / _SAME,
                )
            )
    return found


def _late(recording: Recording, velocity: Array, rate: Array) -> list[LogFinding]:
    """Find velocities that are later or earlier than the rates of positions."""
    step = float(np.median(np.diff(recording.time)))
    reach = range(-int(0.3 / step) - 1, int(0.3 / step) + 2)
    if len(recording) < 4 * len(reach):
        return []
    inner = slice(len(reach), len(recording) - len(reach))
    moves = rate.any(axis=0) & velocity.any(axis=0)
    velocity, rate = velocity[:, moves], rate[:, moves]
    size = np.linalg.norm(rate, axis=0)
    misfits = [
        float(np.sum(((velocity[inner] - np.roll(rate, k, axis=0)[inner]) / size) ** 2))
        for k in reach
    ]
    best = int(np.argmin(misfits))
    lag = reach[best] * step
    edge = best in (0, len(reach) - 1)
    clear = misfits[best] < _CLEAR * misfits[-reach[0]]
    if edge or not clear or abs(lag) < _LATE + 1.5 * step:
        return []
    later = "later" if lag > 0.0 else "earlier"
    return [
        LogFinding(
            "lag",
            "fault",
            "all joints",
            f"velocities are {1e3 * abs(lag):.3g} ms {later} than the positions' rates",
            "shift velocities or positions in time, or leave the velocities out: they "
            "are then computed from the positions",
            abs(lag) / _LATE,
        )
    ]


def _ratios(velocity: Array, rate: Array) -> tuple[Vector, Vector]:
    """Return velocity over rate of each joint, and their correlation."""
    both = np.sum(velocity * rate, axis=0)
    sizes = np.linalg.norm(velocity, axis=0) * np.linalg.norm(rate, axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        correlation = np.nan_to_num(both / sizes)
        ratios = np.nan_to_num(both / np.sum(rate**2, axis=0))
    return ratios, correlation


def _signs(recording: Recording, ratios: Vector, agreed: BoolArray) -> list[LogFinding]:
    return [
        LogFinding(
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
) -> list[LogFinding]:
    """Find joints whose velocity channel belongs to another joint."""
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
                LogFinding(
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

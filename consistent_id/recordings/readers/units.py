"""Units in column names, and the factors to s, rad, m, N m and N.

A clock may be the sum of two columns, ``stamp.sec + stamp.nanosec``, or, if samples are
evenly spaced and the log has no clock, their rate, ``5000Hz``.
"""

import math
import re
import shlex
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress

import numpy as np

from consistent_id._support.arrays import Vector
from consistent_id.errors import RecordingError
from consistent_id.robot.parameters import did_you_mean, require_known

Units = Mapping[str, str | Sequence[str]]
"""Unit by channel: one for all joints, or one each."""

_TIMES = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0}
_TIMES |= {"h": 3600.0, "day": 86400.0, "100ns": 1e-7}
_ANGLES = {
    "rad": 1.0,
    "mrad": 1e-3,
    "urad": 1e-6,
    "deg": math.pi / 180.0,
    "mdeg": math.pi / 180e3,
    "rev": 2.0 * math.pi,
}
_LENGTHS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3}
_MOTIONS = _ANGLES | _LENGTHS
_TORQUES = {"N m": 1.0, "mN m": 1e-3, "kN m": 1e3, "N cm": 1e-2, "N mm": 1e-3}
_TORQUES |= {"N": 1.0, "mN": 1e-3, "kN": 1e3}
_KGF, _LBF = 9.80665, 4.4482216152605  # N, by definition; an inch is 25.4 mm
_TORQUES |= {"kgf cm": 1e-2 * _KGF, "kgf m": _KGF}
_TORQUES |= {"lbf in": 0.0254 * _LBF, "lbf ft": 0.3048 * _LBF}
_TORQUES |= {"ozf in": 0.0254 * _LBF / 16.0}
_OF_FORCES = ("N", "mN", "kN")
# Converted to torque only by a gain: shares of the rated torque, and currents.
_BY_GAIN = {"%": 1e-2, "permille": 1e-3, "A": 1.0, "mA": 1e-3}
_VELOCITIES = {f"{unit}/s": factor for unit, factor in _MOTIONS.items()}
_VELOCITIES |= {f"{unit}/min": factor / 60.0 for unit, factor in _MOTIONS.items()}

KNOWN: dict[str, dict[str, float]] = {
    "time": _TIMES,
    "position": _MOTIONS,
    "velocity": _VELOCITIES,
    "acceleration": {f"{unit}/s^2": factor for unit, factor in _MOTIONS.items()},
    "torque": _TORQUES | _BY_GAIN,
    "position_command": _MOTIONS,
    "velocity_command": _VELOCITIES,
    "torque_command": _TORQUES,
}
"""Factors to SI by channel and unit."""

SI = {
    channel: next(u for u in units if units[u] == 1.0)
    for channel, units in KNOWN.items()
}
"""The first SI unit of each channel."""

_SPELT = {
    word: unit
    for unit, words in {
        "deg": "° degs degree degrees grad",
        "rad": "radian radians",
        "rev": "revs revolution revolutions turn turns",
        "m": "meter meters metre metres",
        "urad": "µrad μrad",
        "deg/s": "dps degps",
        "rad/s": "radps",
        "mdeg/s": "mdegps mdps",
        "mrad/s": "mradps",
        "mm/s": "mmps",
        "mm": "millimeter millimeters millimetre millimetres",
        "s": "sec secs second seconds",
        "ms": "msec msecs millisecond milliseconds",
        "us": "µs μs usec usecs microsecond microseconds",
        "ns": "nsec nsecs nanosecond nanoseconds",
        "min": "mins minute minutes",
        "h": "hr hrs hour hours",
        "day": "days",
        "%": "percent pct",
        "permille": "‰",
        "A": "amp ampere",
        "N m": "nm",
        "mN m": "mnm",
        "kN m": "knm",
        "N cm": "ncm",
        "N mm": "nmm",
        "kgf cm": "kgfcm kgcm",
        "kgf m": "kgfm kgm",
        "lbf in": "lbfin lbin inlbf inlb",
        "lbf ft": "lbfft lbft ftlbf ftlb",
        "ozf in": "ozfin ozin inozf inoz",
    }.items()
    for word in words.split()
}
_PER = re.compile(
    r"(?:\s*(?:/|per|_per_|_)\s*(?P<each>s|sec|second|min|minute)(?:\^?(?P<power>2|²))?"
    r"|[ .·*]?s\^?[{(]?[-⁻](?:1|¹|(?P<less>2|²))[)}]?)$"  # deg.s^-1
)

_OF_A_TURN = re.compile(r"rev\s*/\s*(?P<counts>[1-9]\d*(?:\.\d+)?(?:e\+?\d\d?)?)")

# Endings of names that are not SI units.
_NOT_TIME = (
    "ms|msecs?|milliseconds?|us|µs|μs|usecs?|microseconds?|ns|nsecs?|nanoseconds?"
)
_LAST_TIME = re.compile(
    rf"[\[(_ ]\s*({_NOT_TIME}|min|mins|minutes?|h|hrs?|hours?|days?)\s*[\])]?$",
    re.IGNORECASE,
)
_COUNTS = r"counts?|ticks?|pulses?|incs?|increments?|steps"  # of an encoder
_NOT_MOTION = (
    "°|degs?|degrees?|grad|rpm|revs?|revolutions?|turns?|mm|cm|millimet(?:er|re)s?|"
    f"m(?:deg|rad)|[uµμ]rad|m?degps|m?dps|mradps|{_COUNTS}"
)
_EACH = (
    r"(?:\s*(?:/|per|_per_|_)\s*(?:s(?:ec)?(?:\^?2|²|\^?3)?|min(?:ute)?)"
    r"|[ .·*]?s\^?[{(]?[-⁻][12¹²][)}]?)?"
)
_UNIT = re.compile(f"(?:{_NOT_TIME}|(?:{_NOT_MOTION}){_EACH})", re.IGNORECASE)
_LAST = re.compile(rf"[\[(_ ]\s*({_UNIT.pattern})\s*[\])]?$", re.IGNORECASE)
_MARK = r"[ .·*-]?"  # between the factors of a unit
_IMPERIAL = rf"lbf?{_MARK}(?:in|ft)|(?:in|ft){_MARK}lbf?|ozf?{_MARK}in|in{_MARK}ozf?"
_LAST_TORQUE = re.compile(
    rf"[\[(_ ]\s*(%|pct|percent|permille|‰|[mk] ?N{_MARK}m|N{_MARK}[cm]m|[mk]N|mA|"
    rf"(?i:kgf?{_MARK}c?m|{_IMPERIAL}))\s*[\])]?$"
)
# Words for the joint after a unit, such as in ``pos_deg_J{number}``.
_TAIL = re.compile(
    r"[ _.]*(?:(?<=[ _.\])])(?:j|jnt|joint|joints|a|ax|axis|axes|m|motor|servo|dof)"
    r"[ _.#]*)?(?:\[\])?$",
    re.IGNORECASE,
)

_CLOCKS: tuple[str, ...] = (
    "time",
    "t",
    "timestamp",
    "stamp",
    "seconds",
    "sec",
    "time_s",
    "t_s",
)
_CLOCKS += (
    "ts",
    "datetime",
    "sim_time",
    "zeit",
    "zeitinsec",
    "elapsed",
    "elapsed_time",
    "时间",
    "時間",
    "時刻",
    "시간",
)


_RARE_CLOCKS = ("temps",)  # or temperatures
_RATE = re.compile(r"(?P<rate>\d+(?:\.\d+)?(?:e\d+)?) ?hz", re.IGNORECASE)
_AND = " + "  # between the columns of a clock
_FRACTIONS = {
    word: factor
    for factor, words in {
        1e-3: ("ms", "msec", "msecs", "millisec", "milliseconds"),
        1e-6: ("us", "usec", "usecs", "microsec", "microseconds"),
        1e-9: ("ns", "nsec", "nsecs", "nanosec", "nanosecs", "nanoseconds"),
    }.items()
    for word in words
}
_LISTED = re.compile(r"\{(?P<items>[^{}]*,[^{}]*)\}")  # a word for each joint
RATE = "RATEHz"  # in place of a rate that no log holds
COUNTS = "COUNTS"  # in place of those of a turn
_SECONDS = ("s", "sec", "secs", "second", "seconds")
_LAST_HUMP = re.compile(r"(?:(?<![A-Za-z])|(?<=[a-z])(?=[A-Z]))[A-Za-z][a-z]*$")
_ENDS = tuple(  # of the name of a fraction: a word, or one or two words with capitals
    map(re.compile, (r"[A-Za-z]+$", r"[A-Z][a-z]*[A-Z][a-z]*$", _LAST_HUMP.pattern))
)


def standard_unit(channel: str, unit: str) -> str:
    """Return a unit as `KNOWN` spells it.

    Raises
    ------
    RecordingError
        If the channel has no such unit; with the known ones.

    Examples
    --------
    >>> standard_unit("velocity", "rpm"), standard_unit("position", "degrees")
    ('rev/min', 'deg')
    >>> standard_unit("velocity", "deg.s^-1"), standard_unit("velocity", "dps")
    ('deg/s', 'deg/s')
    >>> standard_unit("position", "rev/4096")  # counts of an encoder
    'rev/4096'
    """
    known = KNOWN[channel]
    text = unit.strip()
    if text.lower() == "rpm":
        text = "rev/min"
    per = ""
    if found := _PER.search(text):
        each = "min" if (found["each"] or "").startswith("m") else "s"
        text = text[: found.start()]
        per = f"/{each}^2" if found["power"] or found["less"] else f"/{each}"
    if (of_a_turn := _OF_A_TURN.fullmatch(text)) and f"rev{per}" in known:
        return f"rev/{float(of_a_turn['counts']):.15g}{per}"
    compact = re.sub(r"(?<=\w)[ *·.-](?=\w)", "", text)
    for spelt in (text, _SPELT.get(text.lower(), ""), _SPELT.get(compact.lower(), "")):
        if spelt + per in known:
            return spelt + per
    near = did_you_mean(unit, known)
    raise RecordingError(
        f"no unit {unit!r} of {channel}; {near} (units: {', '.join(known)})"
    )


def checked_units(units: Units) -> dict[str, str | tuple[str, ...]]:
    """Return units as `KNOWN` spells them, by channel.

    Raises
    ------
    RecordingError
        If a channel or a unit is unknown.
    """
    found: dict[str, str | tuple[str, ...]] = {}
    for channel, unit in units.items():
        require_known([channel], KNOWN, "units: no channel", RecordingError)
        if isinstance(unit, str):
            found[channel] = standard_unit(channel, unit)
        else:
            found[channel] = tuple(standard_unit(channel, u) for u in unit)
    return found


def factors(units: Units, channel: str, joints: Sequence[str]) -> Vector:
    """Return the factors to SI units, shape (joints,); ones where no unit is stated.

    Raises
    ------
    RecordingError
        If there are units for another number of joints.
    """
    stated = units.get(channel, "")
    each = [stated] * len(joints) if isinstance(stated, str) else list(stated)
    if len(each) != len(joints):
        raise RecordingError(
            f"units: {len(each)} units of {channel} for {len(joints)} joints "
            f"({', '.join(joints)}), expected one, or one for each joint"
        )
    return np.array([_factor(channel, unit) if unit else 1.0 for unit in each])


def _factor(channel: str, unit: str) -> float:
    """Return the factor of a unit to SI; ``rev/4096`` is one count of 4096 a turn."""
    if found := _OF_A_TURN.match(unit):
        whole = "rev" + unit[found.end() :]
        return KNOWN[channel][whole] / float(found["counts"])
    return KNOWN[channel][unit]


def needs_gain(units: Units) -> str:
    """Return the unit of torque that needs a gain; empty for none."""
    stated = units.get("torque", "")
    each = [stated] if isinstance(stated, str) else stated
    return next((unit for unit in each if unit in _BY_GAIN), "")


def unit_of_a_name(channel: str, pattern: str) -> str:
    """Return the unit that ends a column's name, as `KNOWN` spells it; empty for none.

    Examples
    --------
    >>> unit_of_a_name("position", "q_{joint}_deg"), unit_of_a_name("time", "time [ms]")
    ('deg', 'ms')
    >>> unit_of_a_name("time", "secs + nsecs")  # each part has its own
    ''
    """
    if channel == "time" and _AND in pattern:
        return ""
    if len(each := listed_names(pattern)) > 1:
        return next(filter(None, (unit_of_a_name(channel, one) for one in each)), "")
    name = _TAIL.sub("", re.sub(r"\{[^}]*\}", "", pattern))
    last = {"to": _LAST_TORQUE, "ti": _LAST_TIME}.get(channel[:2], _LAST)
    found = last.search(name)
    if found is None:
        return ""
    for said in (found[1], found[1] + _per(channel)):  # left out in many names
        with suppress(RecordingError):
            return standard_unit(channel, said)
    return found[1]


def _is_count(unit: str) -> bool:
    return re.match(_COUNTS, unit, re.IGNORECASE) is not None


def _per(channel: str) -> str:
    """Return the time by which a unit of position is divided in a channel."""
    return {"v": "/s", "a": "/s^2"}.get(channel[0], "")


def refuse_units_of_a_name(where: str, channel: str, pattern: str) -> None:
    """Refuse ``q_{joint}_deg``, ``time [ms]`` and the like where no unit is stated.

    Raises
    ------
    RecordingError
        If the name ends in a unit that is not SI; with the option that states it.
    """
    if said := unit_of_a_name(channel, pattern):
        unit, why = said, ""
        if _is_count(said):
            minutes = re.search(r"min(?:ute)?$", said) is not None
            unit = f"rev/{COUNTS}{'/min' if minutes else _per(channel)}"
            why = ", with the counts of a turn of the joint"
        raise RecordingError(
            f"{where}: column {pattern!r} contains {said!r}; values are read in s, "
            f"rad and m, not converted, unless a unit is stated{why}: "
            f"--units {channel}={unit}; in a problem file "
            f'units = {{ {channel} = "{unit}" }} in [data]; in Python '
            f"Columns(units={{{channel!r}: {unit!r}}})",
            options=f"--units {shlex.quote(f'{channel}={unit}')}",
        )


def is_unit(text: str) -> bool:
    """Return whether a text is a unit of a joint's position, velocity or torque.

    Examples
    --------
    >>> is_unit("rad/s"), is_unit("Nm"), is_unit("arm")
    (True, True, False)
    """
    for channel in ("position", "velocity", "torque"):
        with suppress(RecordingError):
            return bool(standard_unit(channel, text))
    return False


def is_unit_of(channel: str, text: str) -> bool:
    """Return whether a text is a unit of a channel, and of no force or current.

    Examples
    --------
    >>> is_unit_of("torque", "Nm"), is_unit_of("torque", "A")
    (True, False)
    """
    if channel == "torque" and (text in _OF_FORCES or text in _BY_GAIN):
        return False
    with suppress(RecordingError):
        return bool(standard_unit(channel, text))
    return False


def is_any_unit(text: str) -> bool:
    """Return whether a text is a unit of any channel, of the clock too."""
    for channel in KNOWN:
        with suppress(RecordingError):
            return bool(standard_unit(channel, text))
    return False


def is_other_unit(text: str) -> bool:
    """Return whether a text is a unit of time or motion that is not SI."""
    return _UNIT.fullmatch(text.strip()) is not None


_SLOW = ("min", "h", "day")
_UNIT_OF_TIME = re.compile(
    r"[\s_]*[\[(]?\b(ms|us|ns|s|sec|seconds|min|minutes|h|hours|days?)[\])]?$"
)


def is_time(name: str) -> bool:
    """Return whether a name, without its unit, is that of the clock.

    Examples
    --------
    >>> is_time("Time [ms]"), is_time("state.time"), is_time("time_left")
    (True, True, False)
    """
    return _is_one_of(name, _CLOCKS)


def _is_one_of(name: str, clocks: Collection[str]) -> bool:
    last = name.strip().lower().replace("/", ".").rpartition(".")[2].lstrip("_")
    bare = _UNIT_OF_TIME.sub("", last.replace("_", " ")).replace(" ", "_")
    return last in clocks or bare in clocks


def named_clocks(names: Collection[str]) -> list[str]:
    """Return the names of clocks in one column.

    Those in minutes, hours or days may be of another thing, such as a minimum, and so
    may ``temps``: they count only if there is no other, in one column or in two.

    Examples
    --------
    >>> named_clocks(["t_min", "timestamp", "q1"]), named_clocks(["t_min", "q1"])
    (['timestamp'], ['t_min'])
    >>> named_clocks(["timestamp", "temps"]), named_clocks(["temps", "q1"])
    (['timestamp'], ['temps'])
    """
    found = [name for name in names if is_time(name)]
    usual = [name for name in found if unit_of_a_name("time", name) not in _SLOW]
    if usual or split_clock(names):
        return usual
    return found or [name for name in names if _is_one_of(name, _RARE_CLOCKS)]


def clock_columns(name: str) -> tuple[str, ...]:
    """Return the columns of a name: itself, two of a clock, or none of a rate.

    Examples
    --------
    >>> clock_columns("time"), clock_columns("t.sec + t.ns"), clock_columns("5e3Hz")
    (('time',), ('t.sec', 't.ns'), ())
    """
    return () if _RATE.fullmatch(name) else tuple(name.split(_AND))


def split_clock(names: Collection[str]) -> str | None:
    """Return the clock in two columns, seconds and their fraction, if there is one.

    Examples
    --------
    >>> split_clock(["header.stamp.sec", "header.stamp.nanosec", "position0"])
    'header.stamp.sec + header.stamp.nanosec'
    >>> split_clock(["TimestampSec", "TimestampNanoSec"])
    'TimestampSec + TimestampNanoSec'
    """
    for name in names:
        last = _LAST_HUMP.search(name)
        if last is None or last[0].lower() not in _SECONDS:
            continue
        stem = name[: last.start()]
        for other in names:
            if other.startswith(stem) and other[len(stem) :].lower() in _FRACTIONS:
                return f"{name}{_AND}{other}"
    return None


def listed_names(pattern: str) -> tuple[str, ...]:
    """Return the names of a pattern with a list, one for each joint; else itself.

    Examples
    --------
    >>> listed_names("q_{base,wrist}"), listed_names("q_{joint}")
    (('q_base', 'q_wrist'), ('q_{joint}',))
    """
    found = _LISTED.search(pattern)
    if found is None:
        return (pattern,)
    before, after = pattern[: found.start()], pattern[found.end() :]
    return tuple(f"{before}{one.strip()}{after}" for one in found["items"].split(","))


def rate_of(clock: str) -> float | None:
    """Return the rate [Hz] that stands for a clock; None if it is a column."""
    found = _RATE.fullmatch(clock)
    return None if found is None else float(found["rate"])


def fraction_unit(where: str, name: str) -> float:
    """Return the unit [s] of the column with a clock's fractions of a second.

    Raises
    ------
    RecordingError
        If its name does not end in one.
    """
    words = (last[0] for end in _ENDS if (last := end.search(name)) is not None)
    known = (_FRACTIONS.get(word.lower()) for word in words)
    factor = next((factor for factor in known if factor is not None), None)
    if factor is None:
        raise RecordingError(
            f"{where}: no unit ends {name!r}, expected the fraction of a second of a "
            "clock in ms, usec or nanosec"
        )
    return factor

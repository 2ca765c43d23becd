"""Units that a name gives away: what is not SI is refused, not read as if it were."""

import re

from consistent_id.errors import RecordingError

_TIME = "ms|msecs?|milliseconds?|us|µs|μs|usecs?|microseconds?|ns|nsecs?|nanoseconds?"
_MOTION = "°|degs?|degrees?|rpm|revs?|revolutions?|turns?|mm|cm|millimet(?:er|re)s?"
_PER = r"(?:\s*(?:/|per|_per_)\s*s(?:ec)?(?:\^?2|²|\^?3)?)?"
_UNIT = re.compile(f"(?:{_TIME}|(?:{_MOTION}){_PER})", re.IGNORECASE)
_LAST = re.compile(rf"[\[(_ ]\s*({_UNIT.pattern})\s*[\])]?$", re.IGNORECASE)


def refuse_units_of_a_name(where: str, pattern: str) -> None:
    """Refuse ``q_{joint}_deg``, ``time [ms]`` and the like.

    Raises
    ------
    RecordingError
        If the name ends in a unit that is not SI.
    """
    name = re.sub(r"\{[^}]*\}", "", pattern).rstrip(" _")
    if found := _LAST.search(name):
        raise RecordingError(
            f"{where}: column {pattern!r} says {found[1]!r}; values are read in s, "
            "rad and m, not converted. Convert them first: recording_from takes arrays"
        )


def refuse_units_of_an_attribute(where: str, unit: str) -> None:
    """Refuse an array whose file says that its unit is not SI.

    Raises
    ------
    RecordingError
        If the unit is one of time or motion that is not SI.
    """
    if _UNIT.fullmatch(unit.strip()):
        raise RecordingError(
            f"{where} is in {unit!r}, says the file; values are read in s, "
            "rad and m, not converted. Convert them first: recording_from takes arrays"
        )

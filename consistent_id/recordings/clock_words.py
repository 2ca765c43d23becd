"""Which column's name is that of the clock."""

import re

_TIMES: tuple[str, ...] = (
    "time",
    "t",
    "timestamp",
    "stamp",
    "seconds",
    "sec",
    "time_s",
    "t_s",
)
_TIMES += ("sim_time", "zeitinsec", "elapsed", "elapsed_time")


def is_time(name: str) -> bool:
    """Return whether a name is that of the clock, its unit aside.

    Examples
    --------
    >>> is_time("Time [ms]"), is_time("state.time"), is_time("time_left")
    (True, True, False)
    """
    last = re.split(r"[./]", name.strip().lower())[-1].lstrip("_")
    unit = re.compile(r"[\s_]*[\[(]?\b(ms|us|ns|s|sec|seconds)[\])]?$")
    bare = unit.sub("", last.replace("_", " ")).replace(" ", "_")
    return last in _TIMES or bare in _TIMES

"""What the words of a column's name say: which channel, measured or not, which unit.

The words are those of logs of MuJoCo, Drake, Isaac, LeRobot, ROS, KUKA, ABB, Universal
Robots and Franka, and of people who write their own.
"""

import re
from collections.abc import Iterable

from consistent_id.recordings.readers.units import unit_of_a_name

CHANNELS = ("position", "velocity", "torque")

# A name is of a channel if it has all words of one of these phrases; "qpos", "qvel" and
# "qfrc actuator" are of MuJoCo, "observation state" of LeRobot, "axis act" of KUKA,
# "feedback joints" of ABB.
_WORDS = {
    channel: tuple(frozenset(phrase.split()) for phrase in phrases.split(", "))
    for channel, phrases in {
        "position": "q, pos, position, positions, angle, angles, qpos, "
        "observation state, axis act, feedback joints",
        "velocity": "dq, qd, qdot, vel, velocity, velocities, qvel",
        "torque": "tau, trq, torque, torques, effort, efforts, qfrc actuator, "
        "actuator force",
    }.items()
}
_CURRENT = {"current", "currents", "cur", "amp", "amps", "ampere", "amperes", "i", "iq"}
_COMMANDED = {"target", "desired", "des", "cmd", "command", "commanded", "ref"}
_COMMANDED |= {"reference", "setpoint", "goal"}
_COMMANDS = {f"{short}{word}" for short in ("q", "pos", "p") for word in _COMMANDED}
_COMMANDS |= {"aspos"}  # KUKA
_COMMANDED |= {"d"}
_OTHER = {"error", "limit", "action", "ext", "external", "computed"}
_STATE = {"observation", "state"}  # LeRobot
_MEASURED = {"observation", "state", "actual"}
_DEGREES = ({"ai", "pos"}, {"axis", "act"}, {"feedback", "joints"})  # KUKA, ABB


def words(pattern: str) -> set[str]:
    """Return the words of a pattern beside the joint, in lower case.

    Examples
    --------
    >>> sorted(words("axisQMsr_{joint}"))
    ['axis', 'axisqmsr', 'msr', 'q']
    """
    rest = re.sub(r"\{\w+\}", " ", pattern)
    whole = set(re.findall(r"[a-z]+", rest.lower()))
    parts = re.sub(r"(?<=[a-z])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])", " ", rest)
    return whole | set(re.findall(r"[a-z]+", parts.lower()))


def channel_of(pattern: str, names: Iterable[str] = ()) -> str:
    """Return the channel that a pattern is of; empty for none.

    Of what is not measured, commands of position alone are a channel.  A plain
    ``action`` is one beside ``observation.state`` (LeRobot), of which it is the target;
    elsewhere it is what a policy gave out, in units of its own.

    Parameters
    ----------
    names : iterable of str
        All columns of the log.

    Examples
    --------
    >>> channel_of("actual_qd_{number}"), channel_of("q_des_{joint}")
    ('velocity', 'position_command')
    >>> channel_of("dq_des_{joint}"), channel_of("q_error_{joint}")
    ('', '')
    >>> channel_of("action"), channel_of("action", ["observation.state", "action"])
    ('', 'position_command')
    """
    said = words(pattern)
    if said == {"action"} and any(_STATE <= words(name) for name in names):
        return "position_command"
    if "action" in said and not said & _MEASURED:  # LeRobot, of its followers
        fits = [c for c in CHANNELS if any(phrase <= said for phrase in _WORDS[c])]
        return "position_command" if fits == ["position"] else ""
    if said & _OTHER:
        return ""
    fits = [c for c in CHANNELS if any(phrase <= said for phrase in _WORDS[c])]
    if said & _COMMANDS or (said & _COMMANDED and fits == ["position"]):
        return "position_command"
    if said & _COMMANDED:
        return ""
    # Of torque_axis_act the torque is meant, of vel_axis_act a share of the limit.
    if "torque" in fits:
        return "torque"
    if not fits and pattern.endswith("{joint}_w"):  # Drake
        return "velocity"
    if {"vel", "axis", "act"} <= said or len(fits) != 1:
        return ""
    return fits[0]


def is_current(pattern: str) -> bool:
    """Return whether a pattern says motor current, and not torque."""
    said = words(pattern)
    torque = any(phrase <= said for phrase in _WORDS["torque"])
    return bool(said & _CURRENT) and not torque


def unit_of(channel: str, pattern: str) -> str:
    """Return the unit that a name states, or that its maker writes; empty for SI."""
    said = words(pattern)
    if channel == "position" and any(said >= some for some in _DEGREES):
        return "deg"
    if channel == "position_command" and "aspos" in said:
        return "deg"
    return unit_of_a_name(channel, pattern)

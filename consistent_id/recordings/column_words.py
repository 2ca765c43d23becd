"""The meaning of words in a column's name: a joint's channel, and its unit.

The words are those of logs of MuJoCo, Drake, Isaac Gym and Isaac Lab, legged_gym,
LeRobot, ROS, KUKA, ABB, Universal Robots, Franka and Kinova, and of people who write
their own.
"""

import re
from collections.abc import Iterable
from functools import lru_cache

from consistent_id.recordings.readers.units import is_time, is_unit_of, unit_of_a_name

CHANNELS = ("position", "velocity", "torque")

# A name belongs to a channel if it has all words of one of these phrases; "qpos",
# "qvel" and "qfrc actuator" are of MuJoCo, "observation state" of LeRobot, "axis act"
# of KUKA, "feedback joints" of ABB; others are German, French,
# Chinese, Japanese and Korean.
_WORDS = {
    channel: tuple(frozenset(phrase.split()) for phrase in phrases.split(", "))
    for channel, phrases in {
        "position": "q, pos, position, positions, ang, angle, angles, theta, th, phi, "
        "qpos, jpos, observation state, axis act, feedback joints, winkel, "
        "位置, 角度, 위치, 각도",
        "velocity": "dq, qd, qdot, vel, velo, velocity, velocities, speed, speeds, "
        "spd, dtheta, thetadot, thd, dphi, phidot, qvel, jvel, geschwindigkeit, "
        "vitesse, omega, 速度, 속도",
        "torque": "tau, trq, tq, tor, torq, torque, torques, moment, moments, eff, "
        "effort, efforts, jts, qfrc actuator, actuator force, drehmoment, couple, "
        "トルク, 力矩, 扭矩, 转矩, 토크",
    }.items()
}
MEASURED = {"measured", "meas", "msr", "mes", "actual", "act", "real", "ist"}
MEASURED |= {"feedback", "fb", "fbk"}
"""Words of a channel that is measured."""

_CURRENT = {"current", "currents", "cur", "curr", "amp", "amps", "ampere", "amperes"}
_CURRENT |= {"i", "iq", "strom", "courant", "電流", "电流", "전류"}
_COMMANDED = {"target", "desired", "des", "cmd", "command", "commanded", "ref"}
_COMMANDED |= {"reference", "setpoint", "goal", "soll", "consigne"}
_COMMANDED |= {"commands", "targets", "references", "setpoints", "goals"}
_COMMANDED |= {"指令", "目標", "目标", "期望", "给定", "設定", "设定", "命令", "参考"}
_COMMANDED |= {"명령", "목표"}
_COMMANDS = {f"{short}{word}" for short in ("q", "pos", "p") for word in _COMMANDED}
_COMMANDS |= {"aspos"}  # KUKA
_COMMANDED |= {"d"}
_OTHER = {"error", "err", "limit", "action", "ext", "external", "computed", "residual"}
_OTHER |= {"ddot", "acc", "accel", "acceleration", "accelerations", "jerk", "std"}
_OTHER |= {"ddq", "qdd", "qddot", "qacc", "ddtheta", "thetadd"}  # accelerations
_OTHER |= {"gravity", "coriolis", "temperature", "temp", "temps", "voltage", "volts"}
_OTHER |= {"status", "mode", "dimensions", "temperatur"}
_OTHER |= {"fehler", "schleppfehler", "lagefehler", "abweichung", "regelabweichung"}
_OTHER |= {
    "erreur",
    "gravite",
    "加速度",
    "温度",
    "가속도",
    "온도",
    "偏差",
    "误差",
    "誤差",
}
_OTHER |= {"残差", "重力", "外力", "限位", "오차", "편차", "중력", "외력"}
_OTHER |= {"tcp", "tip", "ee", "eef", "cartesian"}  # the pose and wrench of a tool
_RATE = {"dot"}  # of a position: its velocity
_STATE = {"observation", "state"}  # LeRobot
_MEASURED = {"observation", "state", "actual"}
_DEGREES = ({"ai", "pos"}, {"axis", "act"}, {"feedback", "joints"})  # KUKA, ABB
_KORTEX = {"actuators"}  # Kinova's feedback, in degrees and degrees per second
# ODrive's, in turns and turns per second: ``axis0.encoder.pos_estimate``.
_ODRIVE = re.compile(r"axis\{\w+\}\.(?:encoder\.)?(?:pos|vel)_estimate$")
_BARE = {"j", "jnt", "joint", "joints", "axis", "axes", "ax", "achse", "a", "dof"}
_BARE |= {"axe", "軸", "轴", "关节", "축", "관절"}
_OF_POSITIONS = {"actual", "act", "measured"}
_BARE |= MEASURED - {"ist"}  # may also be a current: I_ist
_BARE |= {"deg", "degs", "degree", "degrees", "grad", "rad", "mm"}
# Of a velocity, they say of what.
_ANGULAR = {"ang", "angle", "angles", "angular", "winkel"}

BASE = {"base", "root", "trunk", "torso", "pelvis", "body", "imu", "odom", "floating"}
"""Words of a base that moves."""

CONTACTS = {"contact", "contacts", "touch", "stance", "grounded", "footswitch"}
"""Words of contact flags."""

_FORCES = {"force", "forces", "frc"}  # of a sliding joint
_BESIDE_FORCES = {"n", "kn", "k", "newton", "newtons"}
_BESIDE_FORCES |= {"drive", "motor", "actuator", "state"}

_JOINT = re.compile(r"\{[^{},]*\}")
_LAST_UNIT = re.compile(  # in brackets, or a word of its own
    r"(?P<name>.*[^ _])[ _]*(?:[\[(](?P<unit>[^\[\](){}]+)[\])]|[ _](?P<word>[^\W_]+))"
)
_ACCELERATION = re.compile(r"dot[^a-z]?dot", re.IGNORECASE)
_LETTERS = re.compile(r"[a-z]+")
_DIGITS = re.compile(r"\d+")
_OTHER_LETTERS = re.compile(r"[^\W\d_a-zà-ÿµμ]+")  # Japanese, Cyrillic and the like
_GREEK = str.maketrans({"θ": "theta", "τ": "tau", "ω": "omega"})
JOINED = re.compile(
    "加速度|速度|位置|角度|トルク|力矩|扭矩|转矩|電流|电流|温度|指令|目標|目标|期望|关节|軸|轴|"
    "给定|設定|设定|命令|参考|偏差|误差|誤差|残差|重力|外力|限位|摩擦|估计|推定|最大|最小|电机|"
    "モータ|時刻|時間|时间|가속도|속도|위치|각도|토크|전류|온도|관절|축|시간|명령|목표|오차|편차|"
    "중력|외력|마찰|추정|최대|최소|모터"
)
"""Words of logs in letters that need no marks between words, such as ``軸位置``."""
HUMP = re.compile(r"(?<=[a-z0-9])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])")
"""The place before a word that a capital letter begins: ``basePos``."""
# A word that another one follows without a mark: ``jointpos``, ``qmeas``.
_GLUED = re.compile(
    r"(?<![a-z])(joint(?=[a-z]{3})|(?:d?q|qd|tau|trq|pos|vel)"
    r"(?=(?:mes|meas|msr|act|actual|measured)(?![a-z]))|(?:ist|soll|achs|gelenk|motor|"
    r"antriebs|winkel)(?=(?:position|winkel|geschwindigkeit|moment|drehmoment|strom|"
    r"temperatur)(?![a-z])))"
)


@lru_cache(maxsize=2**15)
def words(pattern: str) -> frozenset[str]:
    """Return the words of a pattern without the joint, in lower case.

    Examples
    --------
    >>> sorted(words("axisQMsr_{joint}"))
    ['axis', 'axisqmsr', 'msr', 'q']
    >>> sorted(words("jointpos{number}"))
    ['joint', 'jointpos', 'pos']
    """
    rest = _JOINT.sub(" ", pattern).translate(_GREEK)
    lower = rest.lower()
    apart = _GLUED.sub(r"\1 ", HUMP.sub(" ", rest).lower())
    return frozenset(
        [
            *_LETTERS.findall(lower),
            *_LETTERS.findall(apart),
            *_OTHER_LETTERS.findall(lower),
            *JOINED.findall(lower),
        ]
    )


def further_words(pattern: str) -> frozenset[str]:
    """Return words and numbers of a pattern of no channel, unit, joint or reading.

    Examples
    --------
    >>> sorted(further_words("left_arm_q_{joint}")), sorted(further_words("q{number}"))
    (['arm', 'left'], [])
    """
    rest = next(
        (b for c in CHANNELS if (b := before_unit_of(c, pattern)) is not None), pattern
    )
    apart = _GLUED.sub(r"\1 ", HUMP.sub(" ", _JOINT.sub(" ", rest)).lower())
    of_channels = {word for c in CHANNELS for phrase in _WORDS[c] for word in phrase}
    found = {*_LETTERS.findall(apart), *_DIGITS.findall(apart)}
    return frozenset(found - of_channels - MEASURED - _BARE)


def states(names: Iterable[str]) -> tuple[str, ...]:
    """Return the names of observed states, which `channel_of` looks for in a log.

    Examples
    --------
    >>> states(["time", "observation.state", "action"])
    ('observation.state',)
    """
    return _states(tuple(names))


# Called several times with the same names of a log.
@lru_cache(maxsize=4)
def _states(names: tuple[str, ...]) -> tuple[str, ...]:
    likely = (name for name in names if "state" in name.lower())
    return tuple(name for name in likely if _STATE <= words(name))


@lru_cache
def _fitting(said: frozenset[str]) -> list[str]:
    """Return the channels that have a phrase of the words; many names have the same.

    An angular velocity is a velocity, and so is the rate of a position, ``q_dot``; an
    observed state is a position if no word says more.
    """
    fits = [c for c in CHANNELS if any(phrase <= said for phrase in _WORDS[c])]
    if _STATE <= said and len(fits) > 1:
        less = said - _STATE
        fits = [c for c in fits if any(phrase <= less for phrase in _WORDS[c])]
    if "omega" in said and said & BASE and fits == ["velocity"]:  # a gyroscope's
        less = said - {"omega"}
        fits = [c for c in fits if any(phrase <= less for phrase in _WORDS[c])]
    rate = fits == ["position"] and _RATE & said
    angular = fits == ["position", "velocity"] and _ANGULAR & said
    return ["velocity"] if rate or angular else fits


def channel_of(pattern: str, names: Iterable[str] = ()) -> str:
    """Return the channel of a pattern; empty for none, and for a clock: ``q.time``.

    Among commands, only those of position are a channel.  A plain ``action`` beside
    ``observation.state`` (LeRobot) is its target; elsewhere it is the output of a
    policy, in other units.

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
        fits = _fitting(frozenset(said))
        return "position_command" if fits == ["position"] else ""
    if said & _OTHER or is_time(pattern) or _ACCELERATION.search(pattern):
        return ""
    fits = _fitting(frozenset(said))
    if said & _COMMANDS or (said & _COMMANDED and fits == ["position"]):
        return "position_command"
    if said & _COMMANDED:
        return ""
    # torque_axis_act is a torque, vel_axis_act a share of the limit.
    if "torque" in fits:
        return "torque"
    if not fits and pattern.endswith("{joint}_w"):  # Drake
        return "velocity"
    if {"vel", "axis", "act"} <= said or len(fits) != 1:
        return ""
    return fits[0]


def is_bare(pattern: str) -> bool:
    """Return whether a pattern names a joint or an axis, perhaps a unit, and no more.

    Robots' makers call positions so: ``J1``, ``A1``, ``Joint 1 [deg]``.

    Examples
    --------
    >>> is_bare("J{number}[deg]"), is_bare("{joint}"), is_bare("J{number} load")
    (True, True, False)
    """
    return words(pattern) <= _BARE


def says_reading(pattern: str) -> bool:
    """Return whether a word says that a pattern is read, which may be of anything.

    Examples
    --------
    >>> says_reading("fbk_{number}"), says_reading("J{number}_actual")
    (True, False)
    """
    return bool(words(pattern) & (MEASURED - _OF_POSITIONS))


def says_nothing(pattern: str) -> bool:
    """Return whether no word of a pattern is known, of a channel or of another thing.

    Examples
    --------
    >>> says_nothing("Ist_{number}"), says_nothing("q_err_{number}")
    (True, False)
    """
    said = words(pattern)
    known = said & (_CURRENT | _COMMANDED | _COMMANDS | _OTHER | BASE | CONTACTS)
    return not (known or _fitting(frozenset(said)) or is_bare(pattern))


def is_of_another(pattern: str) -> bool:
    """Return whether a word says that a pattern is no measured channel of a joint.

    Examples
    --------
    >>> is_of_another("limit_{joint}_deg"), is_of_another("{joint}_deg")
    (True, False)
    """
    return bool(words(pattern) & (_OTHER | _COMMANDED | _COMMANDS))


def is_torque_command(pattern: str) -> bool:
    """Return whether a pattern denotes a torque that is commanded, not measured.

    Examples
    --------
    >>> is_torque_command("tau_cmd_{number}"), is_torque_command("tau_{number}")
    (True, False)
    """
    said = words(pattern)
    commanded = said & _COMMANDED and not said & _OTHER
    return bool(commanded and _fitting(frozenset(said)) == ["torque"])


def is_lone_command(pattern: str) -> bool:
    """Return whether a pattern denotes a command, and no word says of what.

    Examples
    --------
    >>> is_lone_command("{joint}.cmd"), is_lone_command("action_{number}")
    (True, True)
    >>> is_lone_command("tau_cmd_{joint}"), is_lone_command("{joint}_d")
    (False, False)
    """
    said = words(pattern)
    commands = (_COMMANDED | _COMMANDS | {"action", "actions"}) - {"d"}
    return bool(said & commands) and said <= commands | _BARE - MEASURED


def says_unit_of(channel: str, pattern: str) -> bool:
    """Return whether a pattern is a joint's name or number and a unit of the channel.

    Any other word may say that it is something else: a limit, a fan, a load cell.

    Examples
    --------
    >>> says_unit_of("torque", "{joint} [Nm]"), says_unit_of("velocity", "J1 [rpm]")
    (True, True)
    >>> says_unit_of("torque", "{joint} brake [Nm]")
    False
    """
    rest = before_unit_of(channel, pattern)
    return rest is not None and is_bare(rest)


def may_be_of_unit(channel: str, pattern: str) -> bool:
    """Return whether a unit of the channel ends a pattern without a known word.

    Examples
    --------
    >>> may_be_of_unit("torque", "{joint} load [Nm]"), may_be_of_unit("torque", "x")
    (True, False)
    >>> may_be_of_unit("torque", "{joint} friction error [Nm]")
    False
    """
    rest = before_unit_of(channel, pattern)
    return rest is not None and says_nothing(rest)


def may_be_effort(pattern: str) -> bool:
    """Return whether no word and no unit of a pattern says that it is no torque.

    Examples
    --------
    >>> may_be_effort("load_{number}"), may_be_effort("fan_{number}_rpm")
    (True, False)
    >>> may_be_effort("motor_{number}_pos")
    False
    """
    if any(before_unit_of(c, pattern) is not None for c in ("position", "velocity")):
        return False
    return says_nothing(pattern) or channel_of(pattern) == "torque"


def before_unit_of(channel: str, name: str) -> str | None:
    """Return a name without the unit of a channel that ends it; None without one.

    Examples
    --------
    >>> before_unit_of("torque", "elbow_Nm"), before_unit_of("position", "elbow [deg]")
    ('elbow', 'elbow')
    >>> before_unit_of("position", "elbow_Nm"), before_unit_of("position", "arm_m")
    (None, None)
    """
    found = _LAST_UNIT.fullmatch(name)
    if found is None or channel not in CHANNELS:
        return None
    unit = found["unit"] or found["word"]
    if len(unit) < 2 or not is_unit_of(channel, unit):  # m, N, A and the like
        return None
    return found["name"]


def is_current(pattern: str) -> bool:
    """Return whether a pattern denotes motor current, not torque."""
    said = words(pattern)
    torque = any(phrase <= said for phrase in _WORDS["torque"])
    return bool(said & _CURRENT) and not torque


def is_force(pattern: str) -> bool:
    """Return whether a pattern denotes the force of the drives of named joints.

    Numbered forces may as well be a sensor's, and other words say of what a force is.

    Examples
    --------
    >>> is_force("{joint}_force [N]"), is_force("F_{number}")
    (True, False)
    >>> is_force("{joint}_gripper_force"), is_force("{joint}_max_force")
    (False, False)
    """
    said = words(pattern)
    known = _FORCES | _BESIDE_FORCES | _MEASURED | _BARE
    return bool("{joint}" in pattern and said & _FORCES and said <= known)


def unit_of(channel: str, pattern: str) -> str:
    """Return the unit that a name states, or its maker's unit; empty for SI."""
    said = words(pattern)
    if channel == "position" and any(said >= some for some in _DEGREES):
        return "deg"
    if _KORTEX <= said and channel in ("position", "velocity"):
        return {"position": "deg", "velocity": "deg/s"}[channel]
    if _ODRIVE.search(pattern) and channel in ("position", "velocity"):
        return {"position": "rev", "velocity": "rev/s"}[channel]
    if channel == "position_command" and "aspos" in said:
        return "deg"
    return unit_of_a_name(channel, pattern)

"""PD drives and the delay of their commands, as actuators of an MJCF file.

MuJoCo reads an actuator's control from a buffer if it has a ``delay``: the control
alone is late, and the feedback ``-kp q - kd dq`` is not.  So a drive is a position
actuator with a delay, and commands of velocity and torque are further actuators with
the same delay.  In a file of the robot they take the place of its own actuators of
these joints; all other bytes stay as they are.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from html import escape
from typing import Any, NamedTuple

import numpy as np

from consistent_id._support.arrays import Matrix
from consistent_id.errors import ModelError
from consistent_id.estimation.estimate import Estimate
from consistent_id.export.export_formats import SideFile
from consistent_id.export.mjcf_assets import set_section
from consistent_id.export.mjcf_bodies import require_mujoco
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals import PDGains
from consistent_id.robot.loaders.mjcf import actuator_range
from consistent_id.robot.loaders.urdf_in_place import Edit, XmlText, number
from consistent_id.robot.loaders.xml import Element

SUFFIX = ".drives.xml"
"""Ending of the file with drives, beside the robot's own."""

STEP = 5e-4
"""Longest time step of the file [s].  Errors by the step are of first order."""

_SPARE = 2  # samples of the buffer: one at either end
_CLOSE = 1e-12  # relative; of numbers that are read back
_EXCEEDED = 1.05  # times a limit: drives at theirs measure a little more, by noise
_LEFT = 1e-6  # [rad or m] beyond a limit of position that is rounding

FURTHER = ("velocity", "torque")
"""Commands that drives may take beside that of position."""


_BEGIN = b"""<!-- Controls are late. MuJoCo begins with late controls of zero, which
move the robot. Begin with the first command of each actuator, after mj_resetData:
  for k in np.flatnonzero(model.actuator_delay):
      late = np.full((model.actuator_history[k][0], 1), command[k])
      mujoco.mj_initCtrlHistory(model, data, k, None, late)
-->
"""


@dataclass(frozen=True, slots=True)
class DelayedDrives:
    """Drives of joints, whose commands are late.

    Parameters
    ----------
    joints : tuple of str
    gains : PDGains
        One each.
    delay : float, [s]
        Of all commands; more than 0.
    further : tuple of str
        Those of `FURTHER` that the drives take; others are zero.
    exceeded : tuple of str
        Joints whose torque was larger than their limit in the robot's file, which
        cannot be that of the drives then.  They have none but a stated one.
    reached : tuple of (float, float), [rad or m]
        Lowest and highest logged position of each joint, if it is known.

    Raises
    ------
    ModelError
        If the delay is not positive, or there are no such commands.
    """

    joints: tuple[str, ...]
    gains: PDGains
    delay: float
    further: tuple[str, ...] = ()
    exceeded: tuple[str, ...] = ()
    reached: tuple[tuple[float, float], ...] = ()

    def __post_init__(self) -> None:
        if not 0.0 < self.delay < np.inf:
            raise ModelError(f"delay of commands is {self.delay} s, expected 0 or more")
        unknown = sorted(set(self.further) - set(FURTHER))
        if unknown:
            raise ModelError(
                f"commands beside position are {', '.join(self.further)}, expected "
                f"some of {', '.join(FURTHER)}"
            )

    def samples(self, step: float) -> int:
        """Return how many samples hold the delay at a time step [s]."""
        return int(np.ceil(self.delay / step)) + _SPARE


def delayed_drives(
    estimate: Estimate,
    gains: PDGains,
    delay: float,
    further: tuple[str, ...] = (),
    logs: Sequence[Recording] = (),
) -> DelayedDrives:
    """Return the drives of an estimate, with what its data say about limits.

    Parameters
    ----------
    gains : PDGains
    delay : float, [s]
    further : tuple of str
        See `DelayedDrives`.
    logs : sequence of Recording
        Further motions of the robot; their torques and positions count, too.
    """
    joints = estimate.model.robot.joint_names
    largest = dict.fromkeys(joints, 0.0)
    if (fit := estimate.fit) is not None:
        largest |= dict(zip(fit.joints, fit.efforts.tolist(), strict=True))
    known = [log.of(joints) for log in logs if set(joints) <= set(log.joints)]
    limits = {j.name: j.limits.effort for j in estimate.model.robot.joints}
    for peaks in map(_peaks, known):
        for joint, peak in zip(joints, peaks, strict=True):
            if limits[joint] > 0.0:  # zero: not known
                largest[joint] = max(largest[joint], peak / limits[joint])
    exceeded = tuple(joint for joint in joints if largest[joint] > _EXCEEDED)
    reached = tuple[tuple[float, float], ...]()
    if known:
        q: Matrix = np.vstack([log.position for log in known])
        lowest, highest = q.min(axis=0).tolist(), q.max(axis=0).tolist()
        reached = tuple(zip(lowest, highest, strict=True))
    own = gains.of(joints)
    return DelayedDrives(joints, own, delay, further, exceeded, reached)


def _peaks(log: Recording) -> list[float]:
    """Return each joint's largest known torque, zero if there is none."""
    if log.torque is None:
        return [0.0] * len(log.joints)
    known = True if log.torque_known is None else log.torque_known
    return np.where(known, abs(log.torque), 0.0).max(axis=0).tolist()  # type: ignore[no-any-return]


def drives_file(
    content: bytes, compiled: Callable[[bytes], Any], drives: DelayedDrives
) -> tuple[SideFile | None, tuple[str, ...]]:
    """Return an MJCF file with drives that are late, and notes on it.

    There is no file, and the note says why, if the robot's file has actuators that
    cannot be replaced, or the drives have springs.

    Parameters
    ----------
    content : bytes
        The robot's file, without includes.
    compiled : callable
        From the content of a file to its ``mujoco.MjModel``.
    drives : DelayedDrives
    """
    try:
        return _written(content, compiled, drives)
    except ModelError as cause:
        return None, (f"no file with drives and their delay was made: {cause}",)


def _written(
    content: bytes, compiled: Callable[[bytes], Any], drives: DelayedDrives
) -> tuple[SideFile, tuple[str, ...]]:
    if np.isfinite(drives.gains.stiffness).any():
        raise ModelError("the springs behind motors are not in the file either")
    model, document = compiled(content), XmlText.of(content)
    if np.any(model.actuator_armature) or np.any(model.actuator_damping):
        raise ModelError(
            "actuators of the file have armature or damping; state them at the joints"
        )
    step = min(STEP, float(model.opt.timestep))
    elements = [e for s in document.root.all("actuator") for e in s.children]
    names = [model.actuator(k).name for k in range(model.nactuator)]
    if model.nactuator != model.nu or [e.name for e in elements] != names:
        raise ModelError(
            f"the file has {len(elements)} actuators, the compiled model "
            f"{model.nactuator} with {model.nu} controls; only actuators with one "
            "control each, in the same order, can be replaced"
        )
    option = {"timestep": number(step), "integrator": "implicitfast"}
    place = _ActuatedFile(document, model, elements)
    lines = _DriveLines(drives, step)
    start = document.root.start
    edits = [
        Edit(start, start, _BEGIN),
        *set_section(document, "option", option),
        *_actuators(place, lines),
        *_limits(place, drives),
        *_keyframes(place, drives),
    ]
    written = document.spliced(edits)
    _require_drives(compiled(written), drives, step)
    notes = (_note(drives, step), *_left_limits(model, drives))
    return SideFile(SUFFIX, written), notes


def _note(drives: DelayedDrives, step: float) -> str:
    acts = max(drives.delay, step)
    short = ", which is one step" if drives.delay < acts else ""
    names = " and ".join(("position", *drives.further))
    beyond = ", ".join(drives.exceeded)
    without = (
        f"; without the robot's file's limits for {beyond}, whose torque was larger"
    )
    return (
        f"the file *{SUFFIX} beside it has the PD drives, for commands of {names}, "
        f"which act {1e3 * acts:.3g} ms late{short}, in steps of {1e3 * step:g} ms; "
        f"they are in place of the file's own actuators{without * bool(beyond)}"
    )


def _left_limits(model: Any, drives: DelayedDrives) -> list[str]:
    """Return the note on joints whose logged positions leave the file's limits."""
    left = []
    for joint, (lowest, highest) in zip(drives.joints, drives.reached, strict=False):
        j = model.joint(joint).id
        lower, upper = model.jnt_range[j]
        beyond = max(lower - lowest, highest - upper)
        if model.jnt_limited[j] and beyond > _LEFT:
            left.append(f"{joint} {1e3 * beyond:.3g}")
    if not left:
        return []
    return [
        "logged positions are beyond the file's joint limits, by [mrad or mm]: "
        f"{', '.join(left)}; MuJoCo stops these joints there unless its limits are off"
    ]


class _ActuatedFile(NamedTuple):
    """A file's text, its compiled model, and its actuators in the model's order."""

    document: XmlText
    model: Any
    actuators: list[Element]

    def of(self, joint: str) -> list[int]:
        """Return the actuators that act on a joint alone."""
        kinds = require_mujoco().mjtTrn
        direct = (int(kinds.mjTRN_JOINT), int(kinds.mjTRN_JOINTINPARENT))
        j = self.model.joint(joint).id
        return [
            k
            for k, kind in enumerate(self.model.actuator_trntype.tolist())
            if kind in direct and int(self.model.actuator_trnid[k][0]) == j
        ]

    def limit(self, joint: str) -> float:
        """Return the largest torque of a joint's own actuators, inf if there is none.

        It is stated, or that of the largest control of a motor.
        """
        ranges = [actuator_range(self.model, k) for k in self.of(joint)]
        low, high = np.sum(ranges, axis=0) if ranges else (0.0, 0.0)
        return float(max(-low, high) or np.inf)


class _DriveLines(NamedTuple):
    """Writes the elements of drives."""

    drives: DelayedDrives
    step: float

    def position(self, k: int, name: str, limit: float) -> str:
        """Return the element of a joint's PD drive, of that name."""
        kp, kd = self.drives.gains.kp[k], self.drives.gains.kd[k]
        return self._line(k, name, kp, f"0 {number(-kp)} {number(-kd)}", limit)

    def further(self, k: int) -> list[str]:
        """Return elements of commands of velocity and torque."""
        gain = {"velocity": self.drives.gains.kd[k], "torque": 1.0}
        joint = self.drives.joints[k]
        return [
            self._line(k, f"{joint} {name}", gain[name], "0 0 0", np.inf)
            for name in self.drives.further
        ]

    def _line(self, k: int, name: str, gain: float, bias: str, limit: float) -> str:
        """Return an element that does not depend on the file's defaults."""
        limited = bool(np.isfinite(limit))
        force = f' forcerange="{number(-limit)} {number(limit)}"' if limited else ""
        samples = self.drives.samples(self.step)
        return (
            f'<general name="{escape(name)}" joint="{escape(self.drives.joints[k])}"'
            ' gear="1 0 0 0 0 0" dyntype="none" gaintype="fixed" biastype="affine"'
            ' ctrllimited="false" actlimited="false"'
            f' gainprm="{number(gain)}" biasprm="{bias}"'
            f' forcelimited="{str(limited).lower()}"{force}'
            f' delay="{number(self.drives.delay)}" nsample="{samples}"'
            ' interp="linear"/>'
        )


def _actuators(place: _ActuatedFile, lines: _DriveLines) -> list[Edit]:
    """Return edits that replace a joint's actuator, remove others, and add the rest."""
    document, drives = place.document, lines.drives
    edits, added = list[Edit](), list[str]()
    for k, joint in enumerate(drives.joints):
        limit = float(drives.gains.torque_limit[k])
        if drives.further:  # their sum is limited, by the joint
            limit = np.inf
        elif not np.isfinite(limit) and joint not in drives.exceeded:
            limit = place.limit(joint)
        own = [place.actuators[a] for a in place.of(joint)]
        name = own[0].name if own and own[0].name else joint
        line = lines.position(k, name, limit)
        if own:
            edits.append(_replaced(document, own[0], line))
            edits += [_replaced(document, other, "") for other in own[1:]]
        else:
            added.append(line)
    for k in range(len(drives.joints)):
        added += lines.further(k)
    if added:
        body = "".join(f"    {line}\n" for line in added)
        end = document.root.close
        edits.append(Edit(end, end, _encoded(f"  <actuator>\n{body}  </actuator>\n")))
    return edits


def _replaced(document: XmlText, element: Element, line: str) -> Edit:
    """Return the edit that puts a line in place of an element with its children."""
    tag = document.tag(element)
    stop = tag.stop
    if not tag.closed:
        stop = document.data.index(b">", element.close) + 1
    return Edit(element.start, stop, _encoded(line))


def _encoded(text: str) -> bytes:
    return text.encode("ascii", "xmlcharrefreplace")


def _limits(place: _ActuatedFile, drives: DelayedDrives) -> list[Edit]:
    """Return edits that limit the sum of a joint's actuators, where it has several.

    Limits of joints that were exceeded are lifted.
    """
    named = {e.name: e for e in place.document.root.below() if e.tag == "joint"}
    edits = list[Edit]()
    for joint, stated in zip(drives.joints, drives.gains.torque_limit, strict=True):
        exceeded = joint in drives.exceeded
        limit = float(stated)
        if not np.isfinite(limit) and not exceeded:
            limit = place.limit(joint)
        values = dict[str, str]()
        if drives.further and np.isfinite(limit):
            values["actuatorfrcrange"] = f"{number(-limit)} {number(limit)}"
            values["actuatorfrclimited"] = "true"
        elif exceeded:
            values["actuatorfrclimited"] = "false"
        if values and joint in named:
            edits += place.document.set(named[joint], values)
    return edits


def _keyframes(place: _ActuatedFile, drives: DelayedDrives) -> list[Edit]:
    """Return edits that command the joints of keyframes to stay where they are."""
    root, model = place.document.root, place.model
    keys = [key for s in root.all("keyframe") for key in s.all("key")]
    if len(keys) != model.nkey:
        raise ModelError("the file's keyframes are not those of the compiled model")
    edits = list[Edit]()
    for key, qpos, ctrl in zip(keys, model.key_qpos, model.key_ctrl, strict=True):
        controls: dict[int, float] = dict(enumerate(ctrl.tolist()))
        added = list[float]()
        for joint in drives.joints:
            at, own = float(qpos[int(model.joint(joint).qposadr[0])]), place.of(joint)
            if own:
                controls[own[0]] = at
                for other in own[1:]:
                    del controls[other]
            else:
                added.append(at)
        added += [0.0] * (len(drives.further) * len(drives.joints))
        text = _text([*controls.values(), *added])
        edits += place.document.set(key, {"ctrl": text})
    return edits


def _text(values: Iterable[float]) -> str:
    return " ".join(number(value) for value in values)


def _require_drives(model: Any, drives: DelayedDrives, step: float) -> None:
    """Refuse a file whose drives MuJoCo would read as others."""
    gains = drives.gains
    for joint, kp, kd in zip(drives.joints, gains.kp, gains.kd, strict=True):
        j = model.joint(joint).id
        found = [k for k in range(model.nu) if int(model.actuator_trnid[k][0]) == j]
        wanted = [kp, 0.0, -kp, -kd, drives.delay]
        read = [
            [
                model.actuator_gainprm[k][0],
                *model.actuator_biasprm[k][:3],
                model.actuator_delay[k],
            ]
            for k in found
        ]
        if not any(np.allclose(row, wanted, rtol=_CLOSE, atol=0.0) for row in read):
            raise ModelError(f"the drive of {joint} would not read back as written")
    kinds = require_mujoco().mjtIntegrator
    as_written = model.opt.integrator == kinds.mjINT_IMPLICITFAST
    if abs(model.opt.timestep - step) > _CLOSE or not as_written:
        raise ModelError(
            f"a time step of {step} s, implicitfast, would read back as "
            f"{model.opt.timestep} s, integrator {model.opt.integrator}"
        )

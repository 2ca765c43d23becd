"""Drives as configurations of learning environments, and a page on what a file lacks.

The configurations, for Isaac Lab and mjlab, are Python source, to be imported where the
environment is installed, without this package.  The page beside an exported file says
how to add terms and a delay that the format does not have.
"""

from collections.abc import Iterator, Mapping, Sequence
from pprint import pformat
from typing import NamedTuple

import numpy as np

from consistent_id.estimation.estimate import Estimate
from consistent_id.export.export_formats import (
    EXPORT_FORMATS,
    Export,
    ExportFormat,
    SideFile,
    comment_text,
    exporter,
    provenance,
    without_doubtful,
)
from consistent_id.export.file_values import (
    joint_drives,
    not_expressed,
    parameters_in_file,
)
from consistent_id.recordings.signals import PDGains
from consistent_id.regression.drive.term import DriveTerm

_ISAAC_LAB = '''"""{line}.

Put `actuators(physics_dt)` into the ArticulationCfg of Isaac Lab 2.2 or later on Isaac
Sim 5.0 or later, where joint friction is a torque.
"""

from isaaclab.actuators import DelayedPDActuatorCfg

DELAY = {delay!r}  # s, of commands
{tables}

def actuators(physics_dt):
    """Return the actuators, for a time step of the physics [s]."""
    steps = round(DELAY / physics_dt)
    return {{
        "drives": DelayedPDActuatorCfg(
            joint_names_expr=list(ARMATURE),
            effort_limit={limit},
            stiffness={kp},
            damping={kd},
            armature=ARMATURE,
            friction=FRICTION,
            dynamic_friction=FRICTION,
            viscous_friction=VISCOUS,
            min_delay=steps,
            max_delay=steps,
        )
    }}
'''

_MJLAB = '''"""{line}.

Put `actuators(timestep)` into the EntityArticulationInfoCfg of mjlab, with the MJCF
file of the same robot: that has armature, damping, friction and offsets.  In MuJoCo
Playground, which takes gains from the MJCF itself, use STIFFNESS and DAMPING as kp and
kv of its position actuators.
"""

from mjlab.actuator import BuiltinPositionActuatorCfg, DelayedActuatorCfg

DELAY = {delay!r}  # s, of commands
{tables}

def actuators(timestep):
    """Return the actuators, for a time step of the physics [s]."""
    steps = round(DELAY / timestep)
    return tuple(
        DelayedActuatorCfg(
            base_cfg=BuiltinPositionActuatorCfg(
                target_names_expr=(joint,),
                stiffness={kp_of},
                damping={kd_of},
                effort_limit={limit_of},
            ),
            delay_target="position",
            delay_min_lag=steps,
            delay_max_lag=steps,
        )
        for joint in JOINTS
    )
'''

_README = """<!-- {line} -->
# {file}: {content}

## Error of the file, and notes

{notes}

## Terms that the file does not have

{terms}{delay}
"""

_NO_TERMS = "None: the file has every drive term of the estimate."

_TERMS = """Take each from the torque that drives the joint, in every step. `q`, `dq`,
`ddq` are position, velocity and acceleration of the joint in SI units; `s(dq)` is the
sign of the velocity, smoothed as `tanh(dq / velocity_scale)` where a scale is given;
`load` is the torque that the bodies demand of the joint. A rotor inertia goes into the
simulator's `armature` of the joint, if it has one. `consistent-id export --format
numpy` writes a function with all terms.

| joint | coefficient | value | torque |
|---|---|---|---|"""

_IN_FILE = """

## Delay of the commands: {ms:.3g} ms

`{drives}` is the same robot with its PD drives and this delay, in place of its own
actuators: the commands are `data.ctrl`, as the robot's own are. MuJoCo begins with
commands of zero; let it begin with the first command:

```python
import numpy as np

mujoco.mj_resetData(model, data)
for k in np.flatnonzero(model.actuator_delay):
    late = np.full((model.actuator_history[k][0], 1), command[k])
    mujoco.mj_initCtrlHistory(model, data, k, None, late)
```

Its rollout error is that of motion without contacts and joint limits, with

```python
off = mujoco.mjtDisableBit
model.opt.disableflags |= off.mjDSBL_CONTACT | off.mjDSBL_LIMIT
```

The file has a short time step, for which `nsample` holds the delay. With a shorter one,
raise `nsample` above the delay over the step: MuJoCo takes a buffer that is too short
in silence. With a longer one, errors by the step grow, and a delay below one step acts
as one step.
"""

_DELAY = """

## Delay of the commands: {ms:.3g} ms

MuJoCo, in Python:

```python
import collections

n = round({delay:g} / model.opt.timestep)
late = collections.deque([command] * (n + 1), maxlen=n + 1)
# in every step:
late.append(command)
data.ctrl[:] = late[0]
mujoco.mj_step(model, data)
```
"""

_ELSEWHERE = """
Isaac Lab: `DelayedPDActuatorCfg` with `min_delay` and `max_delay` both
`round({delay:g} / physics_dt)`, as `consistent-id export --format isaaclab` writes it.
mjlab: `DelayedActuatorCfg`, as `--format mjlab` writes it. Other simulators: keep the
last commands in a buffer."""


@exporter("isaaclab")
def to_isaac_lab(
    estimate: Estimate,
    *,
    gains: PDGains | None = None,
    delay: float = 0.0,
    allow_refused: bool = False,
) -> Export:
    """Return the drives as actuators of Isaac Lab: Python source.

    Parameters
    ----------
    estimate : Estimate
    gains : PDGains, optional
        Gains of the joints' drives; without them, stiffness and damping must be filled
        in.
    delay : float, [s]
        Delay of commands.
    allow_refused : bool
        Export refused estimates, too.

    Raises
    ------
    ProblemError
        If the estimate is refused.
    """
    tables = {
        name: _values(estimate, parameter)
        for name, parameter in (
            ("ARMATURE", "armature"),
            ("FRICTION", "friction"),
            ("VISCOUS", "damping"),
        )
    }
    expressed = ("damping", "friction", "armature")
    notes = not_expressed(estimate, "Isaac Lab", expressed)
    source = _Template("isaaclab", _ISAAC_LAB, tables, notes)
    return _export(estimate, source, gains, delay)


@exporter("mjlab")
def to_mjlab(
    estimate: Estimate,
    *,
    gains: PDGains | None = None,
    delay: float = 0.0,
    allow_refused: bool = False,
) -> Export:
    """Return gains and delay as actuators of mjlab, to go with `to_mjcf`.

    Parameters and errors are those of `to_isaac_lab`.
    """
    joints: dict[str, object] = {"JOINTS": list(estimate.model.robot.joint_names)}
    note = "the MJCF file has armature, damping, friction and offsets: export it, too"
    source = _Template("mjlab", _MJLAB, joints, (note,))
    return _export(estimate, source, gains, delay)


class _Template(NamedTuple):
    """A format's name, its Python source with gaps, tables to fill in, and notes."""

    form: str
    text: str
    tables: Mapping[str, object]
    notes: tuple[str, ...]


def _export(
    estimate: Estimate, template: _Template, gains: PDGains | None, delay: float
) -> Export:
    given, notes = dict(template.tables), template.notes
    names = {"kp": "None", "kd": "None", "limit": "None"}
    if gains is not None:
        of_joints = gains.of(len(estimate.model.robot))
        given |= {
            "STIFFNESS": _by_joint(estimate, of_joints.kp),
            "DAMPING": _by_joint(estimate, of_joints.kd),
        }
        names |= {"kp": "STIFFNESS", "kd": "DAMPING"}
        if np.isfinite(of_joints.torque_limit).all():
            given["LIMIT"] = _by_joint(estimate, of_joints.torque_limit)
            names["limit"] = "LIMIT"
    else:
        notes = (*notes, "no gains are known: fill in stiffness and damping")
    single = {
        f"{key}_of": name if name == "None" else f"{name}[joint]"
        for key, name in names.items()
    }
    written = "".join(
        f"{name} = {pformat(table, width=72, sort_dicts=False)}\n"
        for name, table in given.items()
    )
    line = provenance(estimate).replace('"""', "'''").replace("\\", "/")
    text = template.text.format(
        line=line, delay=float(delay), tables=written, **names, **single
    )
    return Export(template.form, text.encode(), notes)


def _values(estimate: Estimate, parameter: str) -> dict[str, float]:
    return {
        drive.joint: float(drive.simulated(parameter) or 0.0)
        for drive in joint_drives(estimate)
    }


def _by_joint(estimate: Estimate, values: np.ndarray) -> dict[str, float]:
    names = estimate.model.robot.joint_names
    return dict(zip(names, values.tolist(), strict=True))


def readme(
    estimate: Estimate,
    form: str,
    file: str,
    notes: Sequence[str] = (),
    *,
    delay: float = 0.0,
    drives: str | None = None,
) -> SideFile:
    """Return the page beside an exported file: what the file lacks, and how to add it.

    Parameters
    ----------
    form : str
        Name of an entry of `EXPORT_FORMATS`.
    file : str
        Name of the exported file.
    notes : sequence of str
        Sentences on its error and its contents.
    delay : float, [s]
        Delay of commands; it is part of the formats that take gains.
    drives : str, optional
        Name of a file beside it that has drives with this delay.
    """
    known = next(entry for entry in EXPORT_FORMATS if entry.name == form)
    rows = "".join(_missing(estimate, known))
    late = delay != 0.0 and not known.takes_gains
    text = _README.format(
        line=comment_text(provenance(estimate)),
        file=file,
        content=known.content,
        notes="\n".join(f"- {note}" for note in notes) or "None.",
        terms=f"{_TERMS}{rows}" if rows else _NO_TERMS,
        delay=_late(delay, drives) if late else "",
    )
    return SideFile(".README.md", text.encode())


def _late(delay: float, drives: str | None) -> str:
    """Return how commands are delayed: by a file that has it, or by the user."""
    here = _DELAY if drives is None else _IN_FILE
    return (here + _ELSEWHERE).format(delay=delay, ms=1e3 * delay, drives=drives)


def _missing(estimate: Estimate, known: ExportFormat) -> Iterator[str]:
    """Yield rows on coefficients that differ in a file."""
    written = without_doubtful(estimate)[0] if known.lean else estimate
    left, model = parameters_in_file(written, known.holds), estimate.model
    columns = {
        (joint.name, name): _column(term)
        for joint, terms in zip(model.robot.driven, model.terms, strict=True)
        for term in terms.terms
        for name in term.names
    }
    for i, (owner, name) in enumerate(model.layout.drive, model.layout.inertial_size):
        value = estimate.parameters[i] - left[i]
        if value != 0.0:
            column, unit = columns.get((owner, name), name), model.layout.units[i]
            yield f"\n| {owner} | {name} | {value:.6g} {unit} | {column} |"


def _column(term: DriveTerm) -> str:
    """Return the law in the first line of a term's description, and its shapes."""
    first = (type(term).__doc__ or "").strip().partition("\n")[0]
    law = first.split("``")[1] if "``" in first else ", ".join(term.names)
    law = law.replace("|", "\\|")
    shapes = ", ".join(f"{name} {value:g}" for name, value in term.shapes.items())
    return f"`{law}`" + (f", {shapes}" if shapes else "")

"""Drives as configurations of learning environments: Isaac Lab, and mjlab.

They are Python source, to be imported where the environment is installed, without this
package.
"""

from collections.abc import Mapping
from pprint import pformat
from typing import NamedTuple

import numpy as np

from consistent_id.estimation.estimate import Estimate
from consistent_id.export.export_formats import Export, exporter, provenance
from consistent_id.export.file_values import joint_drives, not_expressed
from consistent_id.recordings.signals import PDGains

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

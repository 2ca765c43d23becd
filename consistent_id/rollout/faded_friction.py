"""Stribeck friction that the rows of a torque fit do not show.

Where rows of slow joints are left out, or a joint hardly is slow, such friction has
faded in nearly all rows.  Its coefficient may then have any value.  No rollout corrects
it, because MuJoCo has no such friction, but it would hold the joint at rest.
"""

from collections.abc import Mapping, Sequence

import msgspec
import numpy as np

from consistent_id.problems.file import DriveTable, JointTable, PreparationTable
from consistent_id.problems.study import Study

_SLOWER = 2.0  # times the least speed of rows: Stribeck velocities that rows may show
_SHOWN = (
    0.05  # of Coulomb friction's column, from which on rows show that of Stribeck's
)


def without_slow_friction(
    preparation: PreparationTable,
    drive: DriveTable,
    exceptions: Mapping[str, JointTable],
    joints: Sequence[str],
) -> dict[str, JointTable]:
    """Return joints without Stribeck friction of velocities near the least of rows.

    Rows around reversals are left out as well, so hardly one is as slow as the limit.

    Parameters
    ----------
    drive : DriveTable
        Terms of all joints.
    exceptions : mapping of str to JointTable
    joints : sequence of str
    """
    slowest, kept = preparation.least_joint_speed, dict(exceptions)
    if not isinstance(slowest, float):
        return kept
    for name in joints:
        own = exceptions.get(name, JointTable())
        stated = drive if own.stribeck_velocity is msgspec.UNSET else own
        if stated.stribeck_velocity and stated.stribeck_velocity < _SLOWER * slowest:
            kept[name] = _without(own)
    return kept


def hidden_friction(study: Study) -> tuple[str, ...]:
    """Return the joints whose Stribeck friction training rows do not show."""
    model = study.problem.model
    layout = model.layout
    if not layout.drive_indices("stribeck"):
        return ()
    norms = np.linalg.norm(study.regression.stacked(), axis=0)
    return tuple(
        joint
        for joint in model.robot.joint_names
        if {f"{joint}.stribeck", f"{joint}.coulomb"} <= set(layout.names)
        and norms[layout.index(f"{joint}.stribeck")]
        < _SHOWN * norms[layout.index(f"{joint}.coulomb")]
    )


def hidden_notes(joints: Sequence[str]) -> tuple[str, ...]:
    """Say that friction is left out; nothing for no joints."""
    if not joints:
        return ()
    return (
        f"Stribeck friction of {', '.join(joints)} is left out: hardly a row is slow "
        "enough to show it",
    )


def without_stribeck(
    tables: Mapping[str, JointTable], joints: Sequence[str]
) -> dict[str, JointTable]:
    """Return the tables of joints, some of which have no Stribeck friction."""
    own = {name: _without(tables.get(name, JointTable())) for name in joints}
    return {**tables, **own}


def _without(joint: JointTable) -> JointTable:
    """Return a joint without Stribeck friction: zero stands for none."""
    return msgspec.structs.replace(joint, stribeck_velocity=0.0, stribeck_exponent=0.0)

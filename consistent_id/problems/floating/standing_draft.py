"""What a draft takes for known of a robot that stands: its legs, their rotors, slip."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from consistent_id.problems.file import DriveTable
from consistent_id.problems.floating.contact_guess import (
    SLIP,
    require_standing,
    share_at_rest,
)
from consistent_id.problems.robot_logs import RobotLogs
from consistent_id.recordings.recording import Recording
from consistent_id.robot.loaders.mjcf_assets import read_spec
from consistent_id.robot.loaders.robot_file import is_mjcf
from consistent_id.robot.model import RobotModel

# Share of the samples that must keep rows, for slipping feet to go.
_ENOUGH = 0.25


@dataclass(frozen=True, slots=True)
class StandingDraft:
    """What is written into a draft for a floating base.

    Parameters
    ----------
    known_links : tuple of str
        Bodies that are taken from the model's file: all but the base.
    rotors : dict of str to float
        Rotor inertias of the model's file, by parameter [kg m^2].
    most_slip : float, optional, [m/s]
        Of feet that stand on the ground.
    rests : bool
        Whether torque of joints at rest is declared unknown.
    round_feet : bool
        Whether feet are balls, whose radius is found in the log.
    """

    known_links: tuple[str, ...]
    rotors: dict[str, float] = field(hash=False)
    most_slip: float | None
    rests: bool
    round_feet: bool

    @property
    def preparation(self) -> dict[str, Any]:
        """Keys of the table of preparation."""
        keys: dict[str, Any] = {"most_slip": self.most_slip}
        if self.rests:
            keys["least_joint_speed"] = "estimated"
        if self.round_feet:
            keys["contact_radius"] = "estimated"
        return keys

    @property
    def comments(self) -> dict[str, str]:
        """What to say of it in a problem file, by key."""
        found = {
            "constraints.known_links": "GUESS: as the file has them; on the ground "
            "they cannot be told from the base",
            "data.base": "GUESS: which columns they are, and where the unit is.",
            "data.contacts": "GUESS: where feet touch; samples within guard [s] of a "
            "change are left out.",
            "data.preparation.most_slip": "m/s; feet that move faster slip",
            "data.preparation.least_joint_speed": "at rest, friction is whatever "
            "balances the joint",
            "data.preparation.contact_radius": "feet give way: where they touch is "
            "found in the log",
        }
        if self.rotors:
            found["constraints.fixed"] = "GUESS: armatures of the file"
        return found


def standing_draft(
    logs: RobotLogs, raws: Sequence[Recording], model: Path, drive: DriveTable
) -> StandingDraft | None:
    """Return what a draft says of a floating base; None if it is fixed.

    Parameters
    ----------
    raws : sequence of Recording
        As they were read.
    model : Path
        The robot's file.
    drive : DriveTable
        Terms of all joints.

    Raises
    ------
    RecordingError
        If feet are taken to stand all the time, and do not.
    """
    found, robot = logs.floating, logs.robot
    if found is None:
        return None
    if found.standing:
        require_standing(robot, raws, found.names, model)
    contacts = len(found.beside.contacts)
    return StandingDraft(
        robot.link_names[1:],
        _armatures(robot, model) if drive.rotor_inertia else {},
        SLIP if contacts > 1 and share_at_rest(robot, raws) > _ENOUGH else None,
        contacts > 0,
        any(contact.radius > 0.0 for contact in found.beside.contacts),
    )


def _armatures(robot: RobotModel, model: Path) -> dict[str, float]:
    """Return the rotor inertias that an MJCF file states; a URDF states none."""
    if not is_mjcf(model):
        return {}
    import mujoco

    compiled = read_spec(model, mujoco).compile()
    stated = {
        compiled.joint(j).name: float(compiled.dof_armature[compiled.jnt_dofadr[j]])
        for j in range(compiled.njnt)
    }
    return {
        f"{joint}.rotor_inertia": stated[joint]
        for joint in robot.joint_names
        if stated.get(joint, 0.0) > 0.0
    }

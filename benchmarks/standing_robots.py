"""Robots that stand on their feet, with a box on the trunk that no model knows.

The quadruped is Go2 of the recordings' folder, on four balls; the humanoid is G1 of
`example-robot-data`, which comes with Pinocchio, on two soles.
"""

import os
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from sysconfig import get_paths
from typing import Any

import numpy as np

import consistent_id as ci
from consistent_id.robot.inertia import INERTIAL_NAMES
from consistent_id.robot.loaders.mjcf_spec import read_spec

EXAMPLES = "share/example-robot-data/robots"


@dataclass(frozen=True, slots=True)
class Foot:
    """A foot: its body in MuJoCo, the joints that place it, and its contact.

    `point` and `radius` are those of `ContactFlags`; `rest` is the height of the
    body's origin above the ground, m.  A sole transmits moments, and stays level.
    """

    body: str
    frame: str
    joints: tuple[str, ...]
    rest: float
    point: tuple[float, float, float] = (0.0, 0.0, 0.0)
    radius: float = 0.0
    sole: bool = False


@dataclass(frozen=True, slots=True)
class Sway:
    """Sums of sinusoids: frequencies, Hz, and amplitudes of each.

    Of the base's places, m, and turns, rad, and of the joints that bear no weight, rad.
    """

    frequencies: tuple[float, ...]
    places: tuple[float, ...]
    turns: tuple[float, ...]
    joints: tuple[float, ...]


@dataclass(frozen=True, slots=True, eq=False)
class StandingRobot:
    """A robot as its maker describes it, and how it stands.

    `trunk` bears the box: its mass, kg, place, m, and central moments, kg m^2.
    `posture` are joint positions other than zero, `gains` those of the joints'
    controllers, N m/rad and N m s/rad.  `cutoff`, Hz, is that of its logs: the higher,
    the fewer rows are lost to friction that jumps, and the noisier accelerations are.
    Of 30 and 60 Hz it is the one with which trunks of seeds 100 and 101 are found best.
    """

    path: Path
    nominal: ci.RobotModel
    trunk: str
    box: tuple[float, tuple[float, ...], tuple[float, ...]]
    feet: tuple[Foot, ...]
    height: float
    gains: tuple[float, float]
    sway: Sway
    cutoff: float
    posture: Mapping[str, float] = field(default_factory=dict)

    @property
    def pose(self) -> dict[str, float]:
        """The posture of joints that the nominal robot has, rad."""
        own = self.nominal.joint_names
        return {name: angle for name, angle in self.posture.items() if name in own}

    @property
    def number(self) -> int:
        """Which link the trunk is."""
        return self.nominal.link_names.index(self.trunk)

    @property
    def true_trunk(self) -> ci.InertialParameters:
        """The trunk with its box."""
        mass, place, moments = self.box
        box = ci.InertialParameters.from_central(mass, place, np.diag(moments))
        return self.nominal.links[self.number].nominal + box

    @property
    def true(self) -> ci.RobotModel:
        """The robot with its box."""
        links = list(self.nominal.links)
        links[self.number] = replace(links[self.number], nominal=self.true_trunk)
        return replace(self.nominal, links=tuple(links))

    def spec(self) -> Any:
        """Return the robot for MuJoCo, on level ground and without its box."""
        import mujoco

        own = self.path.suffix == ".xml"
        spec = read_spec(self.path, mujoco) if own else _of_urdf(self.path, mujoco)
        size = [5.0, 5.0, 0.1]
        spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=size)
        return spec

    def known(self) -> dict[str, float]:
        """Return what a log of the hanging robot tells: other bodies, rotor inertias.

        It hangs by its trunk, so that all else moves.
        """
        links = [link for link in self.nominal.links if link.name != self.trunk]
        known = {
            f"{link.name}.{name}": float(value)
            for link in links
            for name, value in zip(INERTIAL_NAMES, link.nominal.vector, strict=True)
        }
        model = self.spec().compile()
        rotors = {
            f"{name}.rotor_inertia": float(model.joint(name).armature[0])
            for name in self.nominal.joint_names
        }
        return known | rotors


def quadruped() -> StandingRobot:
    """Return Go2: 12 joints, feet that are balls."""
    path = Path(os.environ["CONSISTENT_ID_DATASETS"]) / "unitree_go2" / "go2.xml"
    legs = ("FL", "FR", "RL", "RR")
    joints = ("hip", "thigh", "calf")
    feet = tuple(
        Foot(
            f"{leg}_foot",
            f"{leg}_calf",
            tuple(f"{leg}_{joint}_joint" for joint in joints),
            rest=0.022,
            point=(-0.002, 0.0, -0.213),
            radius=0.022,
        )
        for leg in legs
    )
    return StandingRobot(
        path,
        ci.robot.load_mjcf(path, base="floating"),
        trunk="base",
        box=(2.0, (0.05, 0.02, 0.08), (0.02, 0.03, 0.04)),
        feet=feet,
        height=0.27,
        gains=(200.0, 4.0),
        sway=Sway(
            (0.7, 2.0, 4.5), (0.008, 0.003, 0.0003), (0.06, 0.03, 0.02), (0, 0, 0)
        ),
        cutoff=60.0,
        posture={
            f"{leg}_{joint}_joint": angle
            for leg in legs
            for joint, angle in (("thigh", 0.9), ("calf", -1.8))
        },
    )


def humanoid() -> StandingRobot:
    """Return G1: 29 joints, soles, a torso on a waist of three joints."""
    path = Path(get_paths()["purelib"]) / "cmeel.prefix" / EXAMPLES
    path = path / "g1_description/urdf/g1_29dof_rev_1_0.urdf"
    chain = ("hip_pitch", "hip_roll", "hip_yaw", "knee", "ankle_pitch", "ankle_roll")
    feet = tuple(
        Foot(
            f"{side}_ankle_roll_link",
            f"{side}_ankle_roll_link",
            tuple(f"{side}_{joint}_joint" for joint in chain),
            rest=0.035,
            sole=True,
        )
        for side in ("left", "right")
    )
    bent = {"hip_pitch": -0.3, "knee": 0.7, "ankle_pitch": -0.4, "elbow": 0.6}
    return StandingRobot(
        path,
        ci.robot.load_urdf(path, base="floating"),
        trunk="torso_link",
        box=(3.0, (-0.12, 0.03, 0.2), (0.03, 0.04, 0.02)),
        feet=feet,
        height=0.74,
        gains=(600.0, 15.0),
        sway=Sway(
            (0.5, 1.4, 3.5),
            (0.006, 0.003, 0.0003),
            (0.03, 0.02, 0.008),
            (0.05, 0.04, 0.012),
        ),
        cutoff=30.0,
        posture={
            f"{side}_{joint}_joint": angle
            for side in ("left", "right")
            for joint, angle in bent.items()
        },
    )


ROBOTS = {"quadruped": quadruped, "humanoid": humanoid}

ROTOR, DAMPING, DRY = 0.02, 0.2, 0.3
"""Of every joint of a URDF, which knows none: kg m^2, N m s/rad and N m."""


def _of_urdf(path: Path, mujoco: Any) -> Any:
    """Return a URDF as MuJoCo reads it, floating, driven, without meshes."""
    tree = ET.parse(path)
    for link in tree.getroot().iter("link"):
        for shape in [*link.findall("visual"), *link.findall("collision")]:
            if shape.tag == "visual" or shape.find("geometry/mesh") is not None:
                link.remove(shape)
    compiler = {"fusestatic": "false", "discardvisual": "false"}
    ET.SubElement(ET.SubElement(tree.getroot(), "mujoco"), "compiler", compiler)
    spec = mujoco.MjSpec.from_string(ET.tostring(tree.getroot(), encoding="unicode"))
    base, *_ = spec.worldbody.bodies
    base.add_freejoint()
    for joint in spec.joints:
        if joint.type == mujoco.mjtJoint.mjJNT_FREE:
            continue
        joint.armature, joint.damping, joint.frictionloss = ROTOR, [DAMPING, 0, 0], DRY
        motor = spec.add_actuator(name=joint.name, target=joint.name)
        motor.trntype = mujoco.mjtTrn.mjTRN_JOINT
    return spec

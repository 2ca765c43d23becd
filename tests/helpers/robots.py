"""Random robots and states, as Pinocchio and as the package see them."""

from dataclasses import replace

import numpy as np
import pinocchio as pin

from consistent_id.robot.inertia import InertialParameters
from consistent_id.robot.loaders.urdf import from_pinocchio
from consistent_id.robot.model import Mimic, RobotModel

_BODY = """
    <inertial>
      <origin xyz="0.1 0.02 0.3" rpy="0.1 0.2 0.3"/>
      <mass value="{mass}"/>
      <inertia ixx="0.02" ixy="0.001" ixz="0.002" iyy="0.03" iyz="0.003" izz="0.025"/>
    </inertial>"""

URDF = f"""<?xml version="1.0"?>
<robot name="test">
  <link name="base"/>
  <joint name="turn" type="revolute">
    <parent link="base"/> <child link="one"/>
    <origin xyz="0 0 0.3" rpy="0.3 -0.2 0.1"/>
    <axis xyz="0.6 0 0.8"/>
    <limit lower="-2" upper="1.5" velocity="3" effort="50"/>
  </joint>
  <link name="one">{_BODY.format(mass=2.0)}</link>
  <joint name="slide" type="prismatic">
    <parent link="one"/> <child link="two"/>
    <origin xyz="0.2 0 0" rpy="0 1.57079632679 0"/>
    <axis xyz="0 -1 0"/>
    <limit lower="0" upper="0.4" velocity="1" effort="20"/>
  </joint>
  <link name="two">{_BODY.format(mass=1.0)}</link>
  <joint name="weld" type="fixed">
    <parent link="two"/> <child link="tool"/>
    <origin xyz="0 0.1 0.2" rpy="0.5 0 0"/>
  </joint>
  <link name="tool">{_BODY.format(mass=0.5)}</link>
  <joint name="spin" type="continuous">
    <parent link="two"/> <child link="three"/>
    <axis xyz="0 1 0"/>
  </joint>
  <link name="three">{_BODY.format(mass=0.7)}</link>
</robot>
"""


def random_robot(
    rng: np.random.Generator, joints: int, tree: bool = False
) -> tuple[pin.Model, RobotModel]:
    """A robot of random joints, placements and (consistent) inertias."""
    pin.seed(int(rng.integers(2**31)))
    model = pin.Model()
    for k in range(joints):
        parent = int(rng.integers(0, k + 1)) if tree else k
        joint = model.addJoint(parent, random_joint(rng), pin.SE3.Random(), f"j{k}")
        body = random_body(rng)
        inertia = pin.Inertia(body.mass, body.com, body.central_inertia)
        model.appendBodyToJoint(joint, inertia, pin.SE3.Identity())
    return model, from_pinocchio(model)


def with_followers(robot: RobotModel, mimics: dict[str, Mimic]) -> RobotModel:
    """The robot with joints that follow others."""
    joints = (replace(j, mimic=mimics.get(j.name)) for j in robot.joints)
    return replace(robot, joints=tuple(joints))


def random_joint(rng: np.random.Generator):
    """A revolute or prismatic joint about a coordinate axis or any other."""
    axis = rng.normal(size=3)
    axis /= np.linalg.norm(axis)
    kinds = (
        pin.JointModelRX(),
        pin.JointModelRY(),
        pin.JointModelRZ(),
        pin.JointModelPX(),
        pin.JointModelPY(),
        pin.JointModelPZ(),
        pin.JointModelRevoluteUnaligned(axis),
        pin.JointModelPrismaticUnaligned(axis),
    )
    return kinds[rng.integers(len(kinds))]


def random_body(rng: np.random.Generator, points: int = 6) -> InertialParameters:
    """The body of a few random point masses: consistent by construction."""
    masses, places = rng.uniform(0.1, 2.0, points), rng.normal(size=(points, 3))
    J = np.zeros((4, 4))
    for m, r in zip(masses, places, strict=True):
        J += m * np.outer([*r, 1.0], [*r, 1.0])
    return InertialParameters.from_pseudo_inertia(J)


def random_states(
    rng: np.random.Generator, joints: int, samples: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Positions, velocities and accelerations, each (samples, joints)."""
    q, dq, ddq = rng.uniform(-2.0, 2.0, (3, samples, joints))
    return q, dq, ddq

"""A humanoid on two soles: Pinocchio says that its forces carry it."""

import numpy as np
import pinocchio as pin
import pytest
from published_robots import FOLDER

import consistent_id as ci
from consistent_id.robot.kinematics import frame_places
from consistent_id.standing.forces_and_limits import (
    GroundForces,
    ground_shares,
    standing_motion,
)
from consistent_id.standing.standing_design import trunk_errors

URDF = FOLDER / "g1_description" / "urdf" / "g1_29dof_rev_1_0.urdf"
FEET = ("left_ankle_roll_link", "right_ankle_roll_link")
GRAVITY = np.array([0.0, 0.0, -9.81])
LIMITS = ci.standing.StandingLimits()
DRIVE = ci.DriveTerms(viscous=True, coulomb="tanh", velocity_scale=0.02)

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not URDF.exists(), reason="example-robot-data is missing"),
]


@pytest.fixture(scope="module")
def stance():
    robot = ci.robot.load_urdf(URDF, base="floating")
    feet = ci.standing.standing_feet(robot, URDF)
    return ci.standing.Stance(robot, feet, ci.standing.standing_pose(robot, URDF, feet))


def path_of(size=1.0):
    rng = np.random.default_rng(0)
    scale = size * np.array([0.004] * 3 + [0.02] * 3)
    coefficients = scale * rng.normal(size=(2, 3, 6)) / np.array([1, 2, 3])[:, None]
    return ci.standing.TrunkPath([0.4, 0.9, 1.7], coefficients, 6.0)


def test_soles_stay_flat_where_they_are(stance):
    assert [foot.frame for foot in stance.feet] == list(FEET)
    assert all(foot.flat and foot.points.shape == (4, 3) for foot in stance.feet)
    motion = standing_motion(stance, LIMITS, path_of(), np.linspace(0, 6, 61))
    R = motion.trunk.base.rotation
    for foot in FEET:
        seen = frame_places(stance.robot, foot, motion.joints.q)
        world = np.einsum("nij,nj->ni", R, seen.translation) + motion.trunk.place
        assert np.ptp(world, axis=0).max() < 1e-8
        turned = R @ seen.rotation
        assert abs(turned - turned[0]).max() < 1e-8
        assert turned[0, 2, 2] == pytest.approx(1.0, abs=1e-6)


def test_wrenches_of_the_ground_carry_the_humanoid_as_pinocchio_says(stance):
    """Inverse dynamics with a free flyer: base rows vanish, joints' are the torques."""
    motion = standing_motion(stance, LIMITS, path_of(), np.linspace(0, 6, 7))
    robot, trunk, moved = stance.robot, motion.trunk, motion.joints
    model = pin.buildModelFromUrdf(str(URDF), pin.JointModelFreeFlyer())
    data = model.createData()
    order = [model.idx_vs[model.getJointId(name)] - 6 for name in robot.joint_names]
    for k in range(len(moved.q)):
        q, v, a = pin.neutral(model), np.zeros(model.nv), np.zeros(model.nv)
        R = trunk.base.rotation[k]
        q[:3], q[3:7] = trunk.place[k], pin.Quaternion(R).coeffs()
        v[:3], v[3:6] = R.T @ trunk.velocity[k], trunk.base.angular_velocity[k]
        a[3:6] = trunk.base.angular_acceleration[k]
        a[:3] = R.T @ trunk.acceleration[k] - np.cross(v[3:6], v[:3])
        q[7:][order], v[6:][order] = moved.q[k], moved.dq[k]
        a[6:][order] = moved.ddq[k]
        pin.forwardKinematics(model, data, q)
        pin.updateFramePlacements(model, data)
        pushes = pin.StdVec_Force([pin.Force.Zero() for _ in range(model.njoints)])
        forces = iter(motion.ground.forces[k])
        for foot in stance.feet:
            frame = model.frames[model.getFrameId(foot.frame)]
            for point in foot.points:
                at = frame.placement.act(point)
                turned = data.oMi[frame.parentJoint].rotation.T @ next(forces)
                pushes[frame.parentJoint] += pin.Force(turned, np.cross(at, turned))
        needed = pin.rnea(model, data, q, v, a, pushes)
        assert np.allclose(needed[:6], 0.0, atol=1e-7)
        assert np.allclose(needed[6:][order], motion.ground.torque[k], atol=1e-7)


@pytest.mark.parametrize("axis", [0, 1])
def test_a_sole_on_its_edge_uses_all_of_it(stance, axis):
    """Where two corners beside each other bear all, the middle of pressure is there."""
    forces = np.zeros((1, 8, 3))
    for k, foot in enumerate(stance.feet):
        edge = foot.points[:, axis] > foot.points[:, axis].mean()
        forces[0, 4 * k : 4 * k + 4, 2] = np.where(edge, 80.0, 0.0)
    ground = GroundForces(forces, np.zeros((1, len(stance.robot))), 40.0)
    shares = ground_shares(stance, ground, friction=0.6, least_press=0.2)
    middle = [one.share[0] for one in shares if one.what == "centre of pressure"]
    assert middle == pytest.approx([1.0, 1.0], rel=1e-3)


def test_any_body_may_be_the_one_that_is_not_known(stance):
    model = ci.TorqueModel(stance.robot, DRIVE)
    motion = standing_motion(stance, LIMITS, path_of(), np.linspace(0, 6, 121))
    pelvis, torso = (
        trunk_errors(stance, model, motion, 500.0, link)
        for link in (None, "torso_link")
    )
    # With the waist still, a mass is a mass on either; moments have other origins.
    assert torso[0] == pytest.approx(pelvis[0], rel=1e-6)
    assert abs(torso[4:] / pelvis[4:] - 1.0).max() > 0.02
    with pytest.raises(ci.ProblemError, match=r"no link 'torso' to identify.*torso"):
        ci.standing.design_standing(stance, model, link="torso", candidates=1)


def test_a_design_on_soles_keeps_their_contact(stance):
    model = ci.TorqueModel(stance.robot, DRIVE)
    design = ci.standing.design_standing(
        stance, model, link="torso_link", duration=4.0, candidates=16
    )
    assert design.link == "torso_link" and design.checked.largest <= 1.0
    assert {use.what for use in design.checked.uses} >= {
        "centre of pressure",
        "turning",
        "friction cone",
        "pressing",
    }
    first = 0
    for foot in stance.feet:
        f = design.checked.ground.forces[:, first : first + 4]
        first += 4
        press = f[..., 2].sum(axis=1)
        # Feet are level, so that the lever of each corner is that of its frame.
        half = np.ptp(foot.points, axis=0)[:2] / 2
        arms = foot.points[:, :2] - foot.points[:, :2].mean(axis=0)
        centre = np.einsum("np,pi->ni", f[..., 2], arms) / press[:, None]
        assert np.all(abs(centre) <= half + 1e-9)
        along = np.linalg.norm(f[..., :2].sum(axis=1), axis=1)
        assert np.all(along <= LIMITS.friction_share * LIMITS.friction * press)

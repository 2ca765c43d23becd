"""Joint motion that writes: on the curve, with exact derivatives, or refused."""

import pickle
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from robots import URDF, random_robot

from consistent_id import DHRow, from_modified_dh, load_problem
from consistent_id.errors import ModelError, PathError, ProblemError
from consistent_id.laboratory.curves import circle, ellipsoid, helix, through_points
from consistent_id.laboratory.inverse_kinematics import follow
from consistent_id.laboratory.writing_tasks import Orientation, Writer, WritingTask
from consistent_id.robot import JointLimits, load_urdf
from consistent_id.robot.chains import chain
from consistent_id.robot.kinematics import frame_motion

# Table I of the paper, all six axes.
TABLE = [
    DHRow(0.0, 0.0, 0.237),
    DHRow(-np.pi / 2, 0.0),
    DHRow(0.0, 0.29, 0.049),
    DHRow(np.pi / 2, 0.0, 0.31),
    DHRow(-np.pi / 2, 0.0),
    DHRow(np.pi / 2, 0.0),
]
RX60 = from_modified_dh("rx60", TABLE)
FIRST_THREE = ("joint1", "joint2", "joint3")
WRIST = Writer(RX60, "link4", joints=FIRST_THREE)
POSE = np.array([0.3, -0.5, 1.0, 0.2, 0.7, 0.1])


def _pinocchio_rx60():
    """The same table, built with Pinocchio alone."""
    model = pin.Model()
    for k, row in enumerate(TABLE):
        twist = pin.SE3(pin.utils.rotate("x", row.alpha), np.zeros(3))
        place = twist * pin.SE3(np.eye(3), np.array([row.a, 0.0, row.d]))
        model.addJoint(k, pin.JointModelRZ(), place, f"j{k}")
    return model


def _pinocchio_places(model, q, joint):
    data = model.createData()
    for row in q:
        pin.forwardKinematics(model, data, row)
        yield data.oMi[joint].copy()


@pytest.mark.parametrize("seed", range(4))
def test_frames_move_as_pinocchio_has_them(seed):
    rng = np.random.default_rng(seed)
    reference, robot = random_robot(rng, 6, tree=bool(seed % 2))
    data = reference.createData()
    q, dq = rng.uniform(-2.0, 2.0, (2, 5, 6))
    point = rng.normal(size=3)
    found = frame_motion(robot, q, dq, frame=robot.link_names[-1], point=point)
    at_point = pin.SE3(np.eye(3), point)
    for s in range(len(q)):
        pin.forwardKinematics(reference, data, q[s], dq[s], np.zeros(6))
        last = data.oMi[6] * at_point
        world = pin.SE3(last.rotation, np.zeros(3))
        assert found.position[s] == pytest.approx(last.translation, abs=1e-12)
        v = world.act(at_point.actInv(data.v[6]))
        velocity = found.jacobian[s] @ dq[s]
        assert velocity == pytest.approx(v.vector, abs=1e-10)
        # Pinocchio's acceleration is spatial: the point's own has w x v besides.
        a = world.act(at_point.actInv(data.a[6])).vector
        a[:3] += np.cross(v.angular, v.linear)
        assert found.bias[s] == pytest.approx(a, abs=1e-9)


def test_a_merged_frame_is_where_the_file_puts_it(tmp_path):
    file = tmp_path / "robot.urdf"
    file.write_text(URDF)
    robot = load_urdf(file)
    reference = pin.buildModelFromUrdf(str(file))
    data = reference.createData()
    q = np.array([0.4, 0.2, 1.1])
    reduced = np.array([q[0], q[1], np.cos(q[2]), np.sin(q[2])])
    pin.framesForwardKinematics(reference, data, reduced)
    place = data.oMf[reference.getFrameId("tool")]
    point = np.array([0.1, -0.2, 0.3])
    found = frame_motion(robot, [q], frame="tool", point=point)
    # The file's 1.57079632679 counts as a right angle here.
    assert found.position[0] == pytest.approx(place.act(point), abs=1e-11)
    assert found.rotation[0] == pytest.approx(place.rotation, abs=1e-11)
    with pytest.raises(ModelError, match="does not move"):
        frame_motion(robot, [q], frame="base")


@pytest.mark.parametrize(
    "curve",
    [
        pytest.param(
            circle(0.1, centre=[0.3, 0.1, 0.3], along=[0, 1, 0], across=[0, 0, 1]),
            marks=pytest.mark.slow,
        ),
        pytest.param(
            ellipsoid((0.1, 0.08, 0.06), centre=[0.3, 0.1, 0.4]),
            marks=pytest.mark.slow,
        ),
        pytest.param(
            helix(0.08, 0.1, centre=[0.3, -0.1, 0.35]), marks=pytest.mark.slow
        ),
        through_points([[0.3, 0, 0.3], [0.35, 0.1, 0.25], [0.3, 0.15, 0.35]]),
    ],
    ids=["circle", "ellipsoid", "helix", "points"],
)
def test_the_wrist_of_the_rx60_is_on_the_curve_with_exact_derivatives(curve):
    task = WritingTask(curve, 4.0)
    path = follow(WRIST, task)
    time, h = np.linspace(0.0, 4.0, 301), 1e-4
    q, dq, ddq = path.evaluate(time)
    x, v, _ = task.evaluate(time)
    places = _pinocchio_places(_pinocchio_rx60(), q, 4)
    wrist = np.array([place.translation for place in places])
    assert abs(wrist - x).max() < 1e-12
    assert abs(dq[0]).max() == abs(dq[-1]).max() == 0.0
    above, below = path.evaluate(time + h), path.evaluate(time - h)
    # Central differences: h^2 / 6 of jerks of up to 700 rad/s^3; a spline's knots are
    # corners of the acceleration, h times some 10 rad/s^3.
    assert dq == pytest.approx(((above - below) / (2 * h))[0], abs=1e-5)
    assert ddq == pytest.approx(((above - below) / (2 * h))[1], abs=1e-3)
    assert (q[:, 3:] == q[0, 3:]).all()
    assert abs(v).max() > 0.05


@pytest.mark.slow
def test_six_axes_hold_and_turn_the_tool_while_they_write():
    tool = Writer(RX60, "link6", [0.0, 0.0, 0.05])
    start = tool.motion(POSE[None])
    held = Orientation(start.rotation[0], axis=[0, 1, 0], angle=0.3)
    curve = circle(0.05, centre=start.position[0] - [0.05, 0, 0])
    task = WritingTask(curve, 4.0, "septic", held)
    path = follow(tool, task, start=POSE)
    time, h = np.linspace(0.0, 4.0, 101), 1e-4
    q, dq, ddq = path.evaluate(time)
    assert q[0] == pytest.approx(POSE, abs=1e-9)
    rotations = held.at(task.progress(time)[0])
    points = task.evaluate(time)[0]
    places = _pinocchio_places(_pinocchio_rx60(), q, 6)
    for place, R, x in zip(places, rotations, points, strict=True):
        assert place.rotation == pytest.approx(R, abs=1e-9)
        assert place.act(np.array([0, 0, 0.05])) == pytest.approx(x, abs=1e-9)
    above, below = path.evaluate(time + h), path.evaluate(time - h)
    assert dq == pytest.approx(((above - below) / (2 * h))[0], abs=1e-5)
    assert ddq == pytest.approx(((above - below) / (2 * h))[1], abs=1e-4)


@pytest.mark.slow
def test_a_flat_arm_of_two_joints_writes_in_its_plane_and_nowhere_else():
    arm = from_modified_dh("flat", [DHRow(0, 0), DHRow(0, 0.4)])
    pen = Writer(arm, "link2", [0.3, 0, 0])
    flat = circle(0.1, centre=[0.4, 0.1, 0])
    path = follow(pen, WritingTask(flat, 2.0), start=[0.0, 1.0])
    assert path.solve(np.linspace(0, 2, 50)).error.max() < 1e-12
    with pytest.raises(PathError, match="no pose was found"):
        follow(pen, WritingTask(circle(0.1, centre=[0.4, 0.1, 0.2]), 2.0))


@pytest.mark.slow
def test_sliding_joints_write_too(tmp_path):
    file = tmp_path / "robot.urdf"
    file.write_text(URDF)
    robot = load_urdf(file)
    writer = Writer(robot, "three", [0.1, 0.0, 0.2])
    pose = np.array([[0.2, 0.2, 0.5]])
    point = writer.motion(pose).position[0]
    centre = point + np.array([0.02, 0.0, 0.0])
    curve = circle(0.02, centre=centre, along=[-1, 0, 0])
    path = follow(writer, WritingTask(curve, 2.0), start=pose[0])
    found = path.solve(np.linspace(0.0, 2.0, 41))
    assert found.error.max() < 1e-10
    assert (abs(found.motion[1]).max(axis=0) > 0.0).all()


@pytest.mark.slow
def test_the_start_chooses_the_branch():
    task = WritingTask(circle(0.05, centre=[0.3, 0.1, 0.3]), 2.0)
    one = follow(WRIST, task, start=[0, -0.5, 0.5, 0, 0, 0]).evaluate([0.0])[0, 0]
    other = follow(WRIST, task, start=[0, 0.5, 2.6, 0, 0, 0]).evaluate([0.0])[0, 0]
    assert abs(one - other)[:3].max() > 0.5
    for q in (one, other):
        assert WRIST.motion(q[None]).position[0] == pytest.approx([0.35, 0.1, 0.3])


@pytest.mark.slow
def test_a_point_out_of_reach_is_refused_with_its_place():
    # The straight line leaves the sphere of radius 0.6 m, roughly, about the shoulder.
    line = through_points([[0.3, 0.1, 0.3], [0.5, 0.1, 0.3], [0.8, 0.1, 0.3]])
    with pytest.raises(PathError, match="no pose was found") as refusal:
        follow(WRIST, WritingTask(line, 4.0))
    error = refusal.value
    # Elbow stretched: |(sqrt(x^2 + y^2 - d3^2), z - d1)| = a2 + d4.
    farthest = np.sqrt(0.6**2 - (0.3 - 0.237) ** 2 + 0.049**2 - 0.1**2)
    assert error.point[0] == pytest.approx(farthest, abs=1e-4)
    assert error.arc_length == pytest.approx(farthest - 0.3, abs=1e-4)
    assert 0.0 < error.time < 4.0
    with pytest.raises(PathError, match=r"nearest misses it by 0\.4") as refusal:
        follow(WRIST, WritingTask(circle(0.1, centre=[0.9, 0, 0.3]), 4.0))
    assert refusal.value.arc_length == 0.0
    again = pickle.loads(pickle.dumps(error))
    assert (str(again), again.point) == (str(error), error.point)


@pytest.mark.slow
def test_a_singularity_on_the_way_is_refused_with_its_place():
    # With d3 = 0 nothing keeps the wrist from the first axis, where that does nothing.
    table = [replace(row, d=0.0) if k == 2 else row for k, row in enumerate(TABLE)]
    arm = from_modified_dh("no offset", table[:4])
    wrist = Writer(arm, "link4", joints=FIRST_THREE)
    line = through_points([[0.3, 0.0, 0.4], [0.1, 0.0, 0.4], [-0.2, 0.0, 0.4]])
    with pytest.raises(PathError, match="singular or nearly so") as refusal:
        follow(wrist, WritingTask(line, 4.0))
    assert abs(refusal.value.point[0]) < 0.01
    assert refusal.value.value > 100.0
    near = circle(0.05, centre=[0.2, 0.0, 0.4])
    with pytest.raises(PathError, match="allowed is 1"):
        follow(wrist, WritingTask(near, 4.0), worst_condition=1.0)


@pytest.mark.slow
def test_a_joint_beyond_its_range_or_too_fast_is_refused_by_name():
    curve = circle(0.1, centre=[0.3, 0.0, 0.3])
    task = WritingTask(curve, 1.0)

    def limited(limits):
        rows = [replace(TABLE[0], limits=limits), *TABLE[1:4]]
        return Writer(from_modified_dh("rx60", rows), "link4", joints=FIRST_THREE)

    free = follow(limited(JointLimits()), task)
    motion = free.evaluate(np.linspace(0.0, 1.0, 2001))
    top, fastest = motion[0, :, 0].max(), abs(motion[1, :, 0]).max()
    follow(limited(JointLimits(-2.0, top + 1e-6, fastest + 1e-6)), task)
    with pytest.raises(PathError, match="position of joint 'joint1'") as refusal:
        follow(limited(JointLimits(-2.0, top - 0.01)), task)
    assert refusal.value.joint == "joint1"
    assert refusal.value.value == pytest.approx(top - 0.01, abs=0.01)
    with pytest.raises(PathError, match=r"velocity of joint 'joint1'.*take longer"):
        follow(limited(JointLimits(velocity=0.9 * fastest)), task)


def test_too_many_joints_for_a_task_are_refused():
    task = WritingTask(circle(0.1, centre=[0.3, 0.0, 0.3]), 1.0)
    with pytest.raises(ProblemError, match="6 joints move 'link6'"):
        follow(Writer(RX60, "link6"), task)
    with pytest.raises(ProblemError, match="does not move 'link4'"):
        Writer(RX60, "link4", joints=("joint5",))


def test_the_wrist_of_six_axes_is_a_point_of_the_third_link_of_three():
    three = chain(RX60, tip="link3")
    rng = np.random.default_rng(0)
    q = rng.uniform(-2.0, 2.0, (4, 6))
    mine = Writer(three, "link3", [0.0, -0.31, 0.0]).motion(q[:, :3]).position
    assert mine == pytest.approx(WRIST.motion(q).position, abs=1e-15)
    assert load_problem("problems/rx60").model.robot.link_names == three.link_names


@pytest.mark.slow
def test_a_recording_of_a_task_holds_both_ends():
    task = WritingTask(circle(0.1, centre=[0.3, 0.0, 0.3]), 2.0, start=0.5)
    log = follow(WRIST, task).recording(100.0)
    assert (log.time[0], log.time[-1], len(log)) == (0.5, 2.5, 201)
    assert abs(log.velocity[[0, -1]]).max() == 0.0

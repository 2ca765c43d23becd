"""Drafts for robots whose base floats: from a robot and a log, nothing else said."""

import re
from dataclasses import replace

import numpy as np
import pytest
import ros_topics as ros
from quadrupeds import CORNERS, FEET, quadruped_text
from walking import walk, write_csv

import consistent_id as ci
from consistent_id.problems.robot_logs import robot_logs
from consistent_id.problems.statement import Statement

BOX = ci.InertialParameters.from_central(2.0, [0.05, 0.02, 0.1], 0.02 * np.eye(3))
FLOATING = Statement(base="floating")
BALL = '<geom type="sphere" size="1e-6" pos="0 0 -0.2"/>'
UNIT = '<site name="imu" pos="0.02 0.01 0.05" quat="0 1 0 0"/>'
JOINT = re.compile(r'(<joint name="\w_knee" axis="0 1 0")/>')


def robot_text(unit="", armature=0.0):
    """The quadruped with balls for feet, its unit perhaps mounted upside down."""
    text = quadruped_text(hips=CORNERS)
    stated = f' armature="{armature}"/>{BALL}'
    text = JOINT.sub(lambda knee: knee[1] + stated, text)
    return text.replace("<freejoint/>", f"<freejoint/>{unit}")


def write_logs(folder, *names, seconds):
    """Write a robot, and logs of it with a box on its trunk."""
    (folder / "robot.xml").write_text(robot_text())
    robot = ci.robot.load_mjcf(folder / "robot.xml", base="floating")
    truth = robot.nominal.copy()
    truth[:10] += BOX.vector
    for seed, name in enumerate(names):
        log = walk(robot, truth, seconds=seconds, seed=seed)
        write_csv(folder / f"{name}.csv", log)
    return folder


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A robot, and a log in which each foot is once in the air."""
    folder = tmp_path_factory.mktemp("walker")
    return write_logs(folder, "training", seconds=8.0)


def columns(folder):
    """The log's columns, by name."""
    table = np.genfromtxt(folder / "training.csv", delimiter=",", names=True)
    return {name: table[name] for name in table.dtype.names}


def without(log, *words):
    return {k: v for k, v in log.items() if not any(word in k for word in words)}


def logs_of(folder, log, hints=None, robot="robot.xml"):
    write_csv(folder / "log.csv", log)
    found = robot_logs(
        folder / robot, folder / "log.csv", replace(hints or FLOATING, base="floating")
    )
    return found.columns.beside, " / ".join(found.notes)


@pytest.mark.slow
def test_a_trunk_is_found_from_a_robot_and_logs_alone(tmp_path):
    folder = write_logs(tmp_path, "training", "validation", seconds=12.0)
    study = ci.identify_log(
        folder / "robot.xml",
        folder / "training.csv",
        validation=folder / "validation.csv",
        base="floating",
        cutoff=20.0,
    )
    assert study.verdict.usable
    trunk = ci.InertialParameters(study.delivered.links[0])
    expected = study.problem.model.robot.links[0].nominal + BOX
    assert trunk.mass == pytest.approx(expected.mass, rel=0.01)
    assert np.linalg.norm(trunk.com - expected.com) < 3e-3
    moments = np.linalg.eigvalsh(trunk.central_inertia)
    assert moments == pytest.approx(
        np.linalg.eigvalsh(expected.central_inertia), rel=0.05
    )


@pytest.mark.slow
def test_base_and_contacts_are_found_by_their_names(folder):
    found, notes = logs_of(folder, columns(folder))
    assert found.base.angular_velocity == ("gyro_x", "gyro_y", "gyro_z")
    assert found.base.acceleration == ("acc_x", "acc_y", "acc_z")
    assert found.base.order == "wxyz" and "by the names of its columns" in notes
    assert [(c.frame, c.closed) for c in found.contacts] == [
        (foot, f"contact_{foot}") for foot in FEET
    ]
    assert all(np.allclose(c.point, [0, 0, -0.2]) for c in found.contacts)
    assert {c.radius for c in found.contacts} == {1e-6}


@pytest.mark.slow
def test_a_written_draft_is_what_was_found(folder):
    draft = ci.draft_problem(
        folder / "robot.xml", folder / "training.csv", base="floating", cutoff=20.0
    )
    file = folder / "written.toml"
    file.write_text(draft.text(folder))
    (mine,), (read,) = draft.problem(folder).training, ci.load_problem(file).training
    assert np.allclose(mine.base.stacked, read.base.stacked)
    assert np.array_equal(mine.torque_known, read.torque_known)
    assert [c.frame for c in mine.contacts] == [c.frame for c in read.contacts]
    stated = ci.load_problem(file).table
    assert stated.constraints.known_links == list(draft.standing.known_links)
    assert stated.constraints.masses == "free"


@pytest.mark.slow
def test_rotor_inertias_of_the_file_are_taken(folder):
    (folder / "geared.xml").write_text(robot_text(armature=0.02))
    draft = ci.draft_problem(
        folder / "geared.xml", folder / "training.csv", base="floating"
    )
    fixed = draft.table(folder).constraints.fixed
    assert fixed == {f"{leg}_knee.rotor_inertia": 0.02 for leg in "abcd"}


@pytest.mark.slow
@pytest.mark.parametrize("order", ["wxyz", "xyzw"])
def test_the_order_of_a_bare_quaternion_is_told_by_the_gyroscope(folder, order):
    log = columns(folder)
    turned = {f"base_rot_{i}": log[f"quat_{c}"] for i, c in enumerate(order)}
    found, notes = logs_of(folder, {**without(log, "quat"), **turned})
    assert found.base.order == order and "from the gyroscope" in notes


@pytest.mark.slow
def test_a_unit_is_where_the_robots_file_has_it(folder):
    (folder / "mounted.xml").write_text(robot_text(UNIT))
    log = columns(folder)
    place, turn = np.array([0.02, 0.01, 0.05]), np.diag([1.0, -1.0, -1.0])
    w, felt = (np.stack([log[f"{k}_{c}"] for c in "xyz"], 1) for k in ("gyro", "acc"))
    dw = np.gradient(w, log["time"], axis=0)
    felt = felt + np.cross(dw, place) + np.cross(w, np.cross(w, place))
    for i, c in enumerate("xyz"):
        log[f"gyro_{c}"], log[f"acc_{c}"] = (w @ turn)[:, i], (felt @ turn)[:, i]
    plain, _ = logs_of(folder, columns(folder))
    found, notes = logs_of(folder, log, robot="mounted.xml")
    assert "the unit is at imu" in notes
    joints = ci.robot.load_mjcf(folder / "robot.xml", base="floating").joint_names
    there, here = (
        ci.read_recording(
            folder / file,
            joints,
            ci.Columns(beside=ci.recordings.BesideColumns(base=base)),
        ).base.stacked[5:-5]
        for file, base in (("log.csv", found.base), ("training.csv", plain.base))
    )
    assert np.allclose(there, here, atol=1e-3)
    at_origin, _ = logs_of(folder, log, Statement(imu="trunk"), "mounted.xml")
    assert not at_origin.base.imu_position.any()


@pytest.mark.slow
@pytest.mark.parametrize(("place", "same"), [("0.02", True), ("0.07", False)])
def test_of_two_frames_of_a_unit_in_different_places_one_has_to_be_stated(
    folder, place, same
):
    other = UNIT.replace('"imu"', '"imu_link"').replace("0.02", place)
    (folder / "two.xml").write_text(robot_text(UNIT + other))
    if same:
        _, notes = logs_of(folder, columns(folder), robot="two.xml")
        assert "the unit is at imu " in notes
        return
    with pytest.raises(ci.RecordingError, match="imu, imu_link") as refusal:
        logs_of(folder, columns(folder), robot="two.xml")
    assert "--imu imu" in refusal.value.options
    stated = Statement(imu="imu_link")
    found, _ = logs_of(folder, columns(folder), stated, "two.xml")
    assert found.base.imu_position[0] == pytest.approx(0.07)


@pytest.mark.slow
def test_feet_that_swing_need_their_columns_and_the_message_says_so(folder):
    log = without(columns(folder), "contact")
    write_csv(folder / "bare.csv", log)
    message = r"do not stand.*--contact a_calf=COL.*a_calf=always.*--imu"
    with pytest.raises(ci.RecordingError, match=message):
        ci.draft_problem(folder / "robot.xml", folder / "bare.csv", base="floating")
    stated = Statement(contacts={foot: "always" for foot in FEET})
    found, _ = logs_of(folder, log, stated)
    assert [contact.closed for contact in found.contacts] == [True] * 4
    assert logs_of(folder, log, Statement(contacts={}))[0].contacts == ()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("share", "message"),
    [
        (1 / 9.81, "as in units of g; multiply it by 9.81"),
        (0.3, "If gravity was removed"),
    ],
)
def test_an_accelerometer_that_does_not_feel_gravity_is_refused(folder, share, message):
    log = columns(folder)
    log |= {name: share * log[name] for name in ("acc_x", "acc_y", "acc_z")}
    with pytest.raises(ci.RecordingError, match=message):
        logs_of(folder, log)


@pytest.mark.slow
def test_the_options_for_a_base_without_columns_are_named(folder):
    log = without(columns(folder), "gyro", "place")
    with pytest.raises(ci.RecordingError, match="--angular-velocity gx,gy,gz"):
        logs_of(folder, log)


@pytest.mark.slow
def test_hints_of_a_base_that_is_fixed_are_refused(folder):
    (folder / "fixed.xml").write_text(quadruped_text(joint=""))
    with pytest.raises(
        ci.ProblemError, match="assumed to be fixed; add --base floating"
    ):
        robot_logs(
            folder / "fixed.xml", folder / "training.csv", Statement(imu="trunk")
        )


@pytest.mark.slow
def test_a_robot_on_legs_with_a_moving_base_in_its_log_is_asked_about(folder):
    (folder / "fixed.xml").write_text(quadruped_text(joint=""))
    with pytest.raises(ci.ProblemError, match=r"If the base moves, add --base float"):
        robot_logs(folder / "fixed.xml", folder / "training.csv")


@pytest.mark.slow
def test_arrays_of_mujoco_are_read_by_the_model(folder):
    sensors = '<sensor><clock/><accelerometer site="imu"/><gyro site="imu"/></sensor>'
    text = robot_text(UNIT.replace(' quat="0 1 0 0"', ""))
    text = text.replace("</mujoco>", f"{sensors}</mujoco>")
    (folder / "sensed.xml").write_text(text)
    log = columns(folder)
    joints = ci.robot.load_mjcf(folder / "robot.xml", base="floating").joint_names

    def stack(prefix, names):
        return np.stack([log[f"{prefix}_{name}"] for name in names], axis=1)

    pose = np.hstack([stack("place", "xyz"), stack("quat", "wxyz")])
    unit = np.hstack([stack("acc", "xyz"), stack("gyro", "xyz")])
    np.savez(
        folder / "sim.npz",
        time=log["time"],
        qpos=np.hstack([pose, stack("q", joints)]),
        qfrc_actuator=np.hstack([np.zeros((len(pose), 6)), stack("tau", joints)]),
        sensordata=np.hstack([log["time"][:, None], unit]),
    )
    stated = Statement(base="floating", contacts={})
    found = robot_logs(folder / "sensed.xml", folder / "sim.npz", stated)
    base = found.columns.beside.base
    assert base.acceleration == "sensordata[1:4]"
    assert base.angular_velocity == "sensordata[4:7]"
    assert np.allclose(base.imu_position, [0.02, 0.01, 0.05])
    read = found.read(folder / "sim.npz")
    assert np.array_equal(read.position, stack("q", joints))
    assert np.array_equal(read.torque, stack("tau", joints))


@pytest.mark.slow
def test_topics_of_a_bag_are_found_by_their_kind(folder):
    log = {k: v[:600] for k, v in columns(folder).items()}
    joints = ci.robot.load_mjcf(folder / "robot.xml", base="floating").joint_names

    def at(prefix, names, k):
        return [float(log[f"{prefix}_{name}"][k]) for name in names]

    stamps = [10**18 + round(t * 1e9) for t in log["time"]]
    states, units = [], []
    for k, stamp in enumerate(stamps):
        q, tau = (np.array(at(p, joints, k)) for p in ("q", "tau"))
        head = {"header": ros.header(stamp), "name": list(joints)}
        joint = {**head, "position": q, "velocity": 0 * q, "effort": tau}
        states.append((stamp, joint))
        unit = {
            "header": ros.header(stamp),
            "angular_velocity": ros.axes(at("gyro", "xyz", k)),
            "linear_acceleration": ros.axes(at("acc", "xyz", k)),
        }
        units.append((stamp, unit))
    topics = {
        "/joint_states": ("sensor_msgs/msg/JointState", states),
        "/trunk/imu": ("sensor_msgs/msg/Imu", units),
    }
    path = ros.write_mcap(folder / "bag", topics)
    stated = Statement(base="floating", contacts={})
    found = robot_logs(folder / "robot.xml", path, stated)
    assert found.columns.beside.base.acceleration == "/trunk/imu.linear_acceleration"
    assert len(found.read(path).base) == 600

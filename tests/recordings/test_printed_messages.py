"""Messages that ROS and KUKA print are read by the joints' names in them."""

import re

import numpy as np
import pytest

from consistent_id.errors import RecordingError
from consistent_id.recordings.column_guess import guess_columns
from consistent_id.recordings.column_proposals import KnownColumns
from consistent_id.recordings.readers import read_recording
from consistent_id.recordings.readers.csv import read_arrays
from consistent_id.recordings.readers.printed_messages import named_columns
from consistent_id.recordings.readers.recording_file import column_names
from consistent_id.recordings.readers.yaml_messages import MessageError, fields_of

JOINTS = ("shoulder", "elbow")
PRINTED = ("elbow", "shoulder")  # ROS sorts names
SAMPLES = 40
FURTHER = ("velocities", "effort")


def values(k):
    """Position, velocity and effort of both joints, of which no two are equal."""
    return {
        "position": [0.1 * k + 1.0, -0.2 * k],
        "velocity": [0.5, 0.001 * k],
        "effort": [3.0 + k, 7.0 - k],
    }


def numbers(k):
    return [repr(v) for each in values(k).values() for v in each]


def csv_of_ros2(frame=""):
    return "".join(
        ",".join([str(100 + k // 10), str(10**8 * (k % 10)), frame, *PRINTED])
        + ","
        + ",".join(numbers(k))
        + "\n"
        for k in range(SAMPLES)
    )


def csv_of_ros1():
    fields = [f"field.{w}{j}" for w in ("name", *values(0)) for j in range(2)]
    header = ["%time", "field.header.seq", "field.header.stamp", *fields]
    rows = [
        [str(10**11 + 7), str(k), str(10**11 + 10**8 * k), *PRINTED, *numbers(k)]
        for k in range(SAMPLES)
    ]
    return "\n".join(",".join(row) for row in [header, *rows]) + "\n"


def csv_of_a_controller():
    """Names of joints are called ``joint_names``, and a set-point is beside them."""
    words = ("desired.positions", *(f"actual.{w}" for w in ("positions", *FURTHER)))
    fields = [f"field.{w}{j}" for w in ("joint_names", *words) for j in range(2)]
    rows = [
        [str(10**11 + 10**8 * k), *PRINTED, "0.5", "0.6", *numbers(k)]
        for k in range(SAMPLES)
    ]
    lines = [["field.header.stamp", *fields], *rows]
    return "\n".join(",".join(row) for row in lines) + "\n"


def yaml_of_ros2():
    def message(k):
        lists = {"name": PRINTED, **values(k)}
        stamp = f"  stamp:\n    sec: {100 + k // 10}\n    nanosec: {10**8 * (k % 10)}\n"
        body = "".join(
            f"{key}:\n" + "".join(f"- {item}\n" for item in items)
            for key, items in lists.items()
        )
        return f"header:\n{stamp}  frame_id: base\n{body}---\n"

    return "".join(map(message, range(SAMPLES)))


def yaml_of_ros1():
    def message(k):
        lists = {"name": PRINTED, **values(k)}
        stamp = f"    secs: {100 + k // 10}\n    nsecs: {10**8 * (k % 10)}\n"
        body = "".join(
            f"{key}: [{', '.join(map(str, items))}]\n" for key, items in lists.items()
        )
        return f"header: \n  seq: {k}\n  stamp: \n{stamp}  frame_id: ''\n{body}---\n"

    return "".join(map(message, range(SAMPLES)))


FORMS = {
    "ros2 topic echo --csv": csv_of_ros2(),
    "ros2 topic echo --csv, with a frame": csv_of_ros2("base_link"),
    "rostopic echo -p": csv_of_ros1(),
    "rostopic echo -p of a controller": csv_of_a_controller(),
    "ros2 topic echo": yaml_of_ros2(),
    "rostopic echo": yaml_of_ros1(),
}


@pytest.mark.parametrize("text", FORMS.values(), ids=FORMS)
def test_joint_states_are_read_by_the_names_in_them(tmp_path, text):
    file = tmp_path / "log.txt"
    file.write_text(text)
    found = guess_columns(file, KnownColumns(JOINTS)).columns
    if found.time == "field.header.stamp":  # whose unit no name states
        found = guess_columns(file, KnownColumns(JOINTS, units={"time": "ns"})).columns
    log = read_recording(file, JOINTS, found)
    np.testing.assert_allclose(np.diff(log.time), 0.1, rtol=1e-5)
    expected = [values(k) for k in range(SAMPLES)]
    for channel, ours in (("position",) * 2, ("velocity",) * 2, ("effort", "torque")):
        stated = np.array([row[channel][::-1] for row in expected])
        np.testing.assert_array_equal(getattr(log, ours), stated)


def test_a_message_of_other_joints_is_named(tmp_path):
    file = tmp_path / "log.csv"
    text = csv_of_ros2().replace("elbow,shoulder", "shoulder,elbow")
    file.write_text(csv_of_ros2() + text)
    columns = guess_columns(file, KnownColumns(JOINTS)).columns
    with pytest.raises(RecordingError, match="not all rows are of the joints"):
        read_recording(file, JOINTS, columns)


def test_a_grippers_messages_between_those_of_the_arm_are_left_out(tmp_path):
    gripper = yaml_of_ros2().replace("elbow", "finger").replace("- shoulder\n", "")
    parts = zip(yaml_of_ros2().split("---\n"), gripper.split("---\n"), strict=True)
    file = tmp_path / "log.txt"
    file.write_text("---\n".join(text for pair in parts for text in pair))
    columns = guess_columns(file, KnownColumns(JOINTS)).columns
    log = read_recording(file, JOINTS, columns)
    assert len(log) == SAMPLES


def test_messages_whose_joints_change_their_order_are_all_read(tmp_path):
    def message(k, joints):
        values = {"shoulder": k, "elbow": -k}
        names, position = (
            "".join(f"- {one}\n" for one in some)
            for some in (joints, [values[j] for j in joints])
        )
        stamp = f"header:\n  stamp:\n    sec: {k}\n    nanosec: 5\n"
        return f"{stamp}name:\n{names}position:\n{position}effort:\n{position}---\n"

    file = tmp_path / "log.yaml"
    orders = [JOINTS, JOINTS[::-1]]
    file.write_text("".join(message(k, orders[k % 2]) for k in range(SAMPLES)))
    columns = guess_columns(file, KnownColumns(JOINTS)).columns
    log = read_recording(file, ("shoulder", "elbow"), columns)
    np.testing.assert_array_equal(log.position[:, 0], np.arange(SAMPLES))
    np.testing.assert_array_equal(log.torque[:, 1], -np.arange(SAMPLES))


_STATE = """header:
  STAMP
  frame_id: ''
joint_names:
- shoulder
- elbow
output:
  positions: [7.0, 7.5]
  effort: []
feedback:
  positions:
  - {k}.25
  - -{k}.5
  effort:
  - 3.0
  - 4.0
  time_from_start:
    sec: 0
multi:
- name: first
  values: [1, 2]
---
"""


def test_a_controllers_state_is_read_by_its_names_of_joints(tmp_path):
    """Lists have the names that stand above; feedback goes before the output."""
    text = _STATE.replace("STAMP", _STAMP)
    file = tmp_path / "log.yml"
    file.write_text("".join(text.format(k=k) for k in range(SAMPLES)))
    columns = guess_columns(file, KnownColumns(JOINTS)).columns
    assert columns.position == "feedback.positions.{joint}"
    log = read_recording(file, ("shoulder", "elbow"), columns)
    np.testing.assert_array_equal(log.position[:, 0], np.arange(SAMPLES) + 0.25)
    np.testing.assert_array_equal(log.torque, np.tile([3.0, 4.0], (SAMPLES, 1)))
    fields = fields_of(text.format(k=3))
    assert fields["multi[0].values[1]"] == "2"
    assert fields["output.positions.elbow"] == "7.5"


_STAMP = "stamp:\n    sec: {k}\n    nanosec: 0"


def test_a_missing_value_of_yaml_is_one(tmp_path):
    file = tmp_path / "log.txt"
    text = re.sub(r"velocity: \[.*\]", "velocity: [.nan, .NaN]", yaml_of_ros1())
    file.write_text(text)
    columns = guess_columns(file, KnownColumns(JOINTS)).columns
    with pytest.raises(RecordingError, match=r"velocity of joint .* is nan at"):
        read_recording(file, JOINTS, columns)


@pytest.mark.parametrize("suffix", [".txt", ".xml"])
def test_kukas_elements_are_columns(tmp_path, suffix):
    file = tmp_path / f"log{suffix}"
    file.write_text(
        "".join(
            f'<Rob Type="KUKA"><AIPos A1="{k}.5" A2="-{k}"/><GearTorque A1="{k}" '
            f'A2="7"/><IPOC>{12 * k + 5}</IPOC></Rob>\n'
            for k in range(SAMPLES)
        )
    )
    with pytest.raises(RecordingError, match="IPOC: numbers that rise") as refused:
        guess_columns(file, KnownColumns(("joint_a1", "joint_a2")))
    assert refused.value.options == "--time IPOC --units time=ms"
    known = KnownColumns(
        ("joint_a1", "joint_a2"), {"time": "IPOC"}, units={"time": "ms"}
    )
    found = guess_columns(file, known)
    log = read_recording(file, found.joints, found.columns)
    np.testing.assert_allclose(np.diff(log.time), 0.012)
    np.testing.assert_allclose(log.position[:, 0], np.radians(np.arange(SAMPLES) + 0.5))
    np.testing.assert_array_equal(log.torque[:, 1], np.full(SAMPLES, 7.0))


@pytest.mark.parametrize(
    "text",
    [
        'time,q,tau\n0,"[0.5, -1e-3]","[3, 4]"\n1,"[1.5, nan]","[5, 6]"\n',
        "time;q;tau\n0;(0.5, -1e-3);(3, 4)\n1;(1.5, nan);(5, 6)\n",
        "time\tq\ttau\n0\t[ 0.5 -1e-3]\t[3. 4.]\n1\t[ 1.5   nan]\t[5. 6.]\n",
        'time,q,tau\n0,"[0.5\n -1e-3]","[3\n 4]"\n1,"[1.5\n nan]","[5\n 6]"\n',
    ],
)
def test_lists_in_cells_are_columns(tmp_path, text):
    """As pandas writes a column of tuples, lists or arrays."""
    file = tmp_path / "log.csv"
    file.write_text(text)
    names = ["time", "q[0]", "q[1]", "tau[0]", "tau[1]"]
    assert column_names(file) == tuple(names)
    found = guess_columns(file, KnownColumns(JOINTS)).columns
    assert found.in_log(JOINTS) == ("0", "1")
    assert (found.position, found.torque) == ("q[{joint}]", "tau[{joint}]")
    arrays = read_arrays(file, names, missing="omit")
    expected = [[0.0, 0.5, -1e-3, 3.0, 4.0], [1.0, 1.5, np.nan, 5.0, 6.0]]
    np.testing.assert_array_equal(np.column_stack(list(arrays.values())), expected)


@pytest.mark.parametrize(
    ("text", "names"),
    [
        ("time,q_a [rad],note\n0,1,(see 1)\n1,2,[3]\n", "time,q_a [rad],note"),
        ("# log (1, 2)\n# at (3, 4)\ntime,q[0],q[1]\n0,1,2\n", "time,q[0],q[1]"),
        ("time,q (1),q (2)\n0,1,2\n", "time,q (1),q (2)"),
        ('time,q1,note\n0,1,"moved (1, 2)"\n1,2,\n', "time,q1,note"),
        ("t;q\n0,5;[0,1 0,2]\n", "t;q"),  # decimal commas
    ],
)
def test_other_brackets_are_left(tmp_path, text, names):
    file = tmp_path / "log.csv"
    file.write_text(text)
    assert column_names(file) == tuple(names.replace(";", ",").split(","))


def test_missing_items_of_lists_and_comments_above(tmp_path):
    file = tmp_path / "log.csv"
    file.write_text('# pandas\ntime,q\n0,"[None, 2]"\n1,"[3, NaN]"\n')
    arrays = read_arrays(file, ["q[0]", "q[1]"], missing="omit")
    np.testing.assert_array_equal(arrays["q[0]"], [np.nan, 3.0])
    np.testing.assert_array_equal(arrays["q[1]"], [2.0, np.nan])


def test_names_of_yaml_are_of_the_lists_beside_them_first():
    said = "name: [b, a]\nposition: [1, 2]\ntcp:\n  position: [3, 4]\n"
    assert fields_of(said) == {
        "position.b": "1",
        "position.a": "2",
        "tcp.position[0]": "3",
        "tcp.position[1]": "4",
    }


@pytest.mark.parametrize(
    ("text", "fields"),
    [
        ("note: |\n  q: 1\n  - 2\nq: 5", {"q": "5"}),
        ("note: >-\n  some\n\n  words\nq: 5", {"q": "5"}),
        ("note: 'a: b\n\n- c'\nq: 5", {"q": "5"}),
        ("note: a text\n  of two lines\nq: 5", {"q": "5"}),
        ("q: 5  # rad", {"q": "5"}),
        ("'joint 1': 5\nand this: 6", {"joint 1": "5", "and this": "6"}),
        ("q: [1.0,\n  2.0]\nt: 3", {"q[0]": "1.0", "q[1]": "2.0", "t": "3"}),
        ("q: [[1, 2], [3]]", {"q[0][0]": "1", "q[0][1]": "2", "q[1][0]": "3"}),
        ("s: {q: 1, u: [2, 3]}\nt: 4", {"s.q": "1", "s.u[0]": "2", "s.u[1]": "3"}),
        ("q:\n- - 1\n  - 2\n- - 3", {"q[0][0]": "1", "q[0][1]": "2", "q[1][0]": "3"}),
        ("q:\n-\n  a: 1\n-\n  a: 2", {"q[0].a": "1", "q[1].a": "2"}),
        ("q: null\nu: .inf", {"q": "nan", "u": "inf"}),
    ],
)
def test_what_stands_behind_a_text_is_read(text, fields):
    """It was left out, in silence, and so was what stands in brackets in brackets."""
    found = fields_of("a:\n    b: 1\n" + text + "\nlast:\n- 9\n")
    assert found["a.b"] == "1"
    assert found["last[0]"] == "9"
    assert found.items() >= fields.items()


@pytest.mark.parametrize(
    "text",
    [
        "q:\n    a: 1\n  b: 2",
        "q:\n  - 1\n   - 2",
        "q: 5\n  b: 6",
        "q: [1, 2",
        "q: [1]]",
        "words",
        "- 5",
    ],
)
def test_a_line_that_is_not_understood_is_an_error(text):
    with pytest.raises(MessageError):
        fields_of("a: 1\n" + text + "\nlast: 9\n")


def test_numbers_of_another_message_are_not_those_of_the_joints():
    names = ["/js/name[0]", "/js/name[1]", "/js/position[0]", "/js/position[1]"]
    wrench = ["/ft/wrench[0]", "/ft/wrench[1]"]
    found = named_columns([*names, *wrench], ["a", "b", "0", "1", "2", "3"])
    assert found.names == (*names[:2], "/js/position.a", "/js/position.b", *wrench)


@pytest.mark.parametrize("arms", [("/l/", "/r/"), ("l_", "r_")])
def test_each_message_has_its_own_names_of_joints(arms):
    names = [
        f"{arm}{word}{k}" for arm in arms for word in ("name", "q") for k in (0, 1)
    ]
    found = named_columns(names, ["a", "b", "1", "2", "c", "d", "3", "4"]).names
    left, right = arms
    assert [found[k] for k in (2, 3)] == [f"{left}q.a", f"{left}q.b"]
    assert [found[k] for k in (6, 7)] == [f"{right}q.c", f"{right}q.d"]


def states(count=40):
    return [
        f"header:\n  stamp:\n    sec: {k}\n    nanosec: 5\njoint_names: [a, b]\n"
        f"actual:\n  positions:\n  - {k}.25\n  - 2.5\n"
        for k in range(count)
    ]


def column(path, name="actual.positions.a"):
    return read_arrays(path, [name])[name].tolist()


@pytest.mark.parametrize("newline", ["\n", "\r\n"])
@pytest.mark.parametrize("end", [-1, -2, -6, -12, -30])
def test_a_last_message_that_is_cut_off_is_left_out(tmp_path, end, newline):
    """With its last number cut off, 2.5 was 2."""
    path = tmp_path / "log.yaml"
    text = "---\n".join(states())[: end or None]
    path.write_bytes(text.replace("\n", newline).encode())
    assert column(path) == [k + 0.25 for k in range(39)]


LOST = "A message was lost!!!\n\ttotal count change:1\n\ttotal count: 1---\n"
UNPUBLISHED = "WARNING: topic [/state] does not appear to be published yet\n"


def test_notices_between_messages_are_passed_over(tmp_path):
    """``ros2 topic echo`` prints them, and the next message was left out."""
    parts = states()
    parts[0] = UNPUBLISHED + parts[0]
    parts[7] = LOST + parts[7]
    path = tmp_path / "log.yaml"
    path.write_text("---\n".join(parts))
    assert column(path) == [k + 0.25 for k in range(40)]


def test_a_message_that_is_not_understood_is_named(tmp_path):
    parts = states()
    parts[3] = parts[3].replace("  - 2.5", "   - 2.5")
    path = tmp_path / "log.yaml"
    path.write_text("---\n".join(parts))
    with pytest.raises(RecordingError, match=r"log\.yaml: not readable .* message 4"):
        column_names(path)


@pytest.mark.parametrize(
    ("name", "text"),
    [("a.yml", "robot: arm\nrate: 5\n"), ("a.xml", "<log/>")],
)
def test_other_files_of_yaml_and_xml_are_no_logs(tmp_path, name, text):
    (tmp_path / name).write_text(text)
    with pytest.raises(RecordingError, match="no messages as ros2 topic echo"):
        column_names(tmp_path / name)

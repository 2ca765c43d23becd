"""Repair: a semidefinite programme as the truth; Pinocchio and MuJoCo as readers."""

import json
import re

import numpy as np
import pinocchio as pin
import pytest
from robots import URDF, random_body
from schemas import parsed
from urdf_torques import DECORATED

from consistent_id import ModelError
from consistent_id.cli import main
from consistent_id.repair import nearest_inertia, repair_urdf
from consistent_id.repair.causes import THINNEST
from consistent_id.repair.link_repair import repair_record, repair_table
from consistent_id.robot import lint_urdf
from consistent_id.robot.inertia import second_moments

INERTIA = 'ixx="0.02" ixy="0.001" ixz="0.002" iyy="0.03" iyz="0.003" izz="0.025"'
TOO_LONG = INERTIA.replace('izz="0.025"', 'izz="0.09"')


@pytest.fixture
def broken(tmp_path):
    """Write a URDF; link `two`, whose inertial is on line 23, may be another."""

    def write(old="", new="", text=URDF):
        place = text.index('<link name="two"')
        head, tail = text[:place], text[place:]
        assert old in tail
        path = tmp_path / "robot.urdf"
        path.write_bytes((head + tail.replace(old, new, 1)).encode())
        return path

    return write


def _random_inertia(rng):
    """A symmetric matrix that may or may not be the inertia of a body."""
    A = rng.normal(size=(3, 3))
    return A + A.T + rng.uniform(0.0, 3.0) * np.eye(3)


@pytest.mark.parametrize("seed", range(4))
def test_the_nearest_body_is_that_of_a_semidefinite_programme(seed):
    import cvxpy as cp

    rng = np.random.default_rng(seed)
    mass, inertia = rng.uniform(0.5, 3.0), _random_inertia(rng)
    com = rng.normal(size=3)
    # All of the pseudo-inertia is free but the mass, in the frame of the link.
    S0 = second_moments(inertia)
    stated = np.block(
        [
            [S0 + mass * np.outer(com, com), mass * com[:, None]],
            [mass * com[None, :], np.array([[mass]])],
        ]
    )
    to_com = np.eye(4)
    to_com[:3, 3] = -com
    J = cp.Variable((4, 4), symmetric=True)
    central = to_com @ J @ to_com.T
    thinnest = THINNEST**2 * abs(np.linalg.eigvalsh(S0)).max()
    floor = np.diag([thinnest] * 3 + [0.0])
    change = to_com @ (J - stated) @ to_com.T
    problem = cp.Problem(
        cp.Minimize(cp.norm(change, "fro")), [central >> floor, J[3, 3] == mass]
    )
    problem.solve(solver=cp.CLARABEL)
    found = nearest_inertia(mass, inertia)
    assert problem.value == pytest.approx(
        found.change * np.linalg.norm(S0), rel=1e-5, abs=1e-6
    )
    assert np.allclose(second_moments(found.inertia), central.value[:3, :3], atol=1e-4)
    assert np.allclose(central.value[:3, 3], 0.0, atol=1e-4)


def test_a_body_is_its_own_nearest():
    body = random_body(np.random.default_rng(0))
    found = nearest_inertia(body.mass, body.central_inertia)
    assert found.change < 1e-15
    assert np.allclose(found.inertia, body.central_inertia, rtol=1e-14)


def test_the_nearest_body_turns_with_the_frame():
    rng = np.random.default_rng(1)
    inertia, turn = _random_inertia(rng), pin.SE3.Random().rotation
    first = nearest_inertia(1.0, inertia).inertia
    second = nearest_inertia(1.0, turn @ inertia @ turn.T).inertia
    assert np.allclose(turn @ first @ turn.T, second, atol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("new", "fault"),
    [
        (TOO_LONG, "one exceeds the sum of the others"),
        (INERTIA.replace('ixx="0.02"', 'ixx="-0.02"'), "one is negative"),
        (INERTIA.replace('ixy="0.001"', 'ixy="0.9"'), "one is negative"),
        (INERTIA.replace('iyy="0.03"', 'iyy="0"'), "one is negative"),
    ],
)
def test_impossible_inertias_become_those_of_bodies(broken, new, fault):
    repair = repair_urdf(broken(INERTIA, new))
    (link,) = repair.repaired
    assert (link.link, link.mass) == ("two", 1.0)
    assert fault in link.fault
    assert link.change > 0.0
    model = pin.buildModelFromXML(repair.content.decode())
    whole = model.inertias[model.getJointId("slide")]
    assert whole.mass == pytest.approx(1.5)
    repaired = broken(text=repair.content.decode())
    assert lint_urdf(repaired) == ()
    again = repair_urdf(repaired)
    assert again.content == repair.content
    assert not again.repaired


@pytest.mark.parametrize("newline", ["\n", "\r\n"])
def test_nothing_but_the_inertia_changes(broken, newline):
    text = DECORATED.replace("{0}", "utf-8").replace("\n", newline)
    before = broken(INERTIA, TOO_LONG, text).read_bytes()
    repair = repair_urdf(broken(INERTIA, TOO_LONG, text))
    assert repair.original == before
    entry = re.compile(rb'\b(i[xyz]{2})="([^"]*)"')
    assert entry.sub(rb"\1", repair.content) == entry.sub(rb"\1", before)
    pairs = zip(entry.findall(before), entry.findall(repair.content), strict=True)
    assert 1 <= sum(a != b for a, b in pairs) <= 6


def test_a_file_of_bodies_comes_out_byte_by_byte(broken):
    text = DECORATED.replace("{0}", "utf-8")
    repair = repair_urdf(broken(text=text))
    assert repair.content == text.encode()
    assert {link.status for link in repair.links} == {"consistent"}
    assert "nothing to repair: 4 inertials" in repair_table(repair).text()


def test_without_mass_there_is_no_inertia(broken):
    repair = repair_urdf(broken('value="1.0"', 'value="0"'))
    (link,) = repair.repaired
    assert "mass is zero, but principal moments" in link.fault
    assert link.after == (0.0, 0.0, 0.0)
    assert b'<mass value="0"/>' in repair.content


@pytest.mark.parametrize(
    ("old", "new", "fault", "remedy"),
    [
        ('<mass value="1.0"/>', "", "<mass> is missing", "its mass"),
        ('value="1.0"', 'value="nan"', "<mass value> is 'nan'", "its mass"),
        ('value="1.0"', 'value="1,0"', "<mass value> is '1,0'", "its mass"),
        ('value="1.0"', 'value="-1"', "mass is -1 kg", "its mass"),
        (f"<inertia {INERTIA}/>", "", "<inertia> is missing", "state a density"),
        ('ixx="0.02"', 'ixx="inf"', "<inertia ixx> is 'inf'", "state a density"),
        (' iyz="0.003"', "", "<inertia iyz> is missing", "state a density"),
        ('xyz="0.1 0.02 0.3"', 'xyz="0.1 nan 0.3"', "<origin xyz> is", "correct it"),
    ],
)
def test_what_would_have_to_be_made_up_is_refused(broken, old, new, fault, remedy):
    path = broken(old, new)
    repair = repair_urdf(path)
    (link,) = repair.refused
    assert (link.link, link.line) == ("two", 23)
    assert fault in link.fault
    assert remedy in link.remedy
    with pytest.raises(ModelError, match=r"robot\.urdf, line 23: link 'two'"):
        repair.save(path)


@pytest.mark.parametrize("stated", ["nan", "-1", ""])
def test_a_mass_that_is_stated_takes_the_place_of_the_files(broken, stated):
    path = broken('value="1.0"', f'value="{stated}"')
    repair = repair_urdf(path, masses={"two": 1.25})
    assert b'<mass value="1.25"/>' in repair.content
    (link,) = repair.repaired
    assert link.remedy == "mass set to 1.25 kg"
    assert repair.content == path.read_bytes().replace(
        f'value="{stated}"'.encode(), b'value="1.25"'
    )


def test_a_density_makes_a_ball_of_what_cannot_be_read(broken):
    repair = repair_urdf(broken(f"<inertia {INERTIA}/>", ""), density=1000.0)
    (link,) = repair.repaired
    radius = (3 / (4 * np.pi * 1000)) ** (1 / 3)
    assert link.after == pytest.approx((0.4 * radius**2,) * 3)
    assert lint_urdf(broken(text=repair.content.decode())) == ()


def test_point_masses_are_bodies_until_a_thickness_is_asked_for(broken):
    zero = re.sub(r'"[^"]*"', '"0"', INERTIA)
    path = broken(INERTIA, zero)
    repair = repair_urdf(path)
    assert repair.content == path.read_bytes()
    (advised,) = [link for link in repair.links if link.remedy]
    assert "a point mass" in advised.remedy
    thick = repair_urdf(path, thickness=0.01)
    (link,) = thick.repaired
    # Each second moment is m t^2, each moment of inertia the sum of two.
    assert link.after == pytest.approx((2e-4,) * 3)
    mujoco = pytest.importorskip("mujoco")
    free = '<mujoco><compiler discardvisual="true" strippath="true"/></mujoco></robot>'
    text = thick.content.decode().replace("</robot>", free)
    assert mujoco.MjModel.from_xml_string(text).nv == 3


@pytest.mark.parametrize("new", [TOO_LONG, INERTIA.replace("0.02", "-0.02")])
def test_mujoco_loads_what_it_refused(broken, new):
    mujoco = pytest.importorskip("mujoco")
    path = broken(INERTIA, new)
    with pytest.raises(ValueError, match="inertia"):
        mujoco.MjModel.from_xml_path(str(path))
    text = repair_urdf(path).content.decode()
    assert mujoco.MjModel.from_xml_string(text).nv == 3


@pytest.mark.parametrize(
    ("text", "options", "message"),
    [
        (URDF.replace("robot", "sdf"), {}, "expected <robot>"),
        (URDF.replace('"2.0"', '"${m}"'), {}, "run xacro"),
        ("<robot>", {}, "not well-formed"),
        (URDF, {"masses": {"toll": 1.0}}, "no link 'toll'.*known: .*tool"),
        (URDF, {"masses": {"tool": -1.0}}, "expected 0 or more"),
        (URDF, {"density": 0.0}, "expected a positive number"),
        (URDF, {"thickness": np.nan}, "expected 0 or more"),
    ],
)
def test_what_cannot_be_worked_on_is_refused(tmp_path, text, options, message):
    path = tmp_path / "robot.urdf"
    path.write_text(text)
    with pytest.raises(ModelError, match=message):
        repair_urdf(path, **options)
    with pytest.raises(ModelError, match="cannot be read"):
        repair_urdf(tmp_path / "nowhere.urdf")
    path.write_bytes(URDF.encode("utf-16"))
    with pytest.raises(ModelError, match="save the file as UTF-8"):
        repair_urdf(path)


def test_the_table_is_narrow_and_a_refusal_names_the_option(broken):
    text = repair_table(repair_urdf(broken('value="1.0"', 'value="-1.0"'))).text()
    assert "refused: its mass cannot be known; state it: --mass LINK=KG" in text
    assert "  link  line  status" in text


@pytest.mark.slow
def test_the_command_writes_beside_the_file(broken, capsys):
    path = broken(INERTIA, TOO_LONG)
    assert main(["repair", str(path), "--dry-run", "--verbose"]) == 0
    out = capsys.readouterr().out
    assert "one exceeds the sum of the others" in out
    assert "nothing was written" in out
    beside = path.with_name("robot.repaired.urdf")
    assert not beside.exists()
    assert main(["repair", str(path)]) == 0
    assert beside.read_bytes() == repair_urdf(path).content
    capsys.readouterr()
    other = path.with_name("other.urdf")
    assert main(["repair", str(beside), "--output", str(other), "--json"]) == 0
    assert other.read_bytes() == beside.read_bytes()
    record = parsed(capsys.readouterr().out)
    assert record["unchanged"]
    expected = json.loads(json.dumps(repair_record(repair_urdf(beside))))
    assert record == expected | {"written": str(other)}


def test_the_command_ends_with_1_where_something_is_refused(broken, capsys):
    path = broken('value="1.0"', 'value="-1"')
    assert main(["repair", str(path)]) == 1
    assert "refused: its mass cannot" in capsys.readouterr().out
    assert not path.with_name("robot.repaired.urdf").exists()
    assert main(["repair", str(path), "--mass", "two=1.5"]) == 0
    assert main(["repair", str(path), "--mass", "two"]) == 2
    assert "such as tool=0.4" in capsys.readouterr().err


def test_mjcf_is_answered_with_what_finds_its_faults(tmp_path):
    path = tmp_path / "robot.xml"
    path.write_text("<mujoco/>")
    with pytest.raises(ModelError, match=r"this is MJCF, .*`consistent-id lint`"):
        repair_urdf(path)

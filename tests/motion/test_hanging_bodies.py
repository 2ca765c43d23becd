"""Bodies behind joints that a motion does not command, wherever these joints stand.

The truth is Pinocchio's complete robot with coal, and closed forms.
"""

from dataclasses import replace

import coal
import numpy as np
import pinocchio as pin
import pytest
from published_robots import FOLDER

from consistent_id import ModelError, ProblemError, TorqueModel, motion_limits
from consistent_id.excitation.design_record import clearance_words
from consistent_id.excitation.verification import demands
from consistent_id.motion.collisions.clearance import prove_clearance
from consistent_id.motion.collisions.hanging import (
    FileTree,
    file_tree,
    hanging_bodies,
    swept,
)
from consistent_id.motion.collisions.scene_building import scene_from_urdf
from consistent_id.motion.collisions.separation import nearest
from consistent_id.motion.collisions.urdf_bodies import urdf_shapes
from consistent_id.recordings.joint_paths import FourierTrajectory
from consistent_id.robot import load_urdf

PANDA = FOLDER / "panda_description" / "urdf" / "panda.urdf"
needs_robots = pytest.mark.skipif(
    not PANDA.exists(), reason="example-robot-data is missing"
)

LINK = """<link name="{name}"><inertial><mass value="1"/>
  <inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial>{shape}</link>"""
JOINT = """<joint name="{name}" type="{kind}"><parent link="{parent}"/>
  <child link="{child}"/><origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="{axis}"/>
  <limit lower="{lower}" upper="{upper}" velocity="1" effort="9"/>{more}</joint>"""


def _shape(kind, origin="0 0 0"):
    return f"""<collision><origin xyz="{origin}"/><geometry>{kind}</geometry>
        </collision>"""


def _joint(name, parent, child, kind="revolute", **more):
    given = {"xyz": "0.4 0 0", "rpy": "0 0 0", "axis": "0 0 1"}
    given |= {"lower": -2, "upper": 2, "more": ""}
    keys = {"name": name, "parent": parent, "child": child, "kind": kind}
    return JOINT.format(**given | keys | more)


ROD = '<box size="0.3 0.05 0.05"/>'
LINKS = {
    "base": _shape('<box size="0.2 0.2 0.2"/>'),
    "arm": _shape(ROD, "0.2 0 0"),
    "hand": _shape(ROD, "0.2 0 0"),
    "thumb": _shape('<cylinder radius="0.03" length="0.1"/>', "0.05 0.02 0.01"),
    "nail": _shape('<sphere radius="0.04"/>', "0.06 0 0"),
}
JOINTS = {
    "shoulder": _joint("shoulder", "base", "arm", xyz="0 0 0.3"),
    "elbow": _joint("elbow", "arm", "hand", axis="0 1 0"),
    "grip": _joint("grip", "hand", "thumb", rpy="0.3 0.2 0", lower=-0.5, upper=0.9),
    "tap": _joint(
        "tap", "thumb", "nail", "prismatic", axis="0.6 0 0.8", lower=0.0, upper=0.05
    ),
}


def _file(folder, **joints):
    text = "".join(LINK.format(name=n, shape=s) for n, s in LINKS.items())
    path = folder / "robot.urdf"
    path.write_text(
        f"<robot name='r'>{text}{''.join((JOINTS | joints).values())}</robot>"
    )
    return path


def _complete(path):
    model = pin.buildModelFromUrdf(str(path))
    kind = pin.GeometryType.COLLISION
    return model, pin.buildGeomFromUrdf(
        model, str(path), kind, package_dirs=[str(p) for p in path.parents]
    )


def _distance(model, shapes, q, first, second):
    data, put = model.createData(), shapes.createData()
    pin.updateGeometryPlacements(model, data, shapes, put, q)
    a, b = (shapes.getGeometryId(f"{name}_0") for name in (first, second))
    objects = shapes.geometryObjects
    request, result = coal.DistanceRequest(), coal.DistanceResult()
    return coal.distance(
        objects[a].geometry,
        coal.Transform3s(put.oMg[a].rotation, put.oMg[a].translation),
        objects[b].geometry,
        coal.Transform3s(put.oMg[b].rotation, put.oMg[b].translation),
        request,
        result,
    )


@pytest.mark.slow
def test_a_hull_covers_a_body_at_every_position_of_the_joints_behind_the_tip(tmp_path):
    path = _file(tmp_path)
    robot = load_urdf(path, tip="hand")
    scene = scene_from_urdf(path, robot)
    assert scene.swept == ("thumb", "nail") and not scene.unchecked
    model, shapes = _complete(path)
    rng = np.random.default_rng(0)
    names = [scene.names(pair) for pair in scene.pairs]
    excess = []
    for _ in range(40):
        q = rng.uniform(-2.0, 2.0, 2)
        near = nearest(scene, q[None]).distance[0]
        for grip, tap in [
            (-0.5, 0.0),
            (0.9, 0.05),
            *rng.uniform((-0.5, 0), (0.9, 0.05), (6, 2)),
        ]:
            whole = np.array([*q, grip, tap])
            for link in ("thumb", "nail"):
                k = next(k for k, two in enumerate(names) if set(two) == {"base", link})
                true = _distance(model, shapes, whole, "base", link)
                if true > 0.0:
                    excess.append(true - near[k])
    assert min(excess) > -1e-6  # never nearer than the hull
    assert np.quantile(excess, 0.1) < 0.05  # and the hull is not far larger


def test_an_arc_lies_within_its_corners():
    """Of a point at radius 1: in the hull at every angle, and not 2 % further out."""
    from scipy.spatial import ConvexHull

    points = np.array([[1.0, 0.0, h] for h in (0.0, 0.1)] + [[0.9, 0.0, 0.0]])
    corners = swept(points, np.array([0.0, 0.0, 1.0]), -0.4, 1.7)
    hull = ConvexHull(corners)
    angle = np.linspace(-0.4, 1.3, 301)
    arc = np.column_stack([np.cos(angle), np.sin(angle), np.full(301, 0.05)])
    inside = hull.equations[:, :3] @ arc.T + hull.equations[:, 3:]
    assert inside.max() < 1e-12
    assert np.linalg.norm(corners[:, :2], axis=1).max() < 1.02


def test_a_locked_finger_stands_where_it_is_locked(tmp_path):
    path = _file(tmp_path)
    locked = load_urdf(path, tip="hand", locked={"grip": 0.4, "tap": 0.02})
    scene = scene_from_urdf(path, locked)
    assert not scene.swept
    names = {frozenset(scene.names(pair)): k for k, pair in enumerate(scene.pairs)}
    model, shapes = _complete(path)
    near = nearest(scene, [[0.3, -0.8]]).distance[0, names[frozenset({"base", "nail"})]]
    true = _distance(model, shapes, np.array([0.3, -0.8, 0.4, 0.02]), "base", "nail")
    assert near == pytest.approx(true, abs=1e-6)


def test_a_joint_without_limits_behind_the_tip_is_not_checked_and_named(tmp_path):
    path = _file(tmp_path)
    shapes = urdf_shapes(path)
    tree = file_tree(shapes.root)
    endless = replace(tree.joints["nail"], lower=-np.inf, upper=np.inf)
    nail = [body for body in shapes.bodies if body.frame == "nail"]
    robot = load_urdf(path, tip="hand")
    found = hanging_bodies(FileTree({**tree.joints, "nail": endless}), robot, nail)
    assert not found.bodies
    ((link, reason),) = found.lost
    assert link == "nail" and "--lock tap=POSITION" in reason


@pytest.mark.slow
def test_a_limb_that_nothing_can_avoid_is_refused_with_the_joints_to_lock(tmp_path):
    turned = _joint("grip", "hand", "thumb", xyz="-0.2 0 0", lower=-3.2, upper=3.2)
    bent = _joint("elbow", "arm", "hand", axis="0 1 0", lower=-0.1, upper=0.1)
    path = _file(tmp_path, elbow=bent, grip=turned)
    robot = load_urdf(path, tip="hand")
    lock = "--lock grip=POSITION"
    with pytest.raises(ProblemError, match=rf"'thumb' hangs on .*'arm'.*{lock}"):
        scene_from_urdf(path, robot)
    # A scene by default keeps the other bodies apart, and says what is not checked.
    scene = scene_from_urdf(path, robot, readable_only=True)
    assert scene.pairs and "thumb" not in {body.name for body in scene.bodies}
    assert any("thumb" in said and lock in said for said in scene.unchecked)
    assert "proven" not in clearance_words(scene)
    locked = load_urdf(path, tip="hand", locked={"grip": 1.6, "tap": 0.0})
    assert scene_from_urdf(path, locked).pairs


def test_a_file_without_shapes_is_refused_with_what_else_to_do(tmp_path):
    text = "".join(LINK.format(name=name, shape="") for name in ("base", "arm"))
    joint = _joint("shoulder", "base", "arm", lower=-1, upper=1)
    path = tmp_path / "arm.urdf"
    path.write_text(f'<robot name="arm">{text}{joint}</robot>')
    with pytest.raises(ModelError, match=r"no link has a shape, .*without a scene"):
        scene_from_urdf(path, load_urdf(path))


def test_meshes_that_are_all_missing_are_named_with_the_option_for_their_package(
    tmp_path,
):
    mesh = _shape('<mesh filename="package://arms/arm.stl"/>')
    text = "".join(LINK.format(name=name, shape=mesh) for name in ("base", "arm"))
    joint = _joint("shoulder", "base", "arm", lower=-1, upper=1)
    path = tmp_path / "arm.urdf"
    path.write_text(f'<robot name="arm">{text}{joint}</robot>')
    with pytest.raises(ModelError, match=r"was not found .*--package-dirs"):
        scene_from_urdf(path, load_urdf(path), readable_only=True)


MIMIC = '<mimic joint="elbow" multiplier="-1.5" offset="0.2"/>'


@pytest.mark.slow
def test_a_follower_is_kept_off_where_its_leader_puts_it(tmp_path):
    """Slopes by finite differences; positions by Pinocchio; a proof over a path."""
    follower = _joint("grip", "hand", "thumb", lower=-4, upper=4, more=MIMIC)
    path = _file(tmp_path, grip=follower)
    robot = load_urdf(path, locked={"tap": 0.0})
    scene = scene_from_urdf(path, robot)
    assert len(robot) == 2 and len(robot.joints) == 3
    names = {frozenset(scene.names(pair)): k for k, pair in enumerate(scene.pairs)}
    k = names[frozenset({"arm", "thumb"})]
    model, shapes = _complete(path)
    q = np.array([[0.3, 0.7], [-0.5, -0.9]])
    near = nearest(scene, q)
    for i, (shoulder, elbow) in enumerate(q):
        whole = np.array([shoulder, elbow, -1.5 * elbow + 0.2, 0.0])
        true = _distance(model, shapes, whole, "arm", "thumb")
        assert near.distance[i, k] == pytest.approx(true, abs=1e-5)
    step = 1e-6 * np.eye(2)
    ends = [nearest(scene, q[:1] + sign * step).distance[:, k] for sign in (1, -1)]
    slopes = (ends[0] - ends[1]) / 2e-6
    assert near.gradient[0, k] == pytest.approx(slopes, abs=1e-5)
    swing = FourierTrajectory(
        ("shoulder", "elbow"), [0.5], [0.0, 0.2], [[0.2, 0.3]], [[0.1, 0.0]], 2.0
    )
    report = prove_clearance(scene, swing)
    time = np.linspace(0.0, 2.0, 2001)
    seen = nearest(scene, swing.evaluate(time, 0)[0]).slack.min()
    assert report.margin <= seen + 1e-9 and report.margin > seen - 2e-3


@pytest.mark.slow
@needs_robots
def test_fingers_of_a_panda_are_kept_off_with_its_tip_or_without():
    every = scene_from_urdf(PANDA, load_urdf(PANDA), clearance=0.02)
    part = scene_from_urdf(PANDA, load_urdf(PANDA, tip="panda_link8"), clearance=0.02)
    assert not every.unchecked and not part.unchecked
    assert part.swept == ("panda_leftfinger", "panda_rightfinger")
    # The hand, and what hangs on it, is not joined to the link before the last joint.
    pairs = {frozenset(part.names(pair)) for pair in part.pairs}
    assert frozenset({"panda_link6", "panda_leftfinger"}) in pairs
    assert frozenset({"panda_link6", "panda_hand"}) in pairs
    assert frozenset({"panda_link6", "panda_link7"}) not in pairs


def test_the_weight_of_bodies_behind_the_tip_is_said_not_to_count(tmp_path):
    inertial = (
        '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" '
        'iyz="0"/></inertial>'
    )
    ball = "<collision><origin xyz='{} 0 0'/><geometry><sphere radius='0.05'/>"
    link = "<link name='{}'>" + inertial + ball + "</geometry></collision></link>"
    joint = (
        "<joint name='{0}' type='revolute'><parent link='{1}'/><child link='{2}'/>"
        "<origin xyz='{3} 0 0'/><axis xyz='0 1 0'/>"
        "<limit lower='-0.5' upper='0.5' effort='90' velocity='1'/></joint>"
    )
    file = tmp_path / "arm.urdf"
    file.write_text(
        "<robot name='arm'>"
        + "".join(link.format(name, 0.3) for name in ("base", "boom", "finger", "head"))
        + joint.format("lift", "base", "boom", 0.5)
        + joint.format("grip", "boom", "finger", 0.5)
        + joint.format("nod", "base", "head", -0.9)
        + "</robot>"
    )

    def notes(**part):
        robot = load_urdf(file, **part)
        scene = scene_from_urdf(file, robot, readable_only=True)
        limits = motion_limits(robot, acceleration=5.0)
        required = demands(TorqueModel(robot), limits, scene=scene)
        return [note for note in required.notes if "weight" in note]

    (said,) = notes(tip="boom")  # the head does not hang on the arm
    assert "without the weight of finger, which the robot carries" in said
    assert not notes(locked={"grip": 0.0, "nod": 0.0})

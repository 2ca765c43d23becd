"""A robot's own shapes are kept apart where nothing is said of collisions."""

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from consistent_id.cli import main
from consistent_id.excitation.design_record import kept_apart, kept_limits
from consistent_id.excitation.request import default_scene, design_request
from consistent_id.excitation.sources import problem_to_excite
from consistent_id.motion.collisions.separation import nearest

LINKS = """
<robot name="folding">
  <link name="base">{base}</link>
  <link name="upper">{upper}</link>
  <link name="lower">{lower}</link>
  <link name="hand">{hand}</link>
  <joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/>
    <axis xyz="0 0 1"/><limit lower="-3" upper="3" velocity="2" effort="40"/></joint>
  <joint name="elbow" type="revolute"><parent link="upper"/><child link="lower"/>
    <origin xyz="0.5 0 0"/><axis xyz="0 0 1"/>
    <limit lower="-3" upper="3" velocity="2" effort="20"/></joint>
  <joint name="wrist" type="revolute"><parent link="lower"/><child link="hand"/>
    <origin xyz="0.5 0 0"/><axis xyz="0 0 1"/>
    <limit lower="-3" upper="3" velocity="2" effort="5"/></joint>
</robot>
"""
BOX = """<collision><origin xyz="{x} 0 0"/><geometry>
    <box size="{length} 0.1 0.1"/></geometry></collision>"""
DISC = """<collision><geometry><cylinder radius="0.52" length="0.1"/></geometry>
    </collision>"""
MESH = """<collision><geometry><mesh filename="package://gone/hand.stl"/></geometry>
    </collision>"""


def _box(x, length):
    return BOX.format(x=x, length=length)


def _robot(folder, **shapes):
    boxes = {
        "base": _box(0.0, 0.1),
        "upper": _box(0.25, 0.4),
        "lower": _box(0.25, 0.4),
        "hand": _box(0.1, 0.2),
    }
    file = folder / "folding.urdf"
    file.write_text(LINKS.format(**boxes | shapes))
    return file


def _request(file, **changes):
    return design_request(problem_to_excite(file, changes))


def test_shapes_of_the_file_are_watched_by_default_and_adjacent_ones_are_not(tmp_path):
    request = _request(_robot(tmp_path))
    scene = request.scene
    pairs = {frozenset(scene.names(pair)) for pair in scene.pairs}
    apart = {("base", "lower"), ("base", "hand"), ("upper", "hand")}
    assert pairs == {frozenset(two) for two in apart}
    neighbours = {("base", "upper"), ("upper", "lower"), ("lower", "hand")}
    assert set(scene.adjacent) == neighbours
    assert all(" and ".join(names) in scene.remarks[0] for names in neighbours)
    assert "--no-collisions" in request.notes[0]
    # The hand folded on to the upper arm: 0.5 - 0.5 along it, by hand.
    folded = nearest(scene, [[0.0, 3.0, 3.0]])
    assert folded.distance.min() < 0.0


@pytest.mark.parametrize(
    ("shapes", "changes", "said"),
    [
        ({}, {"collisions": False}, "as requested"),
        (dict.fromkeys(("base", "upper", "lower", "hand"), ""), {}, "has no <coll"),
    ],
)
def test_without_a_scene_the_note_says_why(tmp_path, shapes, changes, said):
    request = _request(_robot(tmp_path, **shapes), **changes)
    assert request.scene is None and said in request.notes[0]


def test_shapes_that_cannot_be_read_are_named_and_the_others_are_kept_off(
    tmp_path, capsys
):
    file = _robot(tmp_path, hand=MESH)
    scene = _request(file).scene
    (unchecked,) = scene.unchecked
    assert "link hand" in unchecked and "hand.stl' was not found" in unchecked
    assert [scene.names(pair) for pair in scene.pairs] == [("base", "lower")]
    assert main(["excite", str(file), "--acceleration", "5", "--dry-run"]) == 0
    told = " ".join(capsys.readouterr().out.split("\n")[:10])
    assert "NOT CHECKED for collisions: link hand" in told
    assert "apart, proven" not in told


def test_no_collisions_leaves_out_a_scene_that_is_given(tmp_path):
    file = _robot(tmp_path)
    assert len(_request(file, ground=-0.5).scene.bodies) == 5
    assert _request(file, ground=-0.5, collisions=False).scene is None


def test_shapes_that_touch_where_the_robot_stands_are_left_out_and_named(tmp_path):
    """A hand as long as the arm: it reaches back over the upper arm at the start."""
    problem = problem_to_excite(_robot(tmp_path, hand=_box(0.1, 0.9)), {})
    stretched = dict.fromkeys(("shoulder", "elbow", "wrist"), 0.0)
    free, _ = default_scene(problem, None)
    standing, _ = default_scene(problem, stretched)
    # The hand covers x of 0.65 to 1.55 m, the upper arm 0.05 to 0.45 m.
    bent = {"shoulder": 0.0, "elbow": 2.8, "wrist": 0.0}
    left, _ = default_scene(problem, bent)
    gone = {str(note) for note in left.notes} - {str(note) for note in free.notes}
    assert len(standing.pairs) == len(free.pairs) > len(left.pairs)
    assert gone and all("touch in the start pose" in note for note in gone)
    kept = nearest(left, [list(bent.values())])
    assert (kept.distance > 0.0).all()


def test_bodies_near_each_other_at_the_start_only_must_not_touch(tmp_path):
    """The hand ends 10 mm before the upper arm, which ends at 0.45 m."""
    problem = problem_to_excite(_robot(tmp_path, hand=_box(0.15, 1.38)), {})
    start = dict.fromkeys(("shoulder", "elbow", "wrist"), 0.0)
    scene, _ = default_scene(problem, start)
    wanted = {frozenset(scene.names(pair)): pair.wanted for pair in scene.pairs}
    near = nearest(scene, [[0.0] * 3]).distance[0]
    assert sorted(near)[0] < 0.02  # the premise
    for pair, distance in zip(scene.pairs, near, strict=True):
        expected = 0.0 if distance < 0.02 else 0.02
        assert wanted[frozenset(scene.names(pair))] == expected


def test_rotor_inertia_is_among_the_parameters_that_a_default_design_excites(tmp_path):
    names = problem_to_excite(_robot(tmp_path), {}).model.layout.names
    assert sum("rotor" in name for name in names) == 3


def test_the_shell_says_what_is_kept_apart(tmp_path, capsys):
    file = _robot(tmp_path)
    asked = ["excite", str(file), "--acceleration", "5", "--dry-run", "--verbose"]
    assert main(asked) == 0
    told = capsys.readouterr().out
    assert "Bodies kept apart" in told and "self-collisions are avoided" in told
    assert main([*asked, "--no-collisions"]) == 0
    told = capsys.readouterr().out
    assert "Bodies kept apart" not in told and "as requested" in told


def test_every_distance_is_said_with_its_pairs(tmp_path):
    scene, _ = default_scene(problem_to_excite(_robot(tmp_path), {}), None)
    first, *others = scene.pairs
    said = kept_apart(replace(scene, pairs=(replace(first, wanted=0.0), *others)))[-1]
    several = f"{len(others)} pairs stay" if len(others) > 1 else "1 pair stays"
    named = " and ".join(scene.names(first))
    near = f"1 pair must not touch ({named})"
    assert f"3 pairs that can come together: {several} 20 mm apart, {near}" in said


def test_what_is_proven_and_what_is_left_out_is_one_statement(tmp_path):
    file = _robot(tmp_path)
    changes = {"ground": -0.5, "allowed": [("base", "hand")]}
    scene = _request(file, **changes).scene
    (said,) = kept_apart(scene)
    assert said.startswith("bodies: proven for all times between ")
    proven, left = said.split("; left out: ")
    # The floor and three links, and base and lower, upper and hand.
    assert "5 pairs that can come together: 5 pairs stay 20 mm apart" in proven
    assert left.startswith("3 pairs of neighbours, whose shapes overlap at their joint")
    assert "base and upper, upper and lower, lower and hand" in left
    assert "1 pair that may touch, as stated (base and hand)" in left
    names = [pair[:2] for pair in scene.left_out]
    apart = [scene.names(pair) for pair in scene.pairs]
    assert len({frozenset(pair) for pair in [*names, *apart]}) == 9


def test_a_plan_does_not_say_that_anything_is_proven(tmp_path, capsys):
    file = _robot(tmp_path)
    assert main(["excite", str(file), "--acceleration", "5", "--dry-run"]) == 0
    told = " ".join(capsys.readouterr().out.split())
    assert "to be proven for all times between 3 pairs" in told
    assert not re.search(r"(?<!to be )proven", told)


@pytest.mark.slow
def test_a_stated_clearance_that_no_pose_keeps_is_refused_and_the_default_relaxed(
    tmp_path, capsys
):
    """A disc about the wrist is 30 mm away from the upper arm if the elbow is straight.

    The upper arm ends 50 mm before the elbow, the wrist is 500 mm behind it.
    """
    file = _robot(tmp_path, hand=DISC)
    asked = ["excite", str(file), "--acceleration", "5", "--dry-run"]
    assert main([*asked, "--clearance", "1"]) == 2
    said = capsys.readouterr().err
    assert "1000 mm is stated" in said and "'upper' and 'hand'" in said
    assert "30.0 mm, at elbow = " in said and "--allowed upper,hand" in said
    assert main(asked) == 0
    first = " ".join(capsys.readouterr().out.split()[:60])
    assert "must not touch (upper and hand; the default clearance is relaxed" in first
    assert main([*asked, "--clearance", "1", "--allowed", "upper,hand"]) == 2
    assert "'upper' and 'hand'" not in capsys.readouterr().err
    with pytest.raises(SystemExit):
        main([*asked, "--allowed", "upper"])
    assert "expected two bodies or links" in capsys.readouterr().err


def test_a_floor_that_is_too_high_is_refused_with_bodies_pose_and_height(
    tmp_path, capsys
):
    file = _robot(tmp_path)
    asked = ["excite", str(file), "--acceleration", "5", "--dry-run", "--ground"]
    assert main([*asked, "0.6"]) == 2
    said = capsys.readouterr().err
    assert "'ground' and 'upper'" in said and "shoulder = " in said
    assert "penetrate each other by 650.0 mm" in said
    assert main([*asked, re.search(r"--ground (-[\d.]+) or less", said)[1]]) == 0


def test_a_limit_of_some_joints_is_said_with_the_joints_that_lack_it(tmp_path):
    limits = _request(_robot(tmp_path)).limits
    some = replace(limits, jerk=np.array([50.0, np.inf, 50.0]))
    known = {"parameters": np.zeros((1, 30)), "unweighed": ()}
    said = kept_limits(SimpleNamespace(limits=some, **known))
    assert "no limit is stated for acceleration, jerk (elbow)" in said

"""A scene watches what can come together, and says what it does not watch."""

import gc
import weakref

import numpy as np
import pytest

from consistent_id import DHRow, ProblemError, from_modified_dh
from consistent_id.motion import Body, Box, Hull, Scene, Sphere, build_scene, plane
from consistent_id.motion.collisions.farthest import random_poses
from consistent_id.motion.collisions.scene import Pair
from consistent_id.motion.collisions.separation import nearest
from consistent_id.robot import JointLimits

ARM = from_modified_dh("arm", [DHRow(0, 0), *[DHRow(np.pi / 2, 0.5)] * 3])


def _ball(link, radius=0.1):
    return Body(f"ball on {link}", Sphere(radius), link, translation=[0.2, 0.0, 0.0])


def _watched(scene):
    return {scene.names(pair) for pair in scene.pairs}


def test_adjacent_links_and_bodies_of_one_link_are_not_watched():
    one, two, three = (_ball(f"link{k}", 0.05) for k in (1, 2, 3))
    other = Body("other on link1", Sphere(0.05), "link1")
    scene = build_scene(ARM, [one, other, two, three])
    assert _watched(scene) == {
        ("ball on link1", "ball on link3"),
        ("other on link1", "ball on link3"),
    }


def test_obstacles_are_watched_even_from_the_first_link():
    stone = Body("stone", Box((0.1, 0.1, 0.1)), translation=[1.0, 0.0, 0.0])
    scene = build_scene(ARM, [plane(-2.0), stone, _ball("link1")])
    assert _watched(scene) == {
        ("ground", "ball on link1"),
        ("stone", "ball on link1"),
    }


def test_bodies_of_the_robot_that_always_touch_are_told_and_not_watched():
    scene = build_scene(ARM, [_ball("link1", 0.6), _ball("link3", 0.6)])
    assert not scene.pairs
    (note,) = scene.notes
    assert str(note) == (
        "ball on link1 and ball on link3, not watched: they touch at 200 of 200 random "
        "poses"
    )


@pytest.mark.slow
def test_an_obstacle_that_always_touches_is_refused_unless_it_is_allowed():
    bodies = [Body("floor", Box((1, 1, 1))), _ball("link1")]
    said = (
        r"'floor' and 'ball on link1' apart\. .*joint1 = .* penetrate .* by \d+\.\d mm"
    )
    with pytest.raises(ProblemError, match=said):
        build_scene(ARM, bodies)
    with pytest.raises(ProblemError, match="--allowed 'floor,ball on link1'"):
        build_scene(ARM, bodies)
    scene = build_scene(ARM, bodies, allowed=[("floor", "link1")])
    assert not scene.pairs and "allowed" in scene.notes[0].reason


def test_more_room_is_asked_for_a_tool_by_the_name_of_its_link():
    stone = Body("stone", Sphere(0.1), translation=[3.0, 0.0, 0.0])
    scene = build_scene(
        ARM,
        [stone, _ball("link2", 0.01), _ball("link4", 0.01)],
        clearance=0.02,
        extra={"link4": 0.03},
    )
    wanted = {scene.names(pair)[1]: pair.wanted for pair in scene.pairs[:2]}
    assert wanted == {"ball on link2": 0.02, "ball on link4": 0.05}


def test_of_bodies_that_are_seldom_far_apart_only_touching_is_unwanted():
    bodies = [_ball("link1", 0.01), _ball("link3", 0.01)]
    (pair,) = build_scene(ARM, bodies, clearance=2.0).pairs
    (note,) = build_scene(ARM, bodies, clearance=2.0).notes
    assert (
        pair.wanted == 0.0 and note.watched and "nearer than 2000.0 mm" in note.reason
    )


def test_a_stated_distance_is_kept_where_few_poses_keep_it():
    bodies = [_ball("link1", 0.01), _ball("link3", 0.01)]
    stated = build_scene(ARM, bodies, clearance=0.1, relax=False)
    reach = nearest(stated, random_poses(ARM, 200, 0)).distance
    far = float(np.quantile(reach, 0.9))  # a tenth of the poses keep it
    for relax, wanted in ((True, 0.0), (False, far)):
        (pair,) = build_scene(ARM, bodies, clearance=far, relax=relax).pairs
        assert pair.wanted == wanted


def test_limits_tell_which_bodies_always_touch():
    rows = [DHRow(0, 0), DHRow(0, 0.5, limits=JointLimits(3.0, 3.1)), DHRow(0, 0.5)]
    bodies = [Body("a", Sphere(0.2), "link1"), Body("b", Sphere(0.2), "link3")]
    assert not build_scene(from_modified_dh("folded", rows), bodies).pairs
    rows[1] = DHRow(0, 0.5)
    assert build_scene(from_modified_dh("free", rows), bodies).pairs


def test_names_that_nobody_has_are_refused():
    with pytest.raises(ProblemError, match="named 'link9'; known"):
        build_scene(ARM, [_ball("link1")], allowed=[("link1", "link9")])
    with pytest.raises(ProblemError, match="names of bodies repeat: ball on link1"):
        build_scene(ARM, [_ball("link1"), _ball("link1")])
    with pytest.raises(ProblemError, match="clearance is -1"):
        build_scene(ARM, [_ball("link1")], clearance=-1.0)
    with pytest.raises(ProblemError, match="of 1 bodies"):
        Scene(ARM, (_ball("link1"),), (Pair(0, 1),))


def test_a_linkage_that_overlaps_at_every_opening_is_not_checked_as_a_whole():
    """Two stops, of which the finger touches one at every angle, like a gripper."""
    finger = Body("finger", Box((0.2, 0.02, 0.02)), "link2", translation=[0.25, 0, 0])
    ends = [
        Body(name, Sphere(0.42), "link1", translation=[0.5, side * 0.4, 0.0])
        for name, side in (("left", 1.0), ("right", -1.0))
    ]
    hand = from_modified_dh(
        "hand",
        [
            DHRow(0, 0, limits=JointLimits(-1.0, 1.0)),
            DHRow(0, 0.5, limits=JointLimits(-2.0, 1.9)),
        ],
    )
    linked = dict(connected=lambda one, other: False)
    scene = build_scene(hand, [finger, *ends], **linked)
    (note,) = scene.notes
    assert "others" in note.reason and len(scene.unchecked) == 1
    (pair,) = scene.pairs
    assert {"finger", "left", "right"} == {*scene.names(pair), note.first, note.second}
    near = nearest(scene, random_poses(hand, 200, 0)).distance
    assert near.max() > 0.004  # there are poses now that can be left
    # Where distances were stated, nothing is left out.
    strict = build_scene(hand, [finger, *ends], relax=False, **linked)
    assert len(strict.pairs) == 2 and not strict.unchecked


@pytest.mark.slow
def test_nothing_of_a_scene_is_kept_when_it_is_gone():
    corners = np.random.default_rng(0).normal(size=(20, 3))
    hull = Body("hull", Hull(corners), "link4")
    scene = build_scene(ARM, [_ball("link1"), hull])
    nearest(scene, np.zeros((1, 4)))
    kept = weakref.ref(hull.shape.points)
    del scene, hull
    gc.collect()
    assert kept() is None

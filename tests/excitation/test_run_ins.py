"""Ways to a path and back, where the straight ones are not free."""

from dataclasses import replace

import numpy as np
import pytest
from robots_in_scenes import scene_problem
from some_fast import some_fast

from consistent_id.excitation.proven_moves import Playing, proven_move
from consistent_id.excitation.request import design_request
from consistent_id.excitation.verification import demands
from consistent_id.motion import Body, Sphere, build_scene, move_along, prove_clearance
from consistent_id.motion.collisions.separation import nearest
from consistent_id.recordings import FourierTrajectory
from consistent_id.recordings.joint_paths import harmonics_of

# An arm in a plane, on the other side of a post: two joints, so that there is a way
# around it, but not the straight one.
PLANAR = """
name = "planar"
[model]
modified_dh = [
    {{ alpha_deg = 0.0, a = 0.0, lower = -3.0, upper = 3.0, velocity = 2.0 }},
    {{ alpha_deg = 0.0, a = 0.5, lower = -2.9, upper = 2.9, velocity = 2.0 }},
]
[constraints]
masses = "free"
[excitation]
duration = 4.0
harmonics = 2
refine = "none"
{excitation}
[excitation.limits]
acceleration = 6.0
{limits}
[excitation.scene]
robot = "bodies"
clearance = 0.01
bodies = [
    {{ name = "upper arm", link = "link1", capsule = {{ radius = 0.04, ends = [[0.0, 0.0, 0.0], [0.5, 0.0, 0.0]] }} }},
    {{ name = "forearm", link = "link2", capsule = {{ radius = 0.04, ends = [[0.0, 0.0, 0.0], [0.5, 0.0, 0.0]] }} }},
    {{ name = "post", cylinder = {{ radius = 0.05, length = 1.0 }}, position = [0.75, 0.0, 0.0] }},
]
"""  # noqa: E501


def _planar(folder, ends):
    """A problem, the proof of a path beyond the post, and a pose before it."""
    limits = "position = { joint1 = [-3.0, 3.0], joint2 = [-2.9, 2.9] }"
    problem = scene_problem(folder, PLANAR, limits=limits)
    request = design_request(problem)
    required = demands(problem.model, request.limits, None, request.scene)
    frequencies = harmonics_of(0.25, 2)
    cosine = np.array([[0.4], [-0.1]]) * [0.3, 0.3]
    sine = np.zeros((2, 2)) if ends == "rest" else 0.1 * np.ones((2, 2))
    path = FourierTrajectory(
        ("joint1", "joint2"), frequencies, [1.2, 0.3], sine, cosine, 4.0
    )
    pose = {"joint1": -1.2, "joint2": 0.0}
    return path, required.proof(path), required, pose


@pytest.mark.slow
@pytest.mark.parametrize("ends", some_fast(["rest", "periodic"]))
def test_a_run_in_goes_around_what_stands_in_the_straight_way(tmp_path, ends):
    path, proof, required, pose = _planar(tmp_path, ends)
    assert proof.holds
    straight = move_along(path, required.limits, from_pose=pose, to_pose=pose)
    assert prove_clearance(required.scene, straight.run_in).violated
    found = proven_move(path, proof, required, Playing(pose))
    assert "through other poses" in found.note
    assert found.proof.holds and required.proof(found.move.pieces).holds
    ends = found.move.evaluate([0.0, found.move.duration])
    np.testing.assert_allclose(ends[0], [[-1.2, 0.0]] * 2, atol=1e-9)
    # Truth of its own: distances at many poses of the whole move.
    time = np.linspace(0.0, found.move.duration, 3001)
    apart = nearest(required.scene, found.move.evaluate(time, 0)[0])
    assert apart.slack.min() >= 0.0


@pytest.mark.slow
def test_a_periodic_path_begins_where_its_run_in_is_free(tmp_path):
    """The way to its far side sweeps over a stone, with the arm stretched out."""
    path, _, required, _ = _planar(tmp_path, "rest")
    shares = {"sine": [[0.0, 0.6], [0, 0]], "cosine": [[0.6, 0.0], [0, 0]]}
    circle = replace(path, offset=[1.2, 1.2], **shares)
    home = {"joint1": -1.2, "joint2": 0.0}
    place = 0.97 * np.array([np.cos(0.9), np.sin(0.9), 0.0])
    stone = Body("stone", Sphere(0.02), None, None, place)
    arm = required.scene.bodies[:2]
    scene = build_scene(required.scene.robot, [*arm, stone])
    among = replace(required, scene=scene)
    proof = among.proof(circle)
    straight = move_along(circle, among.limits, from_pose=home, to_pose=home)
    assert proof.holds and prove_clearance(scene, straight.run_in).violated
    found = proven_move(circle, proof, among, Playing(home))
    assert found.note.startswith("begun ")
    direct = among.proof(found.move.pieces)
    assert direct.holds
    # What was proven of one phase is what holds of another, at its own time.
    assert len(direct.margins.margins) == len(found.proof.margins.margins)
    for mine, theirs in zip(
        found.proof.margins.margins, direct.margins.margins, strict=True
    ):
        assert mine.bound == pytest.approx(theirs.bound, abs=1e-3)
    begun = found.move.trajectory.evaluate([found.move.window[0]], 2)[:, 0]
    later = float(found.note.split()[1])
    np.testing.assert_allclose(begun, circle.evaluate([later], 2)[:, 0], atol=1e-9)

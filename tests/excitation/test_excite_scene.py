"""What a problem file says of surroundings is kept, from the start pose and back."""

import json
import os
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pinocchio as pin
import pytest
from robots_in_scenes import ARM, LEVER, WALL, scene_problem
from schemas import parsed

from consistent_id import ProblemError
from consistent_id.cli import main
from consistent_id.excitation.design import design_trajectory
from consistent_id.excitation.output import (
    _proven_words,
    planned,
    playable_record,
    write_design,
)
from consistent_id.excitation.playable import playable_design
from consistent_id.excitation.request import requested_scene
from consistent_id.motion import prove_clearance
from consistent_id.motion.collisions.separation import nearest
from consistent_id.motion.proofs.margins import motion_margins

SHARE = Path(pin.__file__).parents[4] / "share"
ROBOTS = SHARE / "example-robot-data" / "robots"


def _blind(problem, design):
    """The same design without its scene, and the scene's report of its path.

    The first of three seeds whose path runs through something: where a search that
    knows of nothing ends depends on the machine's rounding.
    """
    for seed in range(3):
        blind = design_trajectory(
            problem.model,
            design.form,
            design.aim,
            limits=design.limits,
            starts=1,
            workers=1,
            time_limit=60.0,
            seed=seed,
        )
        report = prove_clearance(design.demands.scene, blind.trajectory)
        if report.violated:
            break
    return blind, report


def _with_free_run_ins(problem):
    """Return the first design whose run-ins are clear of the wall.

    A run-in is straight. Which seeds have free ones depends on the machine's rounding,
    as the local optima do.
    """
    for seed in range(8):
        found = playable_design(
            problem, starts=1, seed=seed, workers=1, time_limit=60.0
        )
        if len(found.moves) == 2:
            return found
    pytest.fail(f"no run-in is free: {found.refusals}")


@pytest.mark.slow
def test_a_wall_is_kept_clear_of_which_the_same_design_without_it_runs_through(
    tmp_path,
):
    problem = scene_problem(tmp_path, ARM, bodies=WALL)
    found = playable_design(problem, starts=1, workers=1, time_limit=60.0)
    report = found.design.proof.clearance
    assert report.holds and report.proven >= 0.01
    assert [whole.clearance.holds for whole in found.proofs.values()] == [True, True]
    blind, through = _blind(problem, found.design)
    assert through.violated and "wall" in (through.first, through.second)
    assert found.design.condition.value < 3.0 * blind.condition.value


def test_rods_reach_from_one_end_to_the_other(tmp_path):
    post = '{ name = "post", sphere = { radius = 0.1 }, position = [0, 0, 1] },'
    scene = requested_scene(scene_problem(tmp_path, ARM, bodies=post))
    pairs = {scene.names(p): k for k, p in enumerate(scene.pairs)}
    near = nearest(scene, [[0.0, np.pi / 2, 0.0], [0.0, 0.0, np.pi / 2]])
    first = near.distance[:, pairs["upper arm", "post"]]
    # Upright it ends at 0.6 m; level, it is nearest at its beginning.
    np.testing.assert_allclose(first, [0.4 - 0.05 - 0.1, 1.0 - 0.05 - 0.1], atol=1e-6)
    second = near.distance[:, pairs["forearm", "post"]]
    far = np.hypot(0.6, 0.5) - 0.04 - 0.1  # from (0.6, 0.5) to (0, 1)
    np.testing.assert_allclose(second, [-0.04 - 0.1, far], atol=1e-6)


@pytest.mark.parametrize(
    ("parts", "said"),
    [
        ({"scene": "ground = true"}, r"excitation.scene.ground"),
        ({"scene": "floor = 0.0"}, r"excitation.scene has no key 'floor'"),
        ({"scene": "extra = { link9 = 0.1 }"}, r"\[excitation.scene\].*'link9'"),
        ({"bodies": '{ name = "x" },'}, r"bodies\]\] 3, 'x' needs one of .* has none"),
        (
            {"bodies": '{ name = "x", capsule = { radius = 0.1 } },'},
            "'x': a rod needs length or ends; it has neither",
        ),
        (
            {"bodies": '{ name = "x", link = "link7", sphere = { radius = 0.1 } },'},
            r"\[excitation.scene\].*no link named 'link7'",
        ),
    ],
)
def test_errors_name_the_key(tmp_path, parts, said):
    with pytest.raises(ProblemError, match=said):
        planned(scene_problem(tmp_path, ARM, **parts))


def test_shapes_of_a_urdf_need_a_urdf(tmp_path):
    text = LEVER.replace('robot = "bodies"', 'robot = "urdf"')
    with pytest.raises(
        ProblemError, match="from URDF files only, and this robot"
    ) as it:
        planned(scene_problem(tmp_path, text))
    # In the words of the shell first, where no problem file may have been written.
    said = str(it.value)
    assert (
        said.index("--ground") < said.index("init ROBOT") < said.index("scene.bodies")
    )


def test_only_what_is_proven_is_said_to_be():
    whole = SimpleNamespace(unchecked=(), left_out=())
    part = SimpleNamespace(unchecked=("hand",), left_out=())
    without = SimpleNamespace(unchecked=(), left_out=[("arm", "hand", "neighbours")])
    assert [_proven_words(one) for one in (None, whole, part, without)] == [
        "limits proven for all times",
        "limits and clearances proven for all times",
        "limits, and clearances of the bodies that are checked, proven for all times",
        "limits and clearances proven for all times, without the 1 pair left out above",
    ]


def test_a_start_pose_in_an_obstacle_is_refused_before_any_search(tmp_path):
    problem = scene_problem(tmp_path, LEVER, excitation="start_pose = { joint1 = 0.0 }")
    with pytest.raises(ProblemError, match="start_pose: bodies 'arm' and 'post' are -"):
        planned(problem)
    problem = scene_problem(tmp_path, LEVER, excitation="start_pose = { joint7 = 0.0 }")
    with pytest.raises(ProblemError, match="start_pose: no joint 'joint7'"):
        planned(problem)


@pytest.mark.slow
def test_a_run_in_through_an_obstacle_is_refused_with_a_pose_that_would_do(tmp_path):
    options = {"starts": 1, "workers": 1, "time_limit": 60.0}
    free = playable_design(scene_problem(tmp_path, LEVER), **options)
    side = float(free.design.trajectory.evaluate([0.0])[0, 0, 0])
    beyond = -1.5 * np.sign(side)
    pose = f"start_pose = {{ joint1 = {beyond} }}"
    excited = playable_design(
        scene_problem(tmp_path, LEVER, excitation=pose), **options
    )
    assert "trajectory" not in excited.moves and excited.design.proof.holds
    told = excited.refusals[0]
    assert "run-in: bodies 'arm' and 'post' at " in told
    assert f"or none: this path can be reached from joint1 = {side:.3f}" in told
    # The design is not lost, but no motion that collides is written.
    names = {path.name for path in write_design(excited, tmp_path / "out")}
    assert "excitation.json" in names and "trajectory.json" not in names


def same_proof(mine, theirs):
    """Whether two proofs state the same margins, of the same times."""
    pairs = zip(mine.margins.margins, theirs.margins.margins, strict=True)
    return mine.clearance.path == theirs.clearance.path and all(
        (a.joint, a.quantity) == (b.joint, b.quantity)
        and [a.bound, a.time] == pytest.approx([b.bound, b.time], abs=1e-9)
        for a, b in [*pairs]
    )


@pytest.mark.slow
def test_every_piece_is_proven_once(tmp_path, monkeypatch):
    proven = []

    def counted(path, *others, **options):
        piece = path.evaluate([path.start, path.start + path.duration / 3.0]).tobytes()
        proven.append((path.duration, piece))
        return motion_margins(path, *others, **options)

    monkeypatch.setattr("consistent_id.excitation.verification.motion_margins", counted)
    problem = scene_problem(tmp_path, ARM, excitation="rest = false")
    excited = playable_design(problem, starts=1, workers=1, time_limit=60.0)
    assert list(excited.moves) == ["trajectory", "validation"]
    assert len(set(proven)) == len(proven)
    # One stage, one validation path, and a run-in and a run-out of each.
    assert len(proven) == 6


@pytest.mark.slow
def test_a_validation_motion_has_its_own_clearance_where_it_alone_is_played(tmp_path):
    problem = scene_problem(tmp_path, ARM, bodies=WALL, excitation="rest = false")
    excited = playable_design(problem, starts=1, workers=1, time_limit=60.0)
    alone = replace(
        excited,
        moves={"validation": excited.moves["validation"]},
        proofs={"validation": excited.proofs["validation"]},
    )
    scene = playable_record(alone)["scene"]
    assert "whole_move" not in scene
    reported = excited.proofs["validation"].clearance
    assert scene["validation_move"]["proven_m"] == reported.proven


@pytest.mark.slow
def test_all_that_is_played_is_proven_and_lasts_as_designed(tmp_path):
    problem = scene_problem(tmp_path, ARM, bodies=WALL, excitation="rest = false")
    excited = _with_free_run_ins(problem)
    assert list(excited.moves) == ["trajectory", "validation"]
    demands = excited.design.demands
    for name, move in excited.moves.items():
        whole = excited.proofs[name]
        assert whole.holds
        assert same_proof(whole, demands.proof(move.pieces))
        pieces = move.pieces
        worst = min(demands.proof(p).margins.least.relative for p in pieces)
        assert whole.margins.least.relative == pytest.approx(worst)
        # Run-in and run-out take looks of their own, beyond those at the path.
        path = demands.proof(move.trajectory)
        assert whole.clearance.poses > path.clearance.poses > 0
        # The validation path repeats after twice that: its other half is not proven.
        assert move.trajectory.duration == pytest.approx(6.0)
        limits = excited.design.limits
        time = np.linspace(0.0, move.duration, 4001)
        motion = move.evaluate(time)
        assert (motion[0] <= limits.upper + 1e-9).all()
        assert (motion[0] >= limits.lower - 1e-9).all()
        assert (abs(motion[1]) <= limits.velocity + 1e-9).all()


@pytest.mark.slow
def test_the_proof_of_one_period_is_that_of_all(tmp_path):
    twice = scene_problem(
        tmp_path, ARM, bodies=WALL, excitation="rest = false\nperiods = 2"
    )
    excited = _with_free_run_ins(twice)
    move, whole = excited.moves["trajectory"], excited.proofs["trajectory"]
    assert move.trajectory.duration == pytest.approx(12.0)
    direct = excited.design.demands.proof(move.pieces)
    for mine, theirs in zip(whole.margins.margins, direct.margins.margins, strict=True):
        assert (mine.joint, mine.quantity) == (theirs.joint, theirs.quantity)
        # Both enclose the same extreme, to a millionth of the range.
        assert mine.bound == pytest.approx(theirs.bound, rel=1e-5)
    # Both prove a clearance that is a millimetre below the true one at most.
    assert whole.clearance.margin == pytest.approx(direct.clearance.margin, abs=1e-3)


@pytest.mark.parametrize(
    ("excitation", "says"),
    [
        ("start_pose = { joint1 = 9.0 }", "joint1 = 9, expected between"),
        ("start_pose = { jiont1 = 0.0 }", "no joint 'jiont1'"),
        ("rest = false\nperiods = 2\nbase_frequencies = [0.1, 0.15]", "play it once"),
    ],
)
def test_what_cannot_be_played_is_refused_before_the_search(tmp_path, excitation, says):
    problem = scene_problem(tmp_path, ARM, excitation=excitation)
    with pytest.raises(ProblemError, match=says):
        playable_design(problem, starts=1, workers=1, time_limit=60.0)


def test_a_dry_run_shows_limits_and_pairs_and_writes_nothing(tmp_path, capsys):
    scene_problem(tmp_path, ARM, bodies=WALL)
    output = tmp_path / "out"
    asked = ["excite", str(tmp_path), "--dry-run", "--output", str(output)]
    assert main(asked) == 0
    told = capsys.readouterr().out
    assert "from rest to rest" in told and "wall" in told and "10 mm" in told
    assert not output.exists()
    assert main([*asked, "--json"]) == 0
    record = parsed(capsys.readouterr().out)
    assert record["tables"][1]["rows"][0][:3] == ["joint1", "-3", "3"]
    assert record["limits"]["lower"][0] == -3.0
    assert any("wall" in said for said in record["kept_apart"])


@pytest.mark.slow
def test_formats_are_checked_before_the_search_and_written_after(tmp_path, capsys):
    scene_problem(tmp_path, LEVER)
    output = tmp_path / "out"
    asked = ["excite", str(tmp_path), "--output", str(output), "--starts", "1"]
    assert main([*asked, "--format", "csv,pdf"]) == 2
    assert "format 'pdf'" in capsys.readouterr().err and not output.exists()
    assert main([*asked, "--format", "npz"]) == 0
    assert "least clearance between" in capsys.readouterr().out
    names = {file.name for file in output.iterdir()}
    assert {"trajectory.json", "trajectory.npz", "excitation.png"} < names
    assert "trajectory.csv" not in names
    assert "follow.py" not in names  # which plays trajectory.yaml
    record = json.loads((output / "excitation.json").read_text())
    assert record["scene"]["bodies"] == ["arm", "post"]
    assert record["scene"]["whole_move"]["proven_m"] >= 0.0
    assert record["stages"][-1]["clearance"]["bodies"] == ["arm", "post"]


@pytest.mark.slow
@pytest.mark.skipif(not ROBOTS.exists(), reason="example-robot-data is missing")
def test_a_ur10_on_a_floor_keeps_clear_of_it_and_of_itself(tmp_path):
    file = ROBOTS / "ur_description" / "urdf" / "ur10_joint_limited_robot.urdf"
    text = f"""
name = "ur10"
[model]
urdf = "{file}"
joints = ["shoulder_lift_joint", "elbow_joint", "wrist_2_joint"]
[excitation]
harmonics = 2
refine = "none"
[excitation.scene]
packages = ["{os.path.relpath(SHARE, tmp_path)}"]
ground = 0.0
clearance = 0.01
allowed = [["ground", "base_link"], ["ground", "shoulder_link"]]
"""
    problem = scene_problem(tmp_path, text.replace("{", "{{").replace("}", "}}"))
    found = playable_design(problem, starts=1, workers=1, time_limit=60.0).design
    assert found.proof.clearance.proven >= 0.0
    assert _blind(problem, found)[1].violated


@pytest.mark.slow
def test_a_tool_stays_in_its_box_from_rest_to_rest(tmp_path):
    box = 'workspaces = [{ link = "link3", point = [0.5, 0.0, 0.0], z = [-0.3, 2.0] }]'
    problem = scene_problem(tmp_path, ARM, scene=box, excitation="rest = false")
    found = playable_design(problem, starts=1, workers=1, time_limit=60.0)
    move = found.moves["trajectory"]
    time = np.linspace(0.0, move.duration, 2001)
    q = move.evaluate(time, 0)[0]
    # Upright joints two and three turn in a plane: heights by hand.
    height = 0.6 * np.sin(q[:, 1]) + 0.5 * np.sin(q[:, 1] + q[:, 2])
    assert height.min() >= -0.3
    free, _ = _blind(problem, found.design)
    q = free.trajectory.evaluate(np.linspace(0.0, 6.0, 2001), 0)[0]
    height = 0.6 * np.sin(q[:, 1]) + 0.5 * np.sin(q[:, 1] + q[:, 2])
    assert height.min() < -0.3


@pytest.mark.slow
def test_a_tool_points_into_its_cone_from_rest_to_rest(tmp_path):
    cone = (
        'cones = [{ link = "link3", angle_deg = 40.0, axis = [0.0, 0.0, 1.0], '
        "direction = [1.0, 0.0, 0.0] }]"
    )
    problem = scene_problem(tmp_path, ARM, scene=cone, excitation="rest = false")
    found = playable_design(problem, starts=1, workers=1, time_limit=60.0)
    move = found.moves["trajectory"]
    q = move.evaluate(np.linspace(0.0, move.duration, 2001), 0)[0]
    # Joints two and three turn in one plane: the forearm's elevation is their sum.
    steepness = np.degrees(np.arccos(np.sin(q[:, 1] + q[:, 2])))
    assert steepness.max() <= 40.0
    free, _ = _blind(problem, found.design)
    q = free.trajectory.evaluate(np.linspace(0.0, 6.0, 2001), 0)[0]
    assert np.sin(q[:, 1] + q[:, 2]).min() < np.cos(np.radians(40.0))


@pytest.mark.slow
def test_the_shapes_of_an_mjcf_file_are_not_read(tmp_path, capsys):
    file = tmp_path / "arm.xml"
    file.write_text(
        """<mujoco><worldbody><body name="a"><joint name="s" range="-1 1"/>
        <geom type="sphere" size=".1"/></body></worldbody></mujoco>"""
    )
    call = ["excite", str(file), "--velocity", "2", "--dry-run", "--ground", "0"]
    assert main(call) == 2
    said = capsys.readouterr().err
    assert "not from MJCF files such as arm.xml" in said and 'name = "a"' in said
    assert main(call[:-2]) == 0

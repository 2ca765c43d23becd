"""Wrong and unusual requests of a design are answered in the user's words."""

import pytest

from consistent_id.cli import main
from consistent_id.errors import ProblemError
from consistent_id.excitation.sources import problem_to_excite
from consistent_id.problems.statement import Statement

LINK = """<link name="{0}"><inertial><origin xyz="0.1 0 0"/><mass value="1"/>
  <inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
"""
JOINT = """<joint name="{0}" type="{1}"><parent link="{2}"/><child link="{3}"/>
  <axis xyz="0 1 0"/>{4}</joint>
"""
LIMIT = '<limit lower="-1" upper="1" velocity="2" effort="20"/>'


def _robot(folder, *kinds, limit=LIMIT):
    links = ["base", *(f"link{k}" for k, _ in enumerate(kinds))]
    text = '<link name="base"/>' + "".join(LINK.format(name) for name in links[1:])
    for k, kind in enumerate(kinds):
        text += JOINT.format(f"joint{k}", kind, links[k], links[k + 1], limit)
    file = folder / "odd.urdf"
    file.write_text(f'<robot name="odd">{text}</robot>')
    return str(file)


def _answer(capsys, file, *words):
    """Return the exit code of a plan, and the words of its error."""
    try:
        code = main(["excite", file, "--acceleration", "5", "--dry-run", *words])
    except SystemExit as ended:
        code = ended.code
    return code, " ".join(capsys.readouterr().err.split())


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--duration", "0"], "--duration: 0 is not a positive number"),
        (["--duration", "ten"], "--duration: 'ten' is not a positive number"),
        (["--duration", "1e9"], "1e+11 samples, expected 1000000 at most"),
        (["--duration", "0.05"], "cannot be recorded at 100 Hz; make it longer"),
        (["--harmonics", "0"], "--harmonics: 0 is not a whole number above 0"),
        (["--harmonics", "2.5"], "--harmonics: 2.5 is not a whole number above 0"),
        (["--harmonics", "1"], "a path of one frequency cannot rest at both ends"),
        (["--harmonics", "51"], "a path of 51 frequencies, up to 5.1 Hz, expected 50"),
        (["--harmonics", "5000"], "up to 500 Hz cannot be recorded at 100 Hz"),
        (["--starts", "0"], "--starts: 0 is not a whole number above 0"),
        (["--workers", "0"], "--workers: 0 is not a whole number above 0"),
        (["--seed", "one"], "--seed: 'one' is not a whole number"),
        (["--friction-share", "some"], "--friction-share: 'some' is not a number"),
        (["--share", "2"], "share of limits is 2.0, expected above 0 up to 1"),
        (["--ground", "nan"], "--ground: nan is not a finite number"),
        (["--ground", "0"], "no link has a shape"),
        (["--thin", "1e-4", "--format", "csv"], "--thin is for the yaml file"),
        (["--format", "pdf"], "format 'pdf' of a trajectory"),
        (["--start-pose", "joint7=0"], "start_pose: no joint 'joint7'; known:"),
        (["--lock", "joint7=0"], "no joint 'joint7' to keep or lock; known:"),
        (["--tip", "hand"], "no link named 'hand'; known:"),
    ],
)
def test_what_cannot_be_planned_is_refused_before_any_search(
    tmp_path, capsys, words, said
):
    code, error = _answer(capsys, _robot(tmp_path, "revolute", "revolute"), *words)
    assert code == 2 and said in error
    assert "invalid" not in error and "Traceback" not in error


@pytest.mark.parametrize(
    ("kinds", "limit", "said"),
    [
        (["revolute"], "", "position between -inf and inf, expected finite numbers"),
        (
            ["revolute"],
            LIMIT.replace("-1", "3"),
            "limits are reversed, lower 3 > upper",
        ),
        (["fixed"], "", "has no moving joint"),
    ],
)
def test_robots_that_cannot_be_planned_for_are_refused(
    tmp_path, capsys, kinds, limit, said
):
    code, error = _answer(capsys, _robot(tmp_path, *kinds, limit=limit))
    assert code == 2 and said in error


@pytest.mark.parametrize(
    "kinds", [["revolute"], ["continuous", "revolute"], ["prismatic", "revolute"]]
)
def test_unusual_robots_have_a_plan(tmp_path, capsys, kinds):
    code, error = _answer(capsys, _robot(tmp_path, *kinds))
    assert code == 0 and not error


@pytest.mark.slow
@pytest.mark.parametrize(
    "kinds", [["revolute"], ["continuous", "prismatic", "revolute"]]
)
def test_unusual_robots_have_a_motion(tmp_path, capsys, kinds):
    words = ["excite", _robot(tmp_path, *kinds), "--acceleration", "5", "--starts", "1"]
    words += ["--time-limit", "1", "--output", str(tmp_path / "out")]
    assert main(words) == 0
    assert "proven for all times" in " ".join(capsys.readouterr().out.split())


@pytest.mark.slow
@pytest.mark.parametrize("base", [None, "floating"])
def test_a_base_that_floats_is_refused_before_the_search(tmp_path, base):
    """The loader proposes it, but no motion can be designed for it."""
    file = tmp_path / "robot.xml"
    file.write_text(
        """<mujoco><worldbody><body name="a"><freejoint/>
        <inertial pos="0 0 0" mass="4" diaginertia=".1 .1 .1"/><body name="b">
        <joint name="s" range="-1 1" axis="0 1 0"/>
        <inertial pos="0 0 -.4" mass="1" diaginertia=".05 .05 .01"/></body></body>
        </worldbody></mujoco>"""
    )
    with pytest.raises(ProblemError, match="designed for a fixed base: --base a") as it:
        problem_to_excite(file, {"velocity": 2.0}, Statement(base=base))
    assert "--standing" in str(it.value) and it.value.options == "--base a"
    still = problem_to_excite(file, {"velocity": 2.0}, Statement(base="a"))
    assert still.moving.joint_names == ("s",)

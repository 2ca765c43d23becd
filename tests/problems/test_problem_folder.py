"""A folder of problems: several robots, or several problems of one."""

import json

import numpy as np
import pytest

from consistent_id import ProblemError, load_problem
from consistent_id.cli import main
from consistent_id.problems import load_problems
from consistent_id.problems.loading import problem_files

LEFT, RIGHT = 0.3, 0.5  # lengths of the upper arms, m


def _text(name, length, log="log.csv"):
    return f"""
name = "{name}"
[model]
modified_dh = [{{ alpha_deg = 90, a = 0 }}, {{ alpha_deg = 0, a = {length} }}]
[drive]
viscous = true
[constraints]
masses = "free"
[data.columns]
torque = "tau_{{joint}}"
[[data.recordings]]
file = "{log}"
role = "training"
"""


@pytest.fixture
def cell(tmp_path):
    """A folder with two arms side by side, and a third in a folder of its own."""
    (tmp_path / "left.toml").write_text(_text("left", LEFT))
    (tmp_path / "right.toml").write_text(_text("right", RIGHT))
    (tmp_path / "pyproject.toml").write_text("[project]\n")
    (tmp_path / "old").mkdir()
    (tmp_path / "old" / "problem.toml").write_text(_text("old", 0.1, "lost.csv"))
    t = np.arange(600) / 100
    q = np.column_stack([np.sin(2 * t), np.cos(3 * t)])
    tau = np.column_stack([np.cos(2 * t), np.sin(5 * t)])
    table = np.column_stack([t, q, tau])
    header = "time,q_joint1,q_joint2,tau_joint1,tau_joint2"
    np.savetxt(tmp_path / "log.csv", table, delimiter=",", header=header, comments="")
    return tmp_path


def test_a_folder_stands_for_its_problem_file_or_else_for_all_in_it(cell):
    assert problem_files(cell / "old") == (cell / "old" / "problem.toml",)
    names = [str(file.relative_to(cell)) for file in problem_files(cell)]
    assert names == ["left.toml", "right.toml", "old/problem.toml"]
    (cell / "old" / "spare.toml").write_text(_text("spare", 0.2))
    assert len(problem_files(cell / "old")) == 1
    assert len(problem_files(cell)) == 4


def test_every_robot_of_a_folder_is_loaded(cell):
    left, right, old = load_problems(cell)
    arms = [p.model.robot.joints[1].translation[0] for p in (left, right, old)]
    assert arms == [LEFT, RIGHT, 0.1]
    assert [len(p.training) for p in (left, right)] == [1, 1]
    assert (left.missing, old.missing) == ((), ("lost.csv",))


def test_where_one_problem_is_asked_for_the_choice_is_named(cell):
    with pytest.raises(ProblemError, match=r"3 problems: left.toml, right.toml, old/"):
        load_problem(cell)
    (cell / "old" / "problem.toml").write_text(_text("left", 0.1))
    with pytest.raises(
        ProblemError, match=r"2 problems are named 'left'.*name = \.\.\."
    ):
        load_problems(cell)


def test_a_folder_without_problems_says_so(tmp_path):
    with pytest.raises(ProblemError, match=r"no problem.toml in this folder"):
        load_problems(tmp_path)


def test_info_lists_the_problems_and_what_they_miss(cell, capsys):
    (cell / "right.toml").write_text('name = "right"\n[model]\nurdf = "no.urdf"\n')
    assert main(["info", str(cell)]) == 0
    out = capsys.readouterr().out
    assert "left.toml" in out
    assert "right.toml: " in out  # why it cannot be loaded
    assert "old/problem.toml: no lost.csv" in out
    assert main(["info", str(cell), "--json"]) == 0
    (table,) = json.loads(capsys.readouterr().out)
    states = [row[-1] for row in table["rows"]]
    assert states == ["ready", "cannot be loaded", "1 recordings missing"]


def test_info_of_one_problem_names_its_neighbours(cell, capsys):
    (cell / "old" / "spare.toml").write_text(_text("spare", 0.2))
    assert main(["info", str(cell / "old")]) == 0
    assert "of this folder: problem.toml, spare.toml" in capsys.readouterr().out


@pytest.mark.slow
def test_several_problems_are_worked_through_whatever_happens_to_one(cell, capsys):
    output = cell / "results"
    assert main(["identify", str(cell), "--json", "--output", str(output)]) == 2
    printed = capsys.readouterr()
    assert list(json.loads(printed.out)) == ["left", "right"]
    assert "lost.csv: no such file" in printed.err
    assert (output / "left" / "constrained.json").exists()
    assert (output / "right" / "constrained.json").exists()

"""Designs for some parameters: what can be told of them, and how much better."""

import json
from dataclasses import replace

import numpy as np
import pytest
from estimates import estimate_of
from excited import FRICTION, arm, arm_limits, arm_problem

from consistent_id import InertialParameters, ProblemError, TorqueModel
from consistent_id.cli import main
from consistent_id.excitation.accuracy import predicted_accuracy, relative_accuracy
from consistent_id.excitation.aims import (
    Aim,
    PathForm,
    base_for,
    interest_names,
    parameters_named,
    places_of_interest,
)
from consistent_id.excitation.design import design_trajectory
from consistent_id.excitation.sources import problem_to_excite, with_open_parameters
from consistent_id.regression import base_parameters
from consistent_id.regression.row_structure import random_regressor
from consistent_id.robot import load_urdf

INTERESTS = [("link3",), ("link2",), ("*.viscous",), ("joint1", "link3.h?")]


def rank(columns):
    norms = np.linalg.norm(columns, axis=0)
    seen = norms > 1e-9 * norms.max()  # what is less is rounding
    return int(np.linalg.matrix_rank(columns[:, seen] / norms[seen], tol=1e-8))


@pytest.mark.parametrize("words", INTERESTS, ids=str)
def test_what_leads_is_all_that_can_be_told_from_the_others(words):
    model = TorqueModel(arm(3), FRICTION)
    base = base_for(model, words)
    named = parameters_named(model.layout, words)
    others = [i for i in range(len(model.layout)) if i not in named]
    places = places_of_interest(base, words)
    W = np.concatenate(list(random_regressor(model, seed=3)), axis=1).T
    assert len(places) == rank(W) - rank(W[:, others])
    # They hold nothing but what is named, and all of them explain every torque.
    assert not base.projection[np.ix_(places, others)].any()
    explained = W[:, list(base.independent)] @ base.projection
    assert np.allclose(explained, W, atol=1e-9 * abs(W).max())
    assert list(base.independent) == sorted(base.independent)


@pytest.mark.parametrize("words", [*INTERESTS, ("link1",)], ids=str)
def test_where_the_others_are_known_all_that_the_columns_tell_leads(words):
    model = TorqueModel(arm(3), FRICTION)
    base = base_for(model, words, known=True)
    named = list(parameters_named(model.layout, words))
    W = np.concatenate(list(random_regressor(model, seed=3)), axis=1).T
    assert len(base) == rank(W[:, named])
    assert set(base.independent) <= set(named)
    assert len(places_of_interest(base, words)) == len(base)
    own = base.projection[:, named]
    explained = W[:, list(base.independent)] @ own
    assert np.allclose(explained, W[:, named], atol=1e-9 * abs(W).max())
    others = [i for i in range(len(model.layout)) if i not in named]
    assert not base.projection[:, others].any()


def test_a_load_s_mass_is_identifiable_where_the_robot_is_known():
    model = TorqueModel(arm(3), FRICTION)
    mass = model.layout.index("link3.m")
    assert mass not in base_for(model, ("link3",)).independent
    assert mass in base_for(model, ("link3",), known=True).independent


def test_without_a_name_base_parameters_are_the_usual_ones():
    model = TorqueModel(arm(3), FRICTION)
    assert base_for(model, ()).groupings == base_parameters(model).groupings
    assert places_of_interest(base_parameters(model), ()) == ()


def test_a_link_is_ten_parameters_and_a_star_any_letters():
    layout = TorqueModel(arm(2), FRICTION).layout

    def names(*words):
        return [layout.names[i] for i in parameters_named(layout, words)]

    assert names("link2") == [n for n in layout.names if n.startswith("link2.")]
    assert len(names("link2")) == 10
    assert names("*.viscous") == ["joint1.viscous", "joint2.viscous"]
    assert names("joint1.viscous", "link1.m") == ["link1.m", "joint1.viscous"]


def block_size(design, aim):
    """Geometric mean of the errors of interest, along the axes of their covariance."""
    base = base_for(design.model, aim.interest)
    accuracy = predicted_accuracy(design.model, base, design.trajectory, Aim())
    W = accuracy.factor
    places = list(places_of_interest(base, aim.interest))
    covariance = np.linalg.inv(W.T @ W)[np.ix_(places, places)]
    return float(np.linalg.det(covariance) ** (0.5 / len(places)))


def designed(aim):
    model = TorqueModel(arm(3), FRICTION)
    limits = arm_limits(model.robot)
    return design_trajectory(
        model, PathForm(5.0, 3), aim, limits=limits, starts=2, workers=1, time_limit=60
    )


@pytest.mark.slow
@pytest.mark.parametrize("words", [("*.viscous", "*.coulomb"), ("joint1",)], ids=str)
def test_a_design_for_some_parameters_knows_them_better_than_one_for_all(words):
    aim = Aim(interest=words)
    some, every = designed(aim), designed(Aim())
    assert block_size(some, aim) < 0.97 * block_size(every, aim)
    # What is reported is what was made small.
    assert some.stages[-1].value == pytest.approx(block_size(some, aim), rel=1e-6)
    shown = [row[0] for row in some.accuracy.table().rows]
    led = places_of_interest(some.base, words)
    assert shown == [some.base.names[k] for k in led]


def test_predicted_errors_beside_parameters_are_those_of_interest():
    model = TorqueModel(arm(3))
    aim = Aim(noise=0.1, interest=("link3",))
    base = base_for(model, aim.interest)
    problem = arm_problem(model)
    path = problem.basis.trajectory(problem.random(0))
    found = relative_accuracy(model, predicted_accuracy(model, base, path, aim))
    assert found.matter
    assert all(name.startswith("link3.") for name in found.matter)


def test_what_cannot_be_meant_is_refused():
    model = TorqueModel(arm(3))
    with pytest.raises(ProblemError, match="no parameter, link or joint 'link33'"):
        base_for(model, ["link33"])
    # The first joint is upright: no motion shows the mass of what it turns.
    with pytest.raises(ProblemError, match=r"no motion separates link1\.m from"):
        base_for(model, ["link1.m"])
    with pytest.raises(ProblemError, match="choose D, A or E"):
        Aim("condition", refine=None, interest=["link3"])
    with pytest.raises(ProblemError, match="expected a list of names"):
        Aim(interest="link3")
    with pytest.raises(ProblemError, match="others are known: expected parameters"):
        Aim(others="known")
    with pytest.raises(ProblemError, match="others is 'all', expected one of"):
        Aim(interest=["link3"], others="all")


PROBLEM = """
name = "some"
[model]
modified_dh = [
    { alpha_deg = 0.0, a = 0.0, lower = -3.0, upper = 3.0 },
    { alpha_deg = 90.0, a = 0.0, lower = -1.5, upper = 1.5 },
]
[drive]
viscous = true
[excitation]
duration = 5.0
harmonics = 3
interest = ["link2"]
[excitation.limits]
velocity = 2.0
acceleration = 5.0
"""


@pytest.mark.slow
def test_the_shell_and_the_problem_file_name_parameters_of_interest(tmp_path, capsys):
    file = tmp_path / "problem.toml"
    file.write_text(PROBLEM)
    folder = str(tmp_path / "out")
    call = ["excite", str(file), "--starts", "1", "--workers", "1", "--json"]
    assert main([*call, "--output", folder]) == 0
    assert json.loads(capsys.readouterr().out)["aim"]["interest"] == ["link2"]
    assert main([*call, "--interest", "*.viscous, link1", "--dry-run"]) == 0
    plan = json.loads(capsys.readouterr().out)
    assert ["for", "*.viscous, link1"] in plan["tables"][0]["rows"]
    assert main([*call, "--others", "known", "--dry-run"]) == 0
    assert "others" in capsys.readouterr().out
    assert main(["rehearse", str(file), "--others", "known"]) == 2
    assert "a load on a known robot" in capsys.readouterr().err
    assert main([*call, "--start-pose", "joint1=0.25", "--dry-run"]) == 0
    assert "joint1 = 0.25" in capsys.readouterr().out
    assert main([*call, "--interest", "joint9.viscous", "--dry-run"]) != 0
    assert "no parameter, link or joint 'joint9.viscous'" in capsys.readouterr().err


TREE = """
<robot name="tree"><link name="base"/>{links}{joints}
  <link name="flange"/><link name="tool0"/>
  <joint name="f" type="fixed"><parent link="b"/><child link="flange"/></joint>
  <joint name="t" type="fixed"><parent link="flange"/><child link="tool0"/></joint>
</robot>
"""


def _tree(folder):
    body = """<inertial><mass value="1"/>
        <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>"""
    links = "".join(f'<link name="{name}">{body}</link>' for name in "abc")
    joints = "".join(
        f'<joint name="j{child}" type="revolute"><parent link="{parent}"/>'
        f'<child link="{child}"/><axis xyz="0 0 1"/>'
        '<limit lower="-1" upper="1" velocity="1" effort="9"/></joint>'
        for parent, child in (("base", "a"), ("a", "b"), ("a", "c"))
    )
    file = folder / "tree.urdf"
    file.write_text(TREE.format(links=links, joints=joints))
    return file


def test_a_payload_is_what_the_last_links_carry_and_a_tool_where_it_is_fixed(tmp_path):
    robot = load_urdf(_tree(tmp_path))
    assert interest_names(robot, ["payload"]) == ("b.*", "c.*")
    assert interest_names(robot, ["tool0", "ja.viscous"]) == ("b.*", "ja.viscous")
    # A link of that name goes before.
    named = tmp_path / "named.urdf"
    text = _tree(tmp_path).read_text().replace('"a"', '"tool"')
    named.write_text(text)
    assert interest_names(load_urdf(named), ["tool"]) == ("tool",)


def test_what_an_estimate_left_open_is_designed_for(tmp_path):
    problem = problem_to_excite(_tree(tmp_path), {"interest": ["open", "jb.viscous"]})
    model = problem.model
    bodies = [InertialParameters.from_central(1.0, np.zeros(3), np.eye(3))] * 3
    every = estimate_of(model, bodies, 0.1)
    origins = {"b.m": "prior", "jc.coulomb": "loose", "a.Izz": "combination"}
    named = tuple(origins.get(name, "data") for name in model.layout.names)
    file = replace(every, origins=named).save(tmp_path / "delivered.json")
    found = with_open_parameters(problem, [file])
    interest = ["jb.viscous", "b.m", "jc.coulomb"]
    assert found.table.excitation.interest == interest
    with pytest.raises(ProblemError, match="give --parameters"):
        with_open_parameters(problem, [])
    whole = every.save(tmp_path / "whole.json")
    with pytest.raises(ProblemError, match="nothing is open"):
        with_open_parameters(problem, [whole])

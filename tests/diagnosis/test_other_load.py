"""A load that the model does not have, and what is not mistaken for one."""

from dataclasses import replace

import numpy as np
import pytest
from faulty_logs import arm, clean_log, logs
from some_fast import some_fast

from consistent_id import FixedMasses, PhysicalConsistency
from consistent_id.constraints import FixedBodies, FixedCentresOfMass
from consistent_id.diagnosis import diagnose
from consistent_id.diagnosis.alternatives import without_link
from consistent_id.robot.chains import last_links


def _with_masses(factors):
    """Return a model whose links weigh other than the robot's."""
    model = arm()
    sheet = {
        link.name: replace(link.datasheet, mass=factor * link.datasheet.mass)
        for link, factor in zip(model.robot.links, factors, strict=True)
    }
    return replace(model, robot=model.robot.with_datasheet(sheet))


@pytest.mark.slow
@pytest.mark.parametrize("seed", some_fast(range(3)))
def test_a_load_that_the_model_does_not_have_is_named(seed):
    loaded = _with_masses([1.0, 1.0, 1.0, 5.0])
    log = logs().clean(loaded, np.random.default_rng(seed)).log
    found = diagnose(arm(), log, prepare=logs().prepared).faults
    last = arm().robot.link_names[-1]
    assert [(f.kind, f.where) for f in found] == [("load", last)]


@pytest.mark.slow
def test_too_large_masses_of_all_links_are_no_load():
    model = _with_masses([3.0] * 4)
    found = diagnose(model, clean_log(0), prepare=logs().prepared).suspicious
    assert found
    assert "load" not in {f.kind for f in found}


@pytest.mark.slow
def test_a_last_link_that_is_lighter_carries_no_load():
    lighter = _with_masses([1.0, 1.0, 1.0, 0.1])
    log = logs().clean(lighter, np.random.default_rng(0)).log
    found = diagnose(arm(), log, prepare=logs().prepared).suspicious
    assert "load" not in {f.kind for f in found}


def test_what_is_known_of_the_other_links_stays():
    robot = arm().robot
    *others, last = robot.link_names
    masses = FixedMasses(dict.fromkeys(others, 1.0))
    assert without_link([PhysicalConsistency(), masses], robot, last) is None
    known = [FixedMasses(), FixedCentresOfMass(), FixedBodies(), PhysicalConsistency()]
    free = without_link(known, robot, last)
    assert set(free[0].masses) == set(free[1].centres) == set(others)
    assert set(free[2].links) == set(others)
    assert free[3] is known[3]
    assert without_link([FixedBodies([last])], robot, last) == []


def test_last_links_are_those_that_carry_no_other():
    assert [link.name for link in last_links(arm().robot)] == [
        arm().robot.link_names[-1]
    ]

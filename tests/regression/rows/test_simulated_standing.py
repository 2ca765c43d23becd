"""Robots that MuJoCo simulates on their feet: the benchmark's goals, in a test."""

import os
import sys
from pathlib import Path

import numpy as np
import pytest
from published_robots import FOLDER

import consistent_id as ci

pytestmark = pytest.mark.slow

RECORDINGS = "CONSISTENT_ID_DATASETS"
CASES = [
    pytest.param(
        "quadruped",
        marks=pytest.mark.skipif(
            RECORDINGS not in os.environ,
            reason=f"{RECORDINGS} does not name the folder of recordings",
        ),
    ),
    pytest.param(
        "humanoid",
        marks=pytest.mark.skipif(
            not FOLDER.exists(), reason="example-robot-data is missing"
        ),
    ),
]


@pytest.mark.parametrize("name", CASES)
def test_the_trunk_is_found_without_force_sensors(name, monkeypatch):
    folder = Path(__file__).parents[3] / "benchmarks"
    monkeypatch.setattr(sys, "path", [*sys.path, str(folder)])
    import quadruped
    from standing_simulation import prepared, simulated

    robot = quadruped.ROBOTS[name]()
    raw = simulated(robot, seconds=8, dry_friction=False)
    log = prepared(raw, robot.cutoff)
    drive = ci.DriveTerms(rotor_inertia=True, viscous=True)
    model = ci.regression.contact_free_model(ci.TorqueModel(robot.nominal, drive))
    found = ci.constrained_least_squares(
        model,
        ci.regression.contact_free_regression(model, log),
        constraints=[*quadruped.SIGNS, ci.constraints.FixedParameters(robot.known())],
        base=ci.regression.contact_free_base(model, log.contacts),
    )
    assert found.certificate.verdict == "certified"
    errors = quadruped.trunk_errors(found.links[robot.number], robot)
    # What a box of a quarter of the trunk's mass, unknown to the model, does is found.
    assert abs(errors.mass) < 0.01
    assert errors.apart < 3e-3
    assert np.all(abs(errors.moments) < 0.05)

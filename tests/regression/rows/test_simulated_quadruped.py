"""A quadruped that MuJoCo simulates on its feet: the benchmark's goals, in a test."""

import importlib.util
import os
import sys
from pathlib import Path

import numpy as np
import pytest

import consistent_id as ci

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        "CONSISTENT_ID_DATASETS" not in os.environ,
        reason="CONSISTENT_ID_DATASETS does not name the folder of recordings",
    ),
]


def test_the_trunk_is_found_without_force_sensors():
    path = Path(__file__).parents[3] / "benchmarks" / "quadruped.py"
    spec = importlib.util.spec_from_file_location("quadruped", path)
    quadruped = importlib.util.module_from_spec(spec)
    sys.modules["quadruped"] = quadruped
    spec.loader.exec_module(quadruped)
    file = Path(os.environ["CONSISTENT_ID_DATASETS"]) / "unitree_go2" / "go2.xml"
    truth = quadruped.robots(file)
    log = quadruped.prepared(quadruped.simulated(file, seconds=10, dry_friction=False))
    drive = ci.DriveTerms(rotor_inertia=True, viscous=True)
    model = ci.contact_free_model(ci.TorqueModel(truth.nominal, drive))
    found = ci.constrained_least_squares(
        model,
        ci.contact_free_regression(model, log),
        constraints=[
            ci.PhysicalConsistency(),
            ci.NonNegativeDrive(),
            ci.FixedParameters(quadruped.known_of_legs(truth, file)),
        ],
        base=ci.contact_free_base(model, log.contacts),
    )
    assert found.certificate.verdict == "certified"
    mass, apart, moments = quadruped.trunk_errors(found, truth)
    # What a box of a quarter of the trunk's mass, unknown to the model, does is found.
    assert abs(mass) < 0.01
    assert apart < 3e-3
    assert np.all(abs(moments) < 0.05)

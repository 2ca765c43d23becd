"""Rows with different torques unknown, of one motion."""

from dataclasses import replace

import numpy as np
import pytest
from quadrupeds import quadruped_text, standing

import consistent_id as ci
from consistent_id.regression.rows.contact_free import masked_factors

PATTERNS = np.array([[i != j for j in range(4)] for i in range(4)] * 20)


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    path = tmp_path_factory.mktemp("robot") / "quadruped.xml"
    path.write_text(quadruped_text())
    return ci.robot.load_mjcf(path, base="floating")


@pytest.mark.slow
def test_factors_are_those_of_each_recording_alone(robot):
    rng = np.random.default_rng(0)
    model = ci.regression.contact_free_model(ci.TorqueModel(robot))
    whole = standing(robot, PATTERNS, noise=0.1)
    logs = [
        replace(whole, torque_known=rng.uniform(size=whole.position.shape) < share)
        for share in (0.5, 0.8)
    ]
    combinations = np.zeros((len(model.layout), 4))
    combinations[:12] = rng.normal(size=(12, 4))
    found = masked_factors(model, [*logs, whole], combinations)
    for part, log in zip(found, [*logs, whole], strict=True):
        alone = ci.regression.contact_free_regression(model, log)
        R = alone.stacked()
        R = np.column_stack([R[:, :-1] @ combinations, R[:, -1]])
        squares = part.factor.T @ part.factor
        assert np.allclose(squares, R.T @ R, rtol=0, atol=1e-9 * abs(squares).max())
        assert part.rows == alone.counts[0]

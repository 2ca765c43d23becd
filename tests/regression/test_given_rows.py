"""Regressors that are given: bodies without known connections, a person's wrench."""

import importlib.util
import os
import sys
from pathlib import Path

import numpy as np
import pytest

from consistent_id import (
    InertialParameters,
    ProblemError,
    constrained_least_squares,
    least_squares,
)
from consistent_id.constraints import Ellipsoid, PointToSet
from consistent_id.regression import given_rows
from consistent_id.robot import free_bodies

BODIES = {
    "upper": InertialParameters.from_central(2.0, [0.1, 0, 0], 0.02 * np.eye(3)),
    "lower": InertialParameters.from_central(1.0, [0, 0.2, 0], 0.01 * np.eye(3)),
}


def test_known_bodies_are_recovered_with_errors_of_the_rows_noise():
    rng = np.random.default_rng(0)
    x = np.concatenate([body.vector for body in BODIES.values()])
    Y, sigma = rng.normal(size=(4000, 3, 20)), np.array([0.1, 0.2, 1.0])
    measured = Y @ x + sigma * rng.normal(size=(4000, 3))
    robot = free_bodies("pair", BODIES)
    rows = given_rows(robot, ("nx", "ny", "fz"), Y, measured, sigma=sigma)
    estimate = least_squares(rows.model, rows.regression, base=rows.base)
    # Of white rows the covariance is (sum_t Y^T S^-1 Y)^-1.
    expected = 1.0 / np.sqrt(4000 * np.sum(1.0 / sigma**2))
    assert np.allclose(estimate.standard_errors, expected, rtol=0.1)
    assert abs(estimate.parameters - x).max() < 4.0 * expected
    constrained = constrained_least_squares(rows.model, rows.regression, base=rows.base)
    assert constrained.certificate.verdict == "certified"
    assert [link.mass for link in map(InertialParameters, constrained.links)] == (
        pytest.approx([2.0, 1.0])
    )


def test_a_motion_does_not_tell_the_regressor_of_free_bodies():
    robot = free_bodies("pair", BODIES)
    rows = given_rows(robot, ("fz",), np.ones((4, 1, 20)), np.ones((4, 1)))
    with pytest.raises(ProblemError, match="the connections of its bodies"):
        rows.model.regressor(*np.zeros((3, 2, 0)))


def test_an_ellipsoid_is_its_quadratic():
    rng = np.random.default_rng(1)
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    one = Ellipsoid([0.1, -0.2, 0.3], [0.5, 0.2, 0.1], turn)
    # A quadratic of twice the size has the same inside.
    again = Ellipsoid.from_quadratic(2.0 * one.quadratic)
    assert np.allclose(again.quadratic, one.quadratic, rtol=0, atol=1e-10)
    with pytest.raises(ProblemError, match="opposite sign"):
        Ellipsoid.from_quadratic(-one.quadratic)


@pytest.fixture(scope="module")
def plates():
    if "CONSISTENT_ID_DATASETS" not in os.environ:
        pytest.skip("CONSISTENT_ID_DATASETS does not name the folder of recordings")
    path = Path(__file__).parents[2] / "benchmarks" / "force_plates.py"
    spec = importlib.util.spec_from_file_location("force_plates", path)
    module = importlib.util.module_from_spec(spec)
    sys.modules["force_plates"] = module
    spec.loader.exec_module(module)
    return module, module.person(Path(os.environ["CONSISTENT_ID_DATASETS"]))


def test_published_errors_of_a_person_on_force_plates_are_recomputed(plates):
    _, data = plates
    for kind, error in data.errors.items():
        assert data.error(data.published[kind]) == pytest.approx(error, rel=1e-7)
    estimate = least_squares(data.rows.model, data.rows.regression, base=data.rows.base)
    assert len(data.rows.base) == 160
    # By numpy.linalg.lstsq on the weighted rows.
    A = (data.regressor / data.sigma[:, None]).reshape(-1, 160)
    b = (data.measured / data.sigma).ravel()
    _, (error,), *_ = np.linalg.lstsq(A, b, rcond=None)
    assert data.error(estimate.parameters) == pytest.approx(error, rel=1e-7)
    assert error == pytest.approx(142197, abs=0.5)  # the data set's description


def test_the_least_error_of_a_person_of_bodies_is_proven(plates):
    module, data = plates
    best = module.least_error(data)
    assert best.optimality.verdict == "certified"
    assert best.optimality.gap < 1e-6
    assert data.error(best.parameters) == pytest.approx(494096.3, abs=0.05)


@pytest.mark.slow
def test_a_small_slack_delivers_the_optimum_and_both_misfits_are_printed(plates):
    _, data = plates
    model, regression, base = data.rows
    estimate = constrained_least_squares(
        model,
        regression,
        constraints=data.constraints,
        prior=PointToSet(slack=1e-6, inside=0.0),
        base=base,
    )
    # The slack is that of the norm: twice as much of the square.
    error = data.error(estimate.parameters)
    assert 494096.3 < error < 494096.3 * (1.0 + 2.1e-6)
    assert f"{error:.7g}" in estimate.notes[0]
    assert "least within the constraints 494096.3" in estimate.notes[0]


@pytest.mark.slow
def test_the_entropic_estimate_of_a_person_is_the_published_one(plates):
    module, data = plates
    error = data.errors["entropic"]
    scaled = module.least_error(data).scaled
    found = module.at_error(data, scaled, error, 3.7)
    assert found.optimality.verdict == "certified"
    x = found.solution.u * scaled.unit
    assert data.error(x) == pytest.approx(error, rel=2e-7)
    published = data.published["entropic"]
    # As near as the published solver came: its gradient vanishes to 2e-3.
    assert abs(x[::10] - published[::10]).max() < 2e-3


def test_rows_have_noise_of_one_if_nothing_else_is_said():
    robot = free_bodies("pair", BODIES)
    Y = np.random.default_rng(0).normal(size=(5, 2, 20))
    rows = given_rows(robot, ("nx", "fz"), Y, Y[:, :, 0])
    assert rows.regression.sigma.tolist() == [1.0, 1.0]

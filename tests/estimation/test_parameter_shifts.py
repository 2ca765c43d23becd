"""Assumed values, and the shifts of parameters by their errors."""

from dataclasses import replace

import numpy as np
import pytest

import consistent_id as ci
from consistent_id.estimation.uncertainties.beyond_noise import parameter_shifts
from consistent_id.estimation.uncertainties.parameter_uncertainty import uncertainty
from consistent_id.regression.segments import segment_regressions

SAMPLES, NOISE = 2400, 0.05
TIME = 0.01 * np.arange(SAMPLES)


@pytest.fixture(scope="module")
def arm():
    rows = [ci.DHRow(0.0, 0.0), ci.DHRow(-np.pi / 2, 0.3)]
    return ci.TorqueModel(ci.from_modified_dh("arm", rows))


@pytest.fixture(scope="module")
def log(arm):
    rng = np.random.default_rng(0)
    q, dq, ddq = rng.normal(size=(3, SAMPLES, 2))
    torque = arm.predict(rng.uniform(0.5, 1.0, len(arm.layout)), q, dq, ddq)
    torque += NOISE * rng.normal(size=torque.shape)
    return ci.Recording(("joint1", "joint2"), TIME, q, dq, ddq, torque)


def fixed(arm):
    """All but the base parameters, each of which is then a parameter."""
    base = ci.regression.base_parameters(arm)
    others = set(range(len(arm.layout))) - set(base.independent)
    return [ci.constraints.FixedParameters({arm.layout.names[i]: 0.0 for i in others})]


def louder(log, share):
    return replace(log, torque=(1.0 + share) * log.torque)


def test_parameters_of_a_torque_a_percent_larger_are_a_percent_larger(arm, log):
    whole = ci.build_regression(arm, log)
    variants = [ci.build_regression(arm, louder(log, s)) for s in (0.01, -0.02)]
    base = ci.regression.base_parameters(arm)
    R = whole.stacked()
    x = np.linalg.lstsq(R[:, list(base.independent)], R[:, -1])[0]
    found = parameter_shifts(arm, whole, variants, fixed(arm))
    moved = np.sqrt(found.variance[list(base.independent)])
    assert moved == pytest.approx(abs(x) * np.hypot(0.01, 0.02), rel=1e-6)
    assert found.count == 2
    # One standard error of white noise of level one adds one to the squared misfit.
    A = R[:, list(base.independent)]
    unit = np.sqrt(np.diag(np.linalg.inv(A.T @ A)))
    expected = (moved / unit) ** 2
    added = found.squared_misfit[list(base.independent)]
    assert added == pytest.approx(expected, rel=1e-6)


def test_variants_are_weighted_as_the_whole(arm, log):
    """By hand: least squares whose rows are divided by the noise of their joint."""
    sigma, columns = (
        np.array([1.0, 7.0]),
        list(ci.regression.base_parameters(arm).independent),
    )
    other = replace(log, torque=log.torque + [0.3, 0.0] * np.sign(log.velocity))
    found = parameter_shifts(
        arm,
        ci.build_regression(arm, log).weighted(sigma),
        [ci.build_regression(arm, other)],
        fixed(arm),
    )
    Y = arm.regressor(log.position, log.velocity, log.acceleration)[:, columns]
    rows = np.concatenate(np.moveaxis(Y, 2, 1) / sigma[:, None, None])
    change = ((other.torque - log.torque) / sigma).T.ravel()
    moved = np.linalg.lstsq(rows, change)[0]
    assert found.variance[columns] == pytest.approx(moved**2, rel=1e-6)


@pytest.mark.slow
def test_shifts_are_in_standard_errors_and_in_intervals(arm, log):
    segments, constraints = segment_regressions(arm, log), fixed(arm)
    variant = ci.build_regression(arm, louder(log, 0.05))
    plain, more = (
        uncertainty(arm, segments, constraints=constraints, replicates=2, variants=v)
        for v in ((), (variant,))
    )
    assert "changes of assumed values" in more.scatter
    for one, other in zip(plain.parameters, more.parameters, strict=True):
        if one.verdict != "data":
            continue
        shift = 0.05 * abs(one.value)
        both = np.hypot(one.standard_error, shift)
        assert other.standard_error == pytest.approx(both, rel=1e-2)
        half = (other.consistent[1] - other.consistent[0]) / 2.0
        assert half == pytest.approx(1.96 * both, rel=0.1)


def test_without_variants_nothing_is_added(arm, log):
    assert parameter_shifts(arm, ci.build_regression(arm, log), [], []) is None

"""Instrumental variables: closed forms, recovery in a closed loop, calibrated test."""

from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from experiments import experiment

from consistent_id import (
    DHRow,
    ProblemError,
    Recording,
    RecordingError,
    TorqueModel,
    build_regression,
    differentiated,
    from_modified_dh,
    low_passed,
)
from consistent_id.estimation import (
    endogeneity_test,
    instrumental,
    instrumental_variables,
    weighted_least_squares,
)
from consistent_id.estimation.instrumental import EndogeneityTest, _certificate, _left
from consistent_id.laboratory import Controller, Encoders, controlled, with_friction
from consistent_id.recordings.joint_paths import Sinusoid, SinusoidalMotion
from consistent_id.regression import base_parameters

SLIDER = from_modified_dh("slider", [DHRow(0, 0, kind="prismatic")], gravity=[0, 0, 0])
MASS = TorqueModel(SLIDER)
ARM = from_modified_dh("arm", [DHRow(0, 0, 0.3), DHRow(-np.pi / 2, 0), DHRow(0, 0.4)])
BODY = [4, 0.8, 0.1, 0, 0.1, 0, 0.3, 0, 0, 0.3]
TRUE = with_friction(
    ARM, BODY * 3, viscous=[2, 1, 0.5], coulomb=[3, 3, 1], velocity_scale=0.05
)
BASE = base_parameters(TRUE.model)
NOISE = 0.1  # N m
WANTED = SinusoidalMotion(
    8.0,
    1000.0,
    (
        (Sinusoid(0.6, 0.6, 0.5), Sinusoid(0.2, 0.2, 1.1)),
        (Sinusoid(0.5, 0.5, 0.4), Sinusoid(0.2, 0.2, 0.9)),
        (Sinusoid(0.6, 0.6, 0.7), Sinusoid(0.3, 0.3, 0.3)),
    ),
).recording(ARM.joint_names)
INNER = slice(300, -300)  # without the filters' ends


def _slider(n=20_000, noise=0.5):
    """A mass of 2 kg under white accelerations, some of them misread."""
    rng = np.random.default_rng(0)
    a, time = rng.normal(size=(n, 1)), np.arange(n) / 100.0
    still, force = np.zeros((n, 1)), 2.0 * a + 0.1 * rng.normal(size=(n, 1))
    read = a + noise * rng.normal(size=(n, 1))
    names = SLIDER.joint_names
    log = Recording(names, time, still, still, read, force)
    return log, Recording(names, time, still, still, a)


def test_a_misread_acceleration_bends_least_squares_but_not_instruments():
    log, told = _slider()
    wls = weighted_least_squares(MASS, build_regression(MASS, log))
    iv = instrumental_variables(MASS, log, told)
    a, read, tau = told.acceleration, log.acceleration, log.torque
    # E = 2 / (1 + 0.5^2): attenuation by the noise's share.
    assert wls.base_values[0] == pytest.approx(2.0 / 1.25, abs=0.02)
    assert iv.base_values[0] == pytest.approx((a * tau).sum() / (a * read).sum())
    assert iv.certificate.verdict == "certified"


@pytest.mark.parametrize("unit", [1e-6, 1.0, 1e6])
def test_instruments_differ_whatever_the_unit_of_the_motion(unit):
    log, told = (
        Recording(r.joints, r.time, r.position, r.velocity, unit * r.acceleration)
        for r in _slider(n=200)
    )
    log = replace(log, torque=2.0 * told.acceleration)
    found = instrumental_variables(MASS, log, told)
    a, read = told.acceleration, log.acceleration
    assert found.base_values[0] == pytest.approx(2.0 * (a * a).sum() / (a * read).sum())
    with pytest.raises(ProblemError, match="the instruments are the measured motion"):
        instrumental_variables(MASS, log, log)


def test_the_residual_is_orthogonal_to_instruments_however_large_the_torque():
    """Relative to the torque, which is a million times its noise."""
    model, _, log = experiment(2, joints=2, noise=1e-5, samples=300)
    shifted = replace(log, acceleration=log.acceleration + 0.1)
    proof = instrumental_variables(model, log, shifted).certificate
    assert proof.figures["orthogonality"] < 1e-11
    assert proof.verdict == "certified"


@pytest.mark.parametrize(("left", "certified"), [(5e-10, True), (2e-9, False)])
def test_a_residual_is_orthogonal_to_a_billionth_of_the_torque(left, certified):
    torque = 40.0 * np.array([0.6, 0.8])
    rows = SimpleNamespace(projected=np.eye(2), projected_torque=torque)
    solution = SimpleNamespace(x=np.add(torque, [0.0, 40.0 * left]), rank=2)
    found = _certificate(rows, solution)
    assert (found.verdict == "certified") == certified
    assert found.figures["orthogonality"] == pytest.approx(left, rel=1e-5)


def test_its_standard_error_is_that_of_the_textbook():
    log, told = _slider(noise=0.0)
    changed = Recording(
        told.joints, told.time, told.position, told.velocity, told.acceleration + 0.3
    )
    iv = instrumental_variables(MASS, log, changed)
    a, z = log.acceleration.ravel(), changed.acceleration.ravel()
    residual = log.torque.ravel() - iv.base_values[0] * a
    # var = s^2 z.z / (z.a)^2
    expected = np.sqrt(residual @ residual / (len(a) - 1) * (z @ z)) / abs(z @ a)
    assert iv.sigma[0] == pytest.approx(np.sqrt(residual @ residual / (len(a) - 1)))
    # The noise is white, and its spectrum is estimated.
    assert iv.standard_errors[0] == pytest.approx(expected, rel=0.03)


@cache
def _loop():
    controller = Controller(TRUE.model, 0.9 * TRUE.parameters)
    return controlled(TRUE, controller, Encoders(1e-4), WANTED)


def _log(cutoff, seed=0):
    rng, loop = np.random.default_rng(seed), _loop()
    torque = loop.motion.torque + NOISE * rng.normal(size=loop.torque.shape)
    raw = Recording(ARM.joint_names, WANTED.time, loop.readings, torque=torque)
    return differentiated(low_passed(raw, motion_cutoff=cutoff)).samples(INNER)


def _error(estimate):
    truth = _loop().motion.samples(INNER)
    motion = truth.position, truth.velocity, truth.acceleration
    clean = TRUE.model.predict(TRUE.parameters, *motion)
    return np.linalg.norm(estimate.predict(truth) - clean) / np.linalg.norm(clean)


@pytest.mark.slow
@pytest.mark.parametrize("cutoff", [10.0, 100.0])
def test_in_a_closed_loop_it_does_not_depend_on_the_cutoff(cutoff):
    log = _log(cutoff)
    iv = instrumental_variables(TRUE.model, log, WANTED.samples(INNER), base=BASE)
    assert _error(iv) < 5e-4
    regression = build_regression(TRUE.model, log)
    wls = weighted_least_squares(TRUE.model, regression, base=BASE)
    # An encoder of 1e-4 rad, differentiated twice behind 100 Hz, costs several percent.
    assert (_error(wls) > 0.02) == (cutoff > 50.0)


@pytest.mark.slow
def test_the_test_tells_a_cutoff_that_hurts_from_one_that_does_not():
    told = WANTED.samples(INNER)
    assert endogeneity_test(TRUE.model, _log(100.0), told, base=BASE).p_value < 1e-6
    good = endogeneity_test(TRUE.model, _log(10.0), told, base=BASE)
    assert good.p_value > 0.01
    assert "agree within noise" in str(good)


def test_its_statistic_is_that_of_an_added_regressor():
    log, right = _slider(n=400, noise=0.2)
    found = endogeneity_test(MASS, log, right)
    read, both = log.acceleration, np.hstack([log.acceleration, right.acceleration])
    alone, more = (np.linalg.lstsq(X, log.torque)[1][0] for X in (read, both))
    freedom = found.effective_samples - 2
    assert found.directions == 1
    assert found.statistic == pytest.approx((alone - more) / (more / freedom))


@pytest.mark.slow
def test_its_p_values_are_uniform_where_nothing_is_wrong():
    values = []
    for seed in range(100):
        rng = np.random.default_rng(seed)
        a, n = rng.normal(size=(400, 1)), 400
        still, force = np.zeros((n, 1)), 2.0 * a + rng.normal(size=(n, 1))
        names, time = SLIDER.joint_names, np.arange(n) / 100.0
        log = Recording(names, time, still, still, a, force)
        z = Recording(names, time, still, still, a + rng.normal(size=(n, 1)))
        values.append(endogeneity_test(MASS, log, z).p_value)
    # Kolmogorov's 1 % bound of 100 draws is 0.163; the correlation length, which is 1
    # or more, makes the test a little cautious.
    ordered = np.sort(values)
    assert (ordered - np.arange(1, 101) / 100).min() > -0.163


def test_instruments_that_are_the_motion_itself_are_refused():
    log, _ = _slider(500)
    with pytest.raises(ProblemError, match="are the measured motion itself"):
        instrumental_variables(MASS, log, log)


def test_instruments_that_do_not_fit_are_refused():
    log, told = _slider(500)
    with pytest.raises(RecordingError, match=r"500 samples, its instruments .* 400"):
        instrumental_variables(MASS, log, told.samples(slice(400)))
    with pytest.raises(RecordingError, match="1 recordings, but 2 instruments"):
        instrumental_variables(MASS, log, [told, told])
    for missing in ("velocity", "acceleration"):
        bare = replace(told, **{missing: None})
        with pytest.raises(RecordingError, match="of instruments, has no velocity"):
            instrumental_variables(MASS, log, bare)


def test_one_in_a_hundred_is_still_chance():
    said = [str(EndogeneityTest(4.0, 2, 300.0, p)) for p in (0.0099, 0.01)]
    assert ["differ by more" in text for text in said] == [True, False]


@pytest.mark.parametrize(("left", "verdict"), [(0.9e-9, "cert"), (1.1e-9, "uncert")])
def test_without_torque_what_is_left_counts_as_it_is(left, verdict):
    rows = SimpleNamespace(projected=np.eye(2), projected_torque=np.zeros(2))
    solution = SimpleNamespace(x=np.array([left, 0.0]), rank=2)
    assert _certificate(rows, solution).verdict == f"{verdict}ified"


@pytest.mark.parametrize("unit", [1e-9, 1.0, 1e9])
def test_a_rank_and_what_is_left_do_not_depend_on_the_unit_of_a_column(unit):
    rng = np.random.default_rng(0)
    A, b = rng.normal(size=(30, 3)), rng.normal(size=30)
    A = np.column_stack([A, A[:, 0] - 2.0 * A[:, 1]]) * [1.0, unit, 1.0, 1.0]
    rank, left = _left(A, b)
    expected = np.linalg.lstsq(A[:, :3] / [1.0, unit, 1.0], b)[1][0]
    assert rank == 3 and left == pytest.approx(expected)


@pytest.mark.parametrize(("apart", "rank"), [(1.1, 3), (0.9, 2)])
def test_a_direction_counts_from_a_billionth_of_the_largest_on(apart, rank):
    """Two columns nearly alike have singular values of a root of two, and theirs."""
    A = np.array([[1.0, 1.0, 0.0], [0.0, 2e-9 * apart, 0.0], [0.0, 0.0, 5.0]])
    assert _left(A, np.ones(3)) == (rank, pytest.approx(3.0 - rank))


@pytest.mark.parametrize(("samples", "enough"), [(49, False), (50, True)])
@pytest.mark.parametrize("apart", [True, False])
def test_a_test_needs_a_direction_and_a_degree_of_freedom(
    monkeypatch, samples, enough, apart
):
    """Ten samples count as one: five are one more than columns, if these differ."""
    R = np.random.default_rng(0).normal(size=(30, 5))
    if not apart:
        R[:, :2] = R[:, 2:4]
    rows = SimpleNamespace(stacked=R, samples=samples, correlation=10.0)
    monkeypatch.setattr(instrumental, "instrumented", lambda *given: rows)
    if enough and apart:
        found = endogeneity_test(None, [], None, base=(0, 1))
        left = [np.linalg.lstsq(A, R[:, 4])[1][0] for A in (R[:, 2:4], R[:, :4])]
        assert found.statistic == pytest.approx((left[0] - left[1]) / 2.0 / left[1])
    else:
        with pytest.raises(ProblemError, match="too few for a test"):
            endogeneity_test(None, [], None, base=(0, 1))

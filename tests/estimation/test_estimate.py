"""Methods of an estimate: its uncertainty from recordings alone, and its picture."""

import json
from dataclasses import fields, replace
from functools import cache
from time import perf_counter

import numpy as np
import pytest
from estimates import estimate_of
from experiments import experiment

from consistent_id import (
    Estimate,
    FixedMasses,
    InertialParameters,
    PhysicalConsistency,
    ProblemError,
    build_regression,
    constrained_least_squares,
    huber,
    least_squares,
    low_passed,
    uncertainty,
)
from consistent_id.constraints import Penalty
from consistent_id.estimation import instrumental_variables, weighted_least_squares
from consistent_id.estimation.base_least_squares import unconstrained_estimate
from consistent_id.estimation.estimate_file import ReasonRecord
from consistent_id.estimation.estimate_plot import draw_parameters, parameter_bars
from consistent_id.estimation.uncertainties.resampling import bootstrap
from consistent_id.estimation.verdict import Reason
from consistent_id.regression import base_parameters, joint_noise, segment_regressions
from consistent_id.regression.residual_noise import unconstrained_fit


@cache
def estimated():
    return estimated_with()


def estimated_with(**options):
    model, _, log = experiment(2, joints=2, noise=0.3, samples=900)
    regression = build_regression(model, log)
    return constrained_least_squares(model, regression, **options), log


@pytest.mark.slow
def test_an_estimate_knows_the_conditions_that_its_uncertainty_needs():
    conditions = [PhysicalConsistency(), FixedMasses()]
    estimate, log = estimated_with(constraints=conditions, prior=Penalty(0.1))
    found = estimate.uncertainty(log, replicates=5, seed=3)
    expected = uncertainty(
        estimate.model,
        segment_regressions(estimate.model, log),
        constraints=conditions,
        prior=Penalty(0.1),
        replicates=5,
        seed=3,
    )
    assert found.to_dict() == expected.to_dict()
    values = [parameter.value for parameter in found.parameters]
    np.testing.assert_allclose(values, estimate.parameters, rtol=1e-7, atol=1e-9)


def test_an_estimate_without_a_search_took_no_time_and_has_no_notes():
    estimate, _ = estimated()
    links = [InertialParameters(body) for body in estimate.links]
    stated = estimate_of(estimate.model, links, drive=0.1)
    assert (stated.seconds, stated.notes) == (0.0, ())
    assert estimate.seconds > 0.0


@pytest.mark.slow
def test_a_weighted_estimate_keeps_its_weights_in_its_uncertainty():
    model, _, log = experiment(1, joints=2, noise=(0.1, 1.0), samples=900)
    regression = build_regression(model, log)
    weighted = regression.weighted(joint_noise(model, regression))
    estimate = constrained_least_squares(model, weighted)
    values = [p.value for p in estimate.uncertainty(log, replicates=2).parameters]
    np.testing.assert_allclose(values, estimate.parameters, rtol=1e-7, atol=1e-9)
    plain = constrained_least_squares(model, regression)
    assert abs(plain.parameters - estimate.parameters).max() > 1e-4


def test_recordings_that_an_estimate_was_not_fitted_to_are_refused():
    estimate, log = estimated()
    with pytest.raises(ProblemError, match="not fitted to"):
        estimate.uncertainty(log.samples(slice(0, 600)))


@pytest.mark.slow
def test_only_constrained_estimates_have_this_uncertainty(tmp_path):
    estimate, log = estimated()
    regression = build_regression(estimate.model, log)
    loaded = Estimate.load(
        estimate.save(tmp_path / "e.json"), estimate.model, estimate.base
    )
    for other in (
        least_squares(estimate.model, regression),
        huber(estimate.model, log),
        loaded,
    ):
        with pytest.raises(ProblemError, match=r"consistent_id\.uncertainty"):
            other.uncertainty(log)


@pytest.mark.parametrize("part", ["parameters", "sigma"])
def test_a_file_of_other_parameters_or_of_other_joints_is_refused(tmp_path, part):
    estimate, _ = estimated()
    file = estimate.save(tmp_path / "e.json")
    record = json.loads(file.read_text())
    name, value = record[part].popitem()
    record[part][f"other {name}"] = value
    file.write_text(json.dumps(record))
    with pytest.raises(ProblemError, match=r"not those of robot .* terms$"):
        Estimate.load(file, estimate.model, estimate.base)
    (tmp_path / "problem.toml").touch()
    with pytest.raises(ProblemError, match=r"give the problem beside it, .*\.toml$"):
        Estimate.load(file, estimate.model, estimate.base)


@pytest.fixture
def pyplot():
    plt = pytest.importorskip("matplotlib.pyplot")
    plt.switch_backend("Agg")
    yield plt
    plt.close("all")


@pytest.mark.slow
def test_a_plot_shows_measured_and_predicted_torque_of_each_joint(pyplot):
    estimate, log = estimated()
    axes = estimate.plot(log)
    predicted = estimate.predict(log)
    assert [axis.get_ylabel() for axis in axes] == ["j0 [N m]", "j1 [N]"]
    assert estimate.model.robot.driven[1].kind == "prismatic"
    for j, axis in enumerate(axes):
        measured, line = axis.get_lines()
        np.testing.assert_array_equal(measured.get_ydata(), log.torque[:, j])
        np.testing.assert_array_equal(line.get_ydata(), predicted[:, j])
        error = estimate.score(log).relative[j]
        assert axis.get_title(loc="right") == f"error {error:.1%}"
    assert axes[-1].get_xlabel() == "time [s]"
    assert len(pyplot.get_fignums()) == 1


@pytest.mark.slow
def test_a_second_estimate_is_drawn_into_the_axes_of_the_first(pyplot):
    estimate, log = estimated()
    plain = least_squares(estimate.model, build_regression(estimate.model, log))
    axes = plain.plot(log)
    again = estimate.plot(log, axes=axes)
    assert list(again) == list(axes)
    labels = [line.get_label() for line in axes[0].get_lines()]
    assert labels == ["measured", "least squares", "constrained"]
    assert axes[0].get_title(loc="right").count("%") == 2
    assert len(pyplot.get_fignums()) == 1


@pytest.mark.slow
def test_one_joint_is_drawn_into_one_axes_and_without_measured_torque(pyplot):
    estimate, log = estimated()
    _, axis = pyplot.subplots()
    name = estimate.model.torque_joints[1]
    (same,) = estimate.plot(replace(log, torque=None), joints=[name], axes=axis)
    (line,) = same.get_lines()
    assert same is axis
    assert line.get_label() == "constrained"
    np.testing.assert_array_equal(line.get_ydata(), estimate.predict(log)[:, 1])


@pytest.mark.slow
def test_torque_that_is_not_known_is_not_drawn(pyplot):
    estimate, log = estimated()
    known = np.ones(log.torque.shape, dtype=bool)
    known[100:200, 0] = False
    first, second = estimate.plot(replace(log, torque_known=known))
    drawn = first.get_lines()[0].get_ydata()
    assert np.isnan(drawn[100:200]).all()
    assert np.isfinite(drawn[200:]).all()
    assert np.isfinite(second.get_lines()[0].get_ydata()).all()


def test_filtered_torque_is_drawn_at_every_sample(pyplot):
    estimate, log = estimated()
    smooth = low_passed(log, torque_cutoff=2.0)
    axes = estimate.plot(smooth)
    for j, axis in enumerate(axes):
        measured, line = axis.get_lines()
        np.testing.assert_allclose(measured.get_ydata(), smooth.torque[:, j])
        np.testing.assert_array_equal(line.get_ydata(), estimate.predict(smooth)[:, j])


def test_filtered_torque_that_is_not_known_is_not_drawn(pyplot):
    estimate, log = estimated()
    known = np.ones(log.position.shape, dtype=bool)
    known[100:200, 0] = False
    smooth = low_passed(replace(log, torque_known=known), torque_cutoff=2.0)
    for axis, own in zip(estimate.plot(smooth), known.T, strict=True):
        drawn = axis.get_lines()[0].get_ydata()
        np.testing.assert_array_equal(np.isfinite(drawn), own)


def test_wrong_joints_and_axes_are_said(pyplot):
    estimate, log = estimated()
    with pytest.raises(ProblemError, match="no torque of 'elbow'; known: j0, j1"):
        estimate.plot(log, joints=["elbow"])
    _, axis = pyplot.subplots()
    with pytest.raises(ProblemError, match="1 axes for the torque of 2 joints"):
        estimate.plot(log, axes=axis)


def parameters_drawn(estimate, names=None, axes=None):
    bars = parameter_bars(
        estimate.model.layout, estimate.parameters, estimate.half_intervals, names
    )
    return draw_parameters(bars, estimate.method, axes)


@pytest.mark.slow
def test_parameters_are_drawn_with_bars_of_95_percent_by_unit(pyplot):
    estimate, _ = estimated()
    layout, errors = estimate.model.layout, estimate.parameter_errors
    quantiles = estimate.parameter_quantiles
    assert np.isfinite(errors).any() and np.isnan(errors).any()
    assert (quantiles > 1.96).all()
    axes = parameters_drawn(estimate)
    units = list(dict.fromkeys(layout.units))
    assert [axis.get_xlabel() for axis in axes] == [f"[{unit}]" for unit in units]
    seen = {}
    for axis in axes:
        labels = [text.get_text() for text in axis.get_yticklabels()]
        (dots,) = axis.containers
        (bars,) = dots.lines[2]
        points = dots.lines[0].get_xydata()
        for (x, y), ends in zip(points, bars.get_segments(), strict=True):
            seen[labels[round(y)]] = (x, (ends[1, 0] - ends[0, 0]) / 2)
        (hollow,) = [
            line
            for line in axis.get_lines()
            if line.get_marker() == "o" and line.get_markerfacecolor() == "none"
        ]
        for x, y in hollow.get_xydata():
            seen[labels[round(y)]] = (x, np.nan)
    assert set(seen) == set(layout.names)
    for i, name in enumerate(layout.names):
        expected = (estimate.parameters[i], quantiles[i] * errors[i])
        assert seen[name] == pytest.approx(expected, rel=1e-3, nan_ok=True)


def test_some_parameters_of_a_second_estimate_stand_beside_the_first(pyplot):
    estimate, _ = estimated()
    other = replace(estimate, method="other")
    _, axis = pyplot.subplots()
    names = estimate.model.layout.names
    body = names[0].rpartition(".")[0]
    known = names[int(np.nanargmin(estimate.parameter_errors))]
    for one in (estimate, other):
        (same,) = parameters_drawn(one, names=[known], axes=axis)
        assert same is axis
    first, second = axis.containers
    assert first.lines[0].get_xdata() == second.lines[0].get_xdata()
    assert first.lines[0].get_ydata() != second.lines[0].get_ydata()
    assert [first.get_label(), second.get_label()] == ["constrained", "other"]
    assert len(pyplot.get_fignums()) == 1  # the one that was given
    with pytest.raises(ProblemError, match="1 axes for parameters of 3 units"):
        parameters_drawn(estimate, names=[body], axes=axis)
    with pytest.raises(ProblemError, match="no parameter 'arm'"):
        parameters_drawn(estimate, names=["arm"])


def test_a_file_holds_all_of_a_reason():
    assert ReasonRecord.__struct_fields__ == tuple(f.name for f in fields(Reason))


@pytest.mark.slow
def test_an_estimate_took_no_longer_than_it_took():
    model, _, log = experiment(2, joints=2, noise=0.3, samples=300)
    regression = build_regression(model, log)
    shifted = replace(log, acceleration=log.acceleration + 0.1)
    fit = unconstrained_fit(regression, base_parameters(model))
    for estimator in (
        lambda: least_squares(model, regression),
        lambda: weighted_least_squares(model, regression),
        lambda: unconstrained_estimate(model, fit, data=fit, method="by hand"),
        lambda: huber(model, log),
        lambda: constrained_least_squares(model, regression),
        lambda: instrumental_variables(model, log, shifted),
        lambda: bootstrap(model, segment_regressions(model, log), replicates=2),
    ):
        started = perf_counter()
        seconds = estimator().seconds
        assert 0.0 < seconds <= perf_counter() - started


def test_a_value_that_is_known_has_no_say_in_how_wide_intervals_are():
    """Of a fixed parameter, the error is zero; of one that is open, it is infinite."""
    model, _, _ = experiment(2, joints=1, samples=10)
    made = estimate_of(model, [model.robot.links[0].nominal], drive=0.5)
    few = np.full(len(model.layout), 12.7)
    errors = np.array([0.1, np.inf, *np.zeros(len(few) - 2)])
    quantiles = np.array([1.96, *few[1:]])
    sure = replace(made, parameter_errors=errors, parameter_quantiles=quantiles)
    assert not any("standard errors either way" in note for note in sure.error_notes)
    wide = replace(sure, parameter_quantiles=few)
    assert any("is 12.7 standard errors" in note for note in wide.error_notes)


def test_a_fixed_base_has_no_loose_trunk():
    model, _, _ = experiment(2, joints=1, samples=10)
    made = estimate_of(model, [model.robot.links[0].nominal], drive=0.5)
    assert replace(made, origins=("prior",) * len(model.layout)).loose_trunk == ()


@pytest.mark.parametrize("missing", ["velocity", "acceleration"])
def test_an_error_needs_velocity_and_acceleration(missing):
    model, _, log = experiment(2, joints=1, samples=10)
    made = estimate_of(model, [model.robot.links[0].nominal], drive=0.5)
    with pytest.raises(ProblemError, match="need velocity and acceleration"):
        made.score(replace(log, **{missing: None}))

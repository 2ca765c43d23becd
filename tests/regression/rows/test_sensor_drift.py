"""A wrist sensor whose bias drifts: a body is found beside it, and the drift again."""

from dataclasses import replace

import numpy as np
import pytest
from test_wrench_sensor import TOOL, log_of

from consistent_id import (
    DHRow,
    NotExcitedError,
    ProblemError,
    from_modified_dh,
    least_squares,
)
from consistent_id.regression import tool_model
from consistent_id.regression.correlated_noise import spectral_noise, white_noise
from consistent_id.regression.model_errors import JointFit
from consistent_id.regression.rows.wrench_sensor import (
    _noise,
    bias_along,
    carried,
    driftless_regression,
    driftless_segments,
)

RIGHT = np.pi / 2
START = np.array([3.0, -2.0, 5.0, 0.1, -0.2, 0.05])
RATE = np.array([1.0, 0.0, -2.0, 0.0, 0.3, 0.0])
MODEL = tool_model(bias=False)


@pytest.fixture(scope="module")
def arm():
    rows = [DHRow(0, 0), DHRow(RIGHT, 0), DHRow(0, 0.5), DHRow(0, 0.4)]
    rows += [DHRow(RIGHT, 0, d=0.1), DHRow(-RIGHT, 0, d=0.1)]
    return from_modified_dh("arm", rows)


def drifting(arm, samples, rate, *, noise=0.0, later=0.0):
    """A body's recording whose bias is that of `log_of`, and drifts from there."""
    log = log_of(arm, samples, noise=noise)
    (wrench,) = log.wrenches
    moved = replace(wrench, values=wrench.values + np.outer(log.time, rate))
    log = replace(log, time=log.time + later, wrenches=(moved,))
    return carried(MODEL.robot, arm, log, "link6")


@pytest.mark.parametrize(
    ("drift", "rate"), [("recordings", 0.0 * RATE), ("linear", RATE)]
)
def test_a_body_and_each_recordings_own_drift_are_recovered(arm, drift, rate):
    logs = [drifting(arm, 60, rate), drifting(arm, 40, -3.0 * rate, later=100.0)]
    regression = driftless_regression(MODEL, logs, drift)
    found = least_squares(MODEL, regression)
    np.testing.assert_allclose(found.parameters, TOOL.vector, rtol=0, atol=1e-10)
    for log, factor in zip(logs, (1.0, -3.0), strict=True):
        bias = bias_along(MODEL, found.parameters, log, drift)
        np.testing.assert_allclose(bias.start, START, atol=1e-9)
        np.testing.assert_allclose(bias.rate, factor * rate, atol=1e-9)
    lost = {"recordings": 1, "linear": 2}[drift]
    assert regression.counts == (100 - 2 * lost,) * 6
    # Of what a bias leaves of the wrench:
    t = logs[0].time
    N = np.column_stack([np.ones(60), t])[:, :lost]
    values = logs[0].wrenches[0].values
    left = values - N @ np.linalg.lstsq(N, values, rcond=None)[0]
    assert (regression.peaks >= abs(left).max(axis=0) - 1e-9).all()


def test_a_constant_bias_does_not_explain_one_that_drifts(arm):
    found = least_squares(
        MODEL, driftless_regression(MODEL, [drifting(arm, 60, RATE)], "recordings")
    )
    assert abs(found.parameters - TOOL.vector).max() > 1e-3


@pytest.mark.parametrize("drift", ["recordings", "linear"])
def test_segments_add_up_to_the_whole(arm, drift):
    logs = [drifting(arm, 90, RATE, noise=0.1), drifting(arm, 60, RATE, noise=0.1)]
    whole = driftless_regression(MODEL, logs, drift)
    parts = driftless_segments(MODEL, logs, drift, count=5)
    assert len(parts) == 5
    assert sum(part.counts[0] for part in parts) == whole.counts[0]
    for row in range(6):
        squares = sum(part.factors[row].T @ part.factors[row] for part in parts)
        expected = whole.factors[row].T @ whole.factors[row]
        np.testing.assert_allclose(squares, expected, atol=1e-9 * abs(expected).max())
    peaks = np.max([part.peaks for part in parts], axis=0)
    np.testing.assert_allclose(peaks, whole.peaks)
    # The noise of a part is the whole's, as far as its samples go.
    effective = np.sum([part.noise.effective for part in parts], axis=0)
    np.testing.assert_allclose(effective, whole.noise.effective)
    shares = [part.counts[0] / whole.counts[0] for part in parts]
    np.testing.assert_allclose(
        parts[0].noise.effective, shares[0] * whole.noise.effective
    )


def test_a_recording_needs_more_samples_than_its_bias_takes(arm):
    log = drifting(arm, 9, RATE)
    with pytest.raises(NotExcitedError, match="has 2 samples, and its bias takes 2"):
        driftless_regression(MODEL, [log.samples(slice(0, 2))], "linear")
    driftless_regression(MODEL, [log.samples(slice(0, 3))], "linear")
    driftless_regression(MODEL, [log.samples(slice(0, 2))], "recordings")
    for build in (driftless_regression, driftless_segments):
        with pytest.raises(ProblemError, match="the model has one for all"):
            build(tool_model(), [log], "linear")


def test_noise_of_rows_without_drift_is_that_of_each_row_by_itself():
    """Two rows of other units; the third is exact, and then its noise is white."""
    rng = np.random.default_rng(1)
    rows = rng.normal(size=(3, 200, 4)) * np.array([0.1, 5.0, 1.0])[:, None, None]
    x = np.array([1.0, -2.0, 0.5])
    rows[2, :, 3] = rows[2, :, :3] @ x
    weights = np.array([0.2, 4.0, 1e-6])
    fit = JointFit(x, weights, weights, 0.1 * rng.normal(size=(3, 2)))
    found = _noise(rows, fit)
    for j, (row, weight) in enumerate(zip(rows, weights, strict=True)):
        Y, residual = row[:, :3], row[:, 3] - row[:, :3] @ x
        alone = (
            white_noise(Y, residual)
            if j == 2
            else spectral_noise(Y, residual, fit.steps / weight)
        )
        np.testing.assert_array_equal(found.scores[j], alone.scores)
        assert found.effective[j] == 200 / alone.length
        assert found.freedom[j] == alone.freedom

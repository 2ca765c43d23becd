"""A held-out error filters prediction and measured torque alike, and names its band."""

from dataclasses import replace

import numpy as np
import pytest
from experiments import experiment

from consistent_id.comparison.comparison import compare, verdict_table
from consistent_id.estimation.base_least_squares import least_squares
from consistent_id.estimation.torque_error import prediction_errors
from consistent_id.recordings.signals.filtered_rows import RowFilter
from consistent_id.regression.regression import build_regression
from consistent_id.signals import low_passed


def test_measured_and_predicted_torque_pass_one_filter():
    model, truth, log = experiment(0, joints=2, samples=800)
    noise = 0.1 * np.random.default_rng(0).normal(size=log.torque.shape)
    raw = replace(log, torque=log.torque + noise)
    cutoff = 0.1 * raw.rate
    ((error),) = prediction_errors(
        model, [(truth, None)], low_passed(raw, torque_cutoff=cutoff)
    )
    by = RowFilter(0.1)
    rows = np.arange(0, len(raw), by.step)
    left, torque = by(noise, rows), by(raw.torque, rows)
    sizes = np.sqrt(np.mean(torque**2, axis=0))
    assert error.band == pytest.approx(cutoff)
    np.testing.assert_allclose(error.torque, sizes, rtol=1e-9)
    np.testing.assert_allclose(error.rms, np.sqrt(np.mean(left**2, axis=0)), rtol=1e-6)


def test_the_table_of_verdicts_names_the_band():
    model, _, log = experiment(0, joints=2, samples=800, noise=0.1)
    estimate = least_squares(model, build_regression(model, log))
    smooth = low_passed(log, torque_cutoff=0.1 * log.rate)
    notes = verdict_table(compare([estimate], [log, smooth])).notes
    assert notes[0].endswith(log.name)
    assert notes[1].endswith(f"{log.name}, torque below {0.1 * log.rate:g} Hz")

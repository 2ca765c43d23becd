"""Errors of a floating base's parameters that are not alike in all of a motion."""

from types import SimpleNamespace

import numpy as np
import pytest

import consistent_id as ci
from consistent_id.estimation.uncertainties.beyond_noise import FloatingBlocks
from consistent_id.estimation.uncertainties.block_scatter import BLOCKS
from consistent_id.estimation.uncertainties.parameter_uncertainty import uncertainty
from consistent_id.regression.segments import segment_regressions

TOOL = ci.InertialParameters.from_central(1.3, [0.02, 0, 0.08], 4e-3 * np.eye(3))
SAMPLES, NOISE, BIAS = 2400, 0.05, 5.0


def sure(shifts):
    """What is known of a tool whose sensor's force along x drifts from block to block.

    Block ``k`` reads ``BIAS + shifts[k]`` too much; all else is white noise.
    """
    rng = np.random.default_rng(0)
    w, dw, a = rng.uniform(-2.0, 2.0, (3, SAMPLES, 3))
    base = ci.recordings.BaseMotion(w, 4.0 * dw, a + np.array([0, 0, 9.81]))
    model, still = ci.regression.tool_model("gripper"), np.zeros((SAMPLES, 0))
    truth = np.append(TOOL.vector, np.zeros(6))
    wrench = model.predict(truth, still, still, still, base=base)
    wrench += NOISE * rng.normal(size=wrench.shape)
    wrench[:, 0] += BIAS + np.repeat(shifts, SAMPLES // BLOCKS)
    log = ci.Recording(
        ("arm",),
        0.01 * np.arange(SAMPLES),
        np.zeros((SAMPLES, 1)),
        base=base,
        wrenches=(ci.recordings.Wrench("gripper", wrench),),
    )
    segments = segment_regressions(model, log)
    return uncertainty(model, segments, constraints=(), replicates=2)


@pytest.mark.slow
def test_a_drift_from_block_to_block_is_in_the_standard_error():
    """The mean of six shifts scatters as these do, over the root of six."""
    shifts = np.array([0.7, -0.4, 0.9, -1.1, 0.2, -0.3])
    found = sure(shifts)
    bias = found["base.fx.bias"]
    assert bias.standard_error == pytest.approx(
        shifts.std(ddof=1) / np.sqrt(BLOCKS), rel=0.3
    )
    assert abs(bias.value - BIAS - shifts.mean()) < bias.standard_error
    assert found.quantile == pytest.approx(2.571, abs=1e-3)  # t, five degrees
    # Without constraints the interval of consistent robots is that of least squares.
    low, high = bias.consistent
    half = found.quantile * bias.standard_error
    assert low == pytest.approx(bias.value - half, abs=0.1 * half)
    assert high == pytest.approx(bias.value + half, abs=0.1 * half)


@pytest.mark.slow
def test_without_drift_blocks_add_next_to_nothing():
    bias = sure(np.zeros(BLOCKS))["base.fx.bias"]
    assert bias.standard_error == pytest.approx(NOISE / np.sqrt(SAMPLES), rel=0.5)


@pytest.mark.parametrize(("count", "quantile"), [(1, 1.96), (2, 12.71), (10, 2.262)])
def test_intervals_of_few_blocks_have_students_quantile(count, quantile):
    blocks = FloatingBlocks(SimpleNamespace(blocks=count), np.ones(3), np.ones(3))
    assert blocks.quantile == pytest.approx(quantile, rel=1e-3)
    assert f"{quantile:.2f} standard errors" in blocks.sentence
    assert blocks.variance.tolist() == [1.0 / count] * 3

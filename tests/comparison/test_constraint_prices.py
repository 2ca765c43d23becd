"""Shadow prices and costs of constraints on friction, beside plain least squares."""

import numpy as np
import pytest
from experiments import pendulum

from consistent_id import build_regression, simulate_torque
from consistent_id.comparison.constraint_prices import (
    STEP,
    constraint_costs,
    shadow_prices,
)
from consistent_id.constraints import FixedParameters, ParameterBounds

SEEN = ("link1.hx", "link1.hy", "link1.Izz")
NAME = "joint1.viscous"


def noisy_pendulum():
    """A regression; its viscous friction by least squares, and residuals beside it."""
    model, truth, log = pendulum()
    rng = np.random.default_rng(1)
    log = simulate_torque(model, truth, log, noise=0.2, rng=rng)
    regression = build_regression(model, log).weighted([0.5])
    R = regression.stacked()
    A, column = R[:, [model.layout.index(name) for name in SEEN]], R[:, -2]
    torque = R[:, -1]
    free = np.linalg.lstsq(np.column_stack([A, column]), torque)[0][-1]

    def rms(friction):
        left = torque - column * friction
        left = left - A @ np.linalg.lstsq(A, left)[0]
        return np.linalg.norm(left) / np.sqrt(sum(regression.counts))

    unit = np.linalg.norm(torque) / np.linalg.norm(column)
    return model, regression, free, rms, unit


@pytest.mark.parametrize("kind", ["lower", "upper", "equal"])
@pytest.mark.parametrize("off", [-0.3, 0.3])
def test_a_price_is_the_slope_of_the_residual_and_the_cost_its_rise(kind, off):
    model, regression, free, rms, unit = noisy_pendulum()
    stated = free + off
    constraint = {
        "lower": ParameterBounds({NAME: (stated, np.inf)}),
        "upper": ParameterBounds({NAME: (-np.inf, stated)}),
        "equal": FixedParameters({NAME: stated}),
    }[kind]
    found = shadow_prices(model, regression, [constraint])
    (summary,) = constraint_costs(model, regression, [constraint])
    if kind != "equal" and (kind == "upper") == (off > 0.0):
        assert found == ()
        assert summary.increase == pytest.approx(0.0, abs=1e-6)
        return
    h = 1e-4
    slope = STEP * unit * (rms(stated + h) - rms(stated - h)) / (2.0 * h)
    slope = slope if kind == "equal" else abs(slope)  # tighter is worse
    (price,) = found
    assert price.price == pytest.approx(slope, rel=1e-4)
    assert price.cost == pytest.approx(rms(stated) - rms(free), rel=1e-4)
    assert price.verdict == summary.verdict == "certified"
    # A regression's `sigma` divides the residuals that a price is of.
    assert summary.rms_with == pytest.approx(0.5 * rms(stated), rel=1e-6)
    assert summary.rms_without == pytest.approx(0.5 * rms(free), rel=1e-6)
    assert summary.increase == pytest.approx(rms(stated) / rms(free) - 1.0, rel=1e-5)
    assert (summary.constraint, summary.name) == (constraint, type(constraint).__name__)


def test_the_most_costly_comes_first_and_what_is_said_twice_costs_nothing():
    model, regression, free, *_ = noisy_pendulum()
    twice = [FixedParameters({NAME: free + 0.3}) for _ in range(2)]
    for cost in constraint_costs(model, regression, twice):
        assert cost.increase == pytest.approx(0.0, abs=1e-6)
    both = [ParameterBounds({NAME: (free + 0.1, np.inf)})]
    both.append(FixedParameters({"link1.hx": 0.0}))
    prices = shadow_prices(model, regression, both)
    costs = [price.cost for price in prices]
    assert len(costs) == 2 and costs[0] > costs[1] > 0.0
    assert "hx" in prices[0].label

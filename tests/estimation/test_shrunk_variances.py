"""Scatter between groups, against the formulas in print."""

import numpy as np
import pytest
from scipy.special import digamma, polygamma

from consistent_id.estimation.uncertainties.block_scatter import (
    RecordingScatter,
    _independent,
    excess,
    shrunk,
)


def test_groups_of_equal_noise_scatter_by_the_variance_over_that():
    x = np.array([[1.0], [2.0], [6.0]])
    found = excess(x, np.full((3, 1), 1.0 / 4.0))
    # The sample variance is 7; one parameter is not shrunk, and has its own freedom.
    assert found.ratio == pytest.approx([7.0 / 4.0])
    assert found.unit == pytest.approx([4.0])
    assert found.freedom == 2.0


def test_the_scatter_of_unequal_groups_is_that_of_dersimonian_and_laird():
    x, w = np.array([[1.0], [2.0], [6.0]]), np.array([[1.0], [4.0], [0.5]])
    mean = (w * x).sum() / w.sum()
    Q = (w * (x - mean) ** 2).sum()
    tau2 = (Q - 2.0) / (w.sum() - (w**2).sum() / w.sum())
    found = excess(x, w)
    assert (found.ratio[0] - 1.0) * found.unit[0] == pytest.approx(tau2)


def directions(angle, groups):
    """Two parameters' differences from their mean, with the cosine of an angle."""
    first = np.zeros(groups)
    second = np.zeros(groups)
    first[:2] = [1.0, -1.0]
    second[:3] = np.array([1.0, 1.0, -2.0]) / np.sqrt(3.0)
    turned = np.cos(angle) * first + np.sin(angle) * second
    return np.column_stack([first, turned])


@pytest.mark.parametrize(
    ("angle", "groups", "independent"),
    [
        (0.0, 3, 1.0),  # the same twice
        (np.pi / 2, 3, 2.0),
        # Squared correlation 3/4, of which chance makes 1/2: (2 * 3/4 - 1) / 1 = 1/2
        (np.pi / 6, 3, 2.0 / 1.5),
        # and of four groups 1/3: (3 * 3/4 - 1) / 2 = 5/8
        (np.pi / 6, 4, 2.0 / 1.625),
        (np.pi / 3, 3, 2.0),  # less than by chance
    ],
)
def test_parameters_that_change_together_have_fewer_degrees_of_freedom(
    angle, groups, independent
):
    x = directions(angle, groups)
    found = excess(x, np.ones(x.shape))
    assert found.freedom == pytest.approx(min(groups - 1.0, (groups - 1) * independent))
    # Of three alike ones, any number of groups would do, but they change together.
    three = np.column_stack([x, x[:, 0]])
    if angle == 0.0:
        assert excess(three, np.ones(three.shape)).freedom == pytest.approx(groups - 1)


def test_of_two_groups_half_of_the_squared_correlation_is_assumed():
    x = np.array([[1.0, 2.0, 3.0], [-1.0, -2.0, -3.0]])
    found = excess(x, np.array([[1.0, 0.25, 1.0 / 9.0]] * 2))
    assert found.ratio == pytest.approx([2.0, 2.0, 2.0])
    assert found.freedom == pytest.approx(3.0 / (1.0 + 2.0 * 0.5))
    still = np.array([[1.0, 2.0, 0.0], [-1.0, -2.0, 0.0]])
    assert excess(still, np.ones((2, 3))).ratio[2] > 0.0


def test_alike_variances_become_their_mean():
    found = shrunk(np.array([1.0, 1.1, 0.9]), 5.0)
    assert found.values == pytest.approx([1.0] * 3)
    assert np.isinf(found.freedom)


def test_one_or_two_variances_are_left_as_they_are():
    for variances in ([3.0], [3.0, 0.1]):
        found = shrunk(np.array(variances), 5.0)
        assert found.values.tolist() == variances
        assert found.freedom == 5.0


@pytest.mark.parametrize("freedom", [4.0, 23.0])
@pytest.mark.parametrize("spread", [1.5, 4.0, 30.0, 1e4])
def test_unlike_variances_are_shrunk_as_smyth_states(freedom, spread):
    variances = np.array([1.0 / spread, 0.5, 1.0, 2.0, spread])
    z = np.log(variances)
    left = z.var(ddof=1) - polygamma(1, freedom / 2.0)
    found = shrunk(variances, freedom)
    if left <= polygamma(1, 500.0):  # a thousand degrees of freedom
        assert np.isinf(found.freedom)
        return
    d0 = found.freedom - freedom
    assert polygamma(1, d0 / 2.0) == pytest.approx(left, rel=1e-6)
    e = z - digamma(freedom / 2.0) + np.log(freedom / 2.0)
    s0 = np.exp(e.mean() + digamma(d0 / 2.0) - np.log(d0 / 2.0))
    expected = (d0 * s0 + freedom * variances) / (d0 + freedom)
    np.testing.assert_allclose(found.values, expected, rtol=1e-6)


@pytest.mark.parametrize("freedom", [500.0, 2000.0])
def test_variances_that_differ_by_a_thousandth_or_so_are_alike(freedom):
    """The common one would have a thousand degrees of freedom, and more."""
    left = polygamma(1, 10.0 / 2.0) + polygamma(1, freedom / 2.0)
    z = np.array([-1.0, 0.0, 1.0]) * np.sqrt(left)
    found = shrunk(np.exp(z), 10.0)
    if freedom > 1000.0:
        assert np.isinf(found.freedom) and np.ptp(found.values) == 0.0
    else:
        assert found.freedom == pytest.approx(freedom + 10.0, rel=1e-6)


@pytest.mark.parametrize(("count", "few"), [(5, True), (6, False)])
def test_few_recordings_are_said_to_be_few(count, few):
    scatter = RecordingScatter(count, np.ones(1), ("friction",), {"friction": 4.4})
    assert scatter.sentence.startswith("it has degrees of freedom: 4 for friction")
    assert ("record at least 6" in scatter.sentence) is few


def test_two_parameters_that_change_together_are_one():
    off = np.array([[1.0], [-2.0], [0.5], [0.5]]) * [1.0, 3e-3]
    assert _independent(off) == pytest.approx(1.0)
    assert _independent(off[:, :1]) == 1.0

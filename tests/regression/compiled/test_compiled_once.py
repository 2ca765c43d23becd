"""Code that is compiled once for each machine gives LAPACK's and NumPy's numbers."""

import numpy as np
import pytest
from compiled_code import Counted, needs_compiler, without
from some_fast import some_fast

from consistent_id.regression.compiled import sines, triangle
from consistent_id.regression.triangles import _by_lapack, extended


@needs_compiler
@pytest.mark.parametrize("width", some_fast([5, 2, 1, 47, 4], 3))
@pytest.mark.parametrize("height", some_fast([triangle.LEAST + 77, triangle.LEAST]))
def test_a_compiled_triangle_is_that_of_lapack(width, height, monkeypatch):
    rng = np.random.default_rng(width)
    R, rows = np.triu(rng.normal(size=(width, width))), rng.normal(size=(height, width))
    gram = R.T @ R + rows.T @ rows

    def call():
        return extended(np.array(R, order="F"), np.array(rows, order="F"))

    truth = without(monkeypatch, call)
    monkeypatch.setattr(triangle, "compiled", counted := Counted(triangle.compiled))
    found = call()
    assert counted.calls == 1
    assert triangle.eliminator(height, _by_lapack) is not None  # it is used
    assert not np.tril(found, -1).any()
    np.testing.assert_allclose(found.T @ found, gram, rtol=0, atol=1e-12 * height)
    np.testing.assert_allclose(found, truth, rtol=0, atol=1e-13 * abs(truth).max())


@needs_compiler
def test_a_compiled_triangle_takes_columns_of_zeros_and_equal_ones(monkeypatch):
    rng = np.random.default_rng(0)
    rows = rng.normal(size=(triangle.LEAST, 6))
    rows[:, 2], rows[:, 4] = 0.0, rows[:, 1]
    found = extended(np.zeros((0, 6)), np.array(rows, order="F"))
    np.testing.assert_allclose(found.T @ found, rows.T @ rows, rtol=0, atol=1e-9)
    assert not found[:, 2].any()


@needs_compiler
def test_a_triangle_has_the_same_bits_whatever_was_computed_before():
    rows = np.random.default_rng(0).normal(size=(triangle.LEAST, 9))
    first = extended(np.zeros((0, 9)), np.array(rows, order="F"))
    for _ in range(2):  # loaded in a new process, and there
        triangle._found.cache_clear()
        again = extended(np.zeros((0, 9)), np.array(rows, order="F"))
        np.testing.assert_array_equal(again, first)


def test_a_triangle_of_few_rows_does_not_wait_for_a_compiler(cache):
    extended(np.eye(3, order="F"), np.ones((triangle.LEAST - 1, 3), order="F"))
    assert not cache.exists()


@needs_compiler
def test_a_compiled_triangle_that_is_wrong_is_not_used(monkeypatch):
    wrong = triangle._SOURCE.replace("*r++ -= x", "*r++ += x")
    assert wrong != triangle._SOURCE
    monkeypatch.setattr(triangle, "_SOURCE", wrong)
    rows = np.random.default_rng(0).normal(size=(triangle.LEAST, 5))
    found = extended(np.zeros((0, 5)), np.array(rows, order="F"))
    np.testing.assert_allclose(found.T @ found, rows.T @ rows, rtol=0, atol=1e-9)


def angles():
    """Return angles of all sizes, quarter turns, and what lies next to these."""
    rng = np.random.default_rng(0)
    sizes = np.geomspace(1e-9, 1e6, 20_000)
    turns = np.pi / 2 * rng.integers(-600_000, 600_000, 20_000)
    beside = np.nextafter(turns, np.inf)
    return np.concatenate([sizes * rng.uniform(-1.0, 1.0, 20_000), turns, beside])


@needs_compiler
@pytest.mark.skipif(
    np.finfo(np.longdouble).nmant < 63, reason="longer numbers are missing here"
)
def test_compiled_sines_and_cosines_are_exact_to_the_last_digits():
    x = angles()
    found = sines.sine_and_cosine(x)
    assert sines._found() is not None
    exact = x.astype(np.longdouble)
    for one, truth in zip(found, (np.sin(exact), np.cos(exact)), strict=True):
        assert abs(one - truth).max() <= 1.2e-16  # a half and a bit of the last digit


@needs_compiler
@pytest.mark.parametrize("beyond", [1.1e6, -1e9, np.inf, np.nan])
def test_sines_of_an_angle_that_is_too_large_are_numpys(beyond):
    x = angles()[-5000:]
    x[7] = beyond
    with np.errstate(invalid="ignore"):
        found, truth = sines.sine_and_cosine(x), (np.sin(x), np.cos(x))
    np.testing.assert_array_equal(found, truth)


@needs_compiler
def test_sines_of_angles_that_do_not_lie_side_by_side():
    x = angles()
    for one, truth in zip(sines.sine_and_cosine(x[::3]), (np.sin, np.cos), strict=True):
        np.testing.assert_allclose(one, truth(x[::3]), rtol=0, atol=3e-16)


def test_sines_of_few_angles_do_not_wait_for_a_compiler(cache):
    x = angles()[: sines.LEAST - 1]
    np.testing.assert_array_equal(sines.sine_and_cosine(x), (np.sin(x), np.cos(x)))
    assert not cache.exists()


@needs_compiler
def test_compiled_sines_that_are_wrong_are_not_used(monkeypatch):
    wrong = sines._SOURCE.replace("0x1.a01a019cb1590p-16", "0x1.a01a019cb1590p-15")
    assert wrong != sines._SOURCE
    monkeypatch.setattr(sines, "_SOURCE", wrong)
    x = angles()
    np.testing.assert_array_equal(sines.sine_and_cosine(x), (np.sin(x), np.cos(x)))
    assert sines._found() is None

"""Values show themselves in a few lines, and as tables in notebooks."""

from dataclasses import dataclass, is_dataclass
from importlib import import_module
from inspect import isclass
from pkgutil import iter_modules

import pytest

import consistent_id
from consistent_id import least_squares, load_problem
from consistent_id._support.tables import brief
from consistent_id.problems.study import Study

MOST_LINES = 30
ROOMS = [consistent_id] + [
    import_module(f"consistent_id.{entry.name}")
    for entry in iter_modules(consistent_id.__path__)
    if not entry.name.startswith("_")
]
NAMES = {getattr(room, name) for room in ROOMS for name in getattr(room, "__all__", ())}
VALUES = {
    value
    for value in filter(isclass, NAMES)
    if is_dataclass(value) and not issubclass(value, Exception)
}


def test_every_public_value_has_a_table_in_notebooks():
    assert len(VALUES) > 100
    assert not [value for value in VALUES if not hasattr(value, "_repr_html_")]


def parts(value, depth):
    """Return a value, and what its attributes hold, to a depth."""
    found = [value]
    for name in dir(type(value)) if depth else ():
        if name.startswith("_") or callable(getattr(type(value), name)):
            continue
        try:
            part = getattr(value, name)
        except consistent_id.ConsistentIdError:
            continue  # a problem without recordings has none to show
        if isinstance(part, tuple) and part:
            part = part[0]
        if type(part).__module__.startswith("consistent_id"):
            found += parts(part, depth - 1)
    return found


@pytest.fixture(scope="module")
def shown():
    """Values of a study with their parts."""
    study = Study(load_problem("problems/rx60"))
    recording = study.training[0]
    estimate = least_squares(study.problem.model, study.regression)
    values = (
        *(study.problem, recording, study.regression),
        *(study.base, study.free, estimate),
    )
    return [part for value in values for part in parts(value, 2)]


@pytest.mark.slow
def test_values_show_themselves_in_thirty_lines(shown):
    assert len(shown) > 50
    for value in shown:
        assert len(repr(value).splitlines()) <= MOST_LINES, type(value)
        assert len(repr(value)) < 15_000, type(value)
        assert not hasattr(value, "_repr_html_") or "<t" in value._repr_html_()


def test_a_table_that_needs_an_argument_is_not_the_one_of_notebooks():
    @brief
    @dataclass(frozen=True)
    class Draft:
        name: str

        def table(self, folder):
            raise AssertionError

    assert "<td>name</td>" in Draft("arm")._repr_html_()


@pytest.mark.slow
def test_a_table_of_fields_names_shapes_and_lengths(shown):
    (regression, *_) = [v for v in shown if type(v).__name__ == "Regression"]
    table = regression._repr_html_()
    assert "<td>factors</td>" in table
    assert repr(regression).startswith("Regression(layout=")
    assert "factors=<3 of ndarray>" in repr(regression)

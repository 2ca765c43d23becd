"""Values show themselves in a few lines, and as tables in notebooks."""

import contextlib
import doctest
import inspect
import io
import runpy
import sys
from dataclasses import dataclass, fields
from importlib import import_module
from inspect import isclass
from pathlib import Path
from pkgutil import iter_modules

import numpy as np
import pytest
from shown import MOST_LINES, SHOWN_IN, assert_shown, is_shown, reached

import consistent_id
import consistent_id as ci
from consistent_id import least_squares, load_problem
from consistent_id._support.tables import brief
from consistent_id.problems.study import Study

ROOT = Path(__file__).parents[1]
SLOW = runpy.run_path(str(ROOT / "conftest.py"))["_SLOW"]
ROOMS = [consistent_id] + [
    import_module(f"consistent_id.{entry.name}")
    for entry in iter_modules(consistent_id.__path__)
    if not entry.name.startswith("_")
]
PARTS = [
    import_module(f"consistent_id.laboratory.{part}")
    for part in ("rehearsal", "reproduction")
]
NAMES = {
    getattr(owner, name)
    for owner in (*ROOMS, *PARTS)
    for name in getattr(owner, "__all__", ())
}
VALUES = {
    value
    for value in filter(isclass, NAMES)
    if is_shown(value) and not issubclass(value, Exception)
}


def test_every_public_value_has_a_table_in_notebooks():
    assert len(VALUES) > 160
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


def examples():
    """Yield what the examples in docstrings of public names make."""
    parser = doctest.DocTestParser()
    for name in sorted(NAMES, key=lambda one: getattr(one, "__qualname__", "")):
        own = [name]
        if isclass(name):
            own += [inspect.unwrap(getattr(m, "__func__", m)) for m in members(name)]
        for documented in own:
            text = inspect.getdoc(documented) or ""
            if ">>>" not in text or any(call in text for call in SLOW):
                continue
            home = vars(sys.modules[name.__module__])
            names = {**home, "np": np}
            yield from made(parser.get_doctest(text, names, "", None, 0), set(names))


def members(kind):
    return [m for k, m in vars(kind).items() if not k.startswith("_") and callable(m)]


def made(test, known):
    """Run an example; yield what it names, and what it shows."""
    out: list[object] = []
    hook, sys.displayhook = sys.displayhook, out.append
    try:
        for example in test.examples:
            expected = contextlib.suppress(Exception if example.exc_msg else ())
            with contextlib.redirect_stdout(io.StringIO()), expected:
                exec(compile(example.source, "example", "single"), test.globs)
    finally:
        sys.displayhook = hook
    yield from out
    yield from (value for name, value in test.globs.items() if name not in known)


def by_hand():
    """Yield values of types that are stated in a line, and that no example shows."""
    constraints, estimation = ci.constraints, ci.estimation
    many = tuple(f"joint{k}" for k in range(100))
    large = np.ones((len(many), len(many)))
    yield constraints.CentreOfMassBoxes({"rod": ((0, 0, 0), (1, 1, 1))})
    yield constraints.DensityOn("rod", constraints.Ellipsoid(np.zeros(3), np.ones(3)))
    yield constraints.EqualLinks("left", "right", "y")
    yield constraints.FixedBodies(("rod",))
    yield constraints.LinearRelation({f"link{k}.m": 1.0 for k in range(100)}, 0.0, 9.0)
    yield constraints.MassBounds({f"link{k}": (0.0, 1.0) for k in range(200)})
    yield constraints.ParameterBounds({f"j{k}.viscous": (0, 20) for k in range(200)})
    yield constraints.SharedMotors()
    yield constraints.SymmetricLink("rod", ("x", "y"))
    yield ci.motion.Capsule(0.1, 1.0)
    yield ci.motion.Hull(np.random.default_rng(0).normal(size=(300, 3)))
    yield ci.laboratory.Orientation(np.eye(3))
    yield ci.regression.SensorBias(np.zeros(6), np.ones(6))
    yield ci.regression.JointSamples(large, large, large)
    yield ci.comparison.ShadowPrice("rod's mass", 0.1, 0.2, "certified")
    all_of = np.ones(2 * len(many) + 1)
    yield estimation.CalibrationFit(many, ("scale",), all_of, all_of, all_of[None])
    yield estimation.CommandDelay(0.0064, 2e-4, large[0].cumsum(), large[0])
    yield estimation.EndogeneityTest(1.0, 3, 200.0, 0.5)
    yield estimation.JointSprings(many, large[0], large[0], 0.8)
    rod = ci.InertialParameters.from_central(1.0, (0, 0, 0), np.eye(3))
    yield ci.service.LoadQuantities("tcp", rod, np.zeros(10), np.ones(10))
    feet, late = estimation.ContactRadius(1e-3, 1e-4), estimation.TorqueDelay(0.1, 0.01)
    yield estimation.RadiusAndDelay(feet, late, np.eye(2))


NOT_REACHED = {
    "Advice": "the report's text, of a whole study",
    "CarriedBody": "of fleets with robots that carry something",
    "Contradiction": "of a log that contradicts the stated constraints",
    "ControllerFormat": "text of files, by a function",
    "Draft": "of a robot's file and a log: tests/problems",
    "DryRun": "of rehearsals in MuJoCo, of minutes",
    "Evidence": "what a verdict is made of, within a study",
    "Extent": "how much of a paper's study is done",
    "FoundPayload": "of fleets with robots that carry something",
    "GivenRows": "of a regressor from elsewhere",
    "ModelSelection": "of a search over models, of seconds",
    "Outliers": "of factors of many robots, within a fleet",
    "PaperStudy": "of the whole study of a paper, of minutes",
    "ParameterTable": "of the whole study of a paper, of minutes",
    "PlantedRobot": "of rehearsals in MuJoCo, of minutes",
    "Rehearsal": "of rehearsals in MuJoCo, of minutes",
    "ReplayModel": "holds MuJoCo's compiled model, by name",
    "Results": "a folder of results, opened again",
    "ShapeFit": "of a search over shapes of friction, of seconds",
    "ShapeParameter": "of own drive terms",
}
"""Public types of which no value is made here, and why."""


@pytest.mark.slow
def test_values_of_all_public_types_show_themselves_in_thirty_lines(shown):
    values = reached(*shown, *examples(), *by_hand())
    here = assert_shown(values, VALUES)
    elsewhere = set().union(*SHOWN_IN.values())
    public = {value.__name__ for value in VALUES}
    assert public - here - elsewhere == NOT_REACHED.keys()
    assert elsewhere <= public


def test_each_place_that_shows_values_looks_at_them():
    for place in SHOWN_IN:
        file = ROOT / place
        if file.suffix == ".py":
            assert f'assert_reached("{place}"' in file.read_text(), place
        else:
            assert "```python" in file.read_text(), place


OF_FIELDS = [k for k in VALUES if k.__repr__.__qualname__.startswith("brief.")]


@pytest.mark.slow
@pytest.mark.parametrize("shape", [(400, 300), (45, 1), (2, 20, 1)])
def test_values_with_large_fields_show_themselves_in_thirty_lines(shape):
    """Whatever makes them: fields are large arrays, without the types' validation."""
    large = np.ones(shape)
    for kind in OF_FIELDS:
        if hasattr(kind, "_fields"):
            value = tuple.__new__(kind, [large] * len(kind._fields))
        else:
            value = object.__new__(kind)
            for field in fields(kind):
                object.__setattr__(value, field.name, large)
        assert len(repr(value).splitlines()) <= MOST_LINES, kind


def test_types_with_a_text_of_their_own_are_reached():
    own = {kind.__name__ for kind in VALUES} - {kind.__name__ for kind in OF_FIELDS}
    assert not own & NOT_REACHED.keys()


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

"""The JSON record of a reproduced study, of numbers whose statistics are known."""

import json
from types import SimpleNamespace

import numpy as np
import pytest
from rx60 import PROBLEM

from consistent_id.estimation.method import Method
from consistent_id.laboratory.reproduction.budget import (
    ErrorBudget,
    PrintedSpread,
    Tempo,
)
from consistent_id.laboratory.reproduction.error_analysis import (
    ErrorAnalysis,
    Predictor,
    VariedAssumptions,
    Verification,
)
from consistent_id.laboratory.reproduction.experiments import (
    IdentifiedExperiment,
    Reproduction,
)
from consistent_id.laboratory.reproduction.paper_report import reproduction_record
from consistent_id.laboratory.reproduction.paper_study import (
    QUICK,
    TASKS,
    PaperStudy,
    ScatterPlaces,
)

NAMES = ("a", "b")


def experiment(name, vector, verdict):
    """One with a single method, ten seconds long, that leaves the second name open."""
    excitation = SimpleNamespace(
        rank=1,
        condition=2.0,
        undetermined=("b",),
        weakest="a",
        open_directions=np.array([[0.0], [1.0]]),
    )
    log = SimpleNamespace(wanted=SimpleNamespace(time=np.array([5.0, 15.0])))
    estimate = SimpleNamespace(
        method=Method.CONSTRAINED, certificate=SimpleNamespace(verdict=verdict)
    )
    vectors = np.array([vector])
    return IdentifiedExperiment(name, log, log, excitation, (estimate,), vectors)


def study(verdict="certified", most=0.5):
    experiments = (
        experiment("circle", [1.0, 3.0], "certified"),
        experiment("helix", [3.0, 7.0], verdict),
    )
    done = Reproduction(NAMES, np.array([1.0, 1.0]), experiments)
    # Of two causes and two joints; joint 2 has no part.
    parts = np.zeros((2, 2, 2, 2))
    parts[:, 0, 0], parts[:, 1, 0] = [[1.0, 0.0], [3.0, 0.0]], [[0.0, 2.0], [0.0, 2.0]]
    budget = ErrorBudget(
        NAMES, ("circle", "helix"), ("viscous", "offset"), ("j1", "j2"), parts,
        np.array([[3.0, 1.0], [4.0, 1.0]]),
    )  # fmt: skip
    row = np.ones((1, 2))
    tempo = Tempo(
        NAMES, np.array([1.0, 2.0]), np.ones(2), row * [[0.1], [0.4]], 0 * row
    )
    analysis = ErrorAnalysis(
        budget, budget, VariedAssumptions(NAMES, row, row, row, row, 3), tempo, {}
    )
    measured = Verification(
        ("j1", "j2"),
        (SimpleNamespace(name="verification"),),
        (Predictor(TASKS, "truth", None, np.zeros(2)),),
        np.array([[[0.25, 0.5]]]),
    )
    return PaperStudy(
        problem=PROBLEM,
        extent=QUICK,
        report=SimpleNamespace(
            mean=np.array([2.0, 5.0]), standard_deviation=np.array([most, 0.0])
        ),
        inertial=np.zeros(10),
        with_friction={TASKS: done},
        without_friction={},
        other_noise=np.zeros((0, 1, 2)),
        sets=(),
        error_analysis=analysis,
        spread=PrintedSpread(row, row[0], 2.0 * row),
        inertia=(),
        verification=measured,
        verification_without_friction=measured,
        place=ScatterPlaces(0, 1),
    )


def written(study):
    return json.loads(json.dumps(reproduction_record(study), allow_nan=False))


def test_a_record_has_the_statistics_of_two_experiments():
    record = written(study())
    assert record["format"] == "consistent_id reproduction 1"
    assert (record["problem"], record["parameters"]) == ("rx60", ["a", "b"])
    assert (record["scatters_most"], record["scatters_least"]) == ("a", "b")
    done = record["with_friction"][TASKS]
    assert [one["duration_s"] for one in done["experiments"]] == [10.0, 10.0]
    (found,) = done["methods"].values()
    root = np.sqrt(2.0)
    assert found["mean"] == [2.0, 5.0]
    assert found["standard_deviation"] == pytest.approx([root, 2.0 * root])
    # Errors 0 and 2 from the truth; what no torque shows is no error.
    assert found["scatter"] == pytest.approx([root, 0.0])
    assert found["rms_error"] == pytest.approx([root, 0.0])
    causes = record["causes"]
    assert causes["scatter"]["viscous"] == pytest.approx([root, 0.0])
    assert causes["scatter"]["offset"] == [0.0, 0.0]
    assert causes["noise"] == pytest.approx([np.sqrt(12.5), 1.0])
    assert record["printed"]["mean_squared_errors_n2m2"] == [[2.0, 2.0]]
    (row,) = record["verification"]["with_friction"]["rows"]
    assert row == {
        "moved_along": TASKS,
        "method": "truth",
        "mean_squared": [[0.25, 0.5]],
    }


def test_the_slowness_needed_is_that_at_which_friction_scatters_as_printed():
    # From .1 to .4 while the time doubles: .2 is half way of the logarithms.
    needed = written(study(most=0.2))["assumptions"]["slowness_needed"]
    assert needed == pytest.approx(np.sqrt(2.0))
    assert written(study(most=0.5))["assumptions"]["slowness_needed"] is None


@pytest.mark.parametrize("verdict", ["certified", "not certified"])
def test_a_study_is_certified_if_each_constrained_estimate_is(verdict):
    assert written(study(verdict))["certified"] == (verdict == "certified")

"""Things that do not belong together, and words that mean nothing, are refused."""

import json
from dataclasses import replace

import numpy as np
import pytest
from experiments import experiment

from consistent_id import (
    DHRow,
    DriveTerms,
    Estimate,
    FixedMasses,
    MassBounds,
    NonNegativeDrive,
    NotExcitedError,
    PhysicalConsistency,
    ProblemError,
    TorqueModel,
    build_regression,
    compare,
    constrained_least_squares,
    from_modified_dh,
    huber,
    least_squares,
)
from consistent_id.comparison import base_feasibility
from consistent_id.constraints import (
    CentreOfMassBoxes,
    EqualLinks,
    FixedParameters,
    SymmetricLink,
    TotalMass,
)
from consistent_id.estimation import weighted_least_squares
from consistent_id.regression import base_parameters

MODEL, TRUTH, LOG = experiment(0, joints=2, samples=200, noise=1.0)
REGRESSION = build_regression(MODEL, LOG)
A, B = MODEL.layout.links


def _twin():
    """A model with the same names, other physics."""
    joints = list(MODEL.robot.joints)
    joints[1] = replace(joints[1], translation=joints[1].translation + 0.1)
    return TorqueModel(replace(MODEL.robot, joints=tuple(joints)), MODEL.drive)


@pytest.mark.parametrize(
    "estimate", [least_squares, weighted_least_squares, constrained_least_squares]
)
def test_a_regression_of_another_geometry_is_refused(estimate):
    assert _twin().layout == MODEL.layout
    with pytest.raises(ProblemError, match="another torque model"):
        estimate(_twin(), REGRESSION)
    with pytest.raises(ProblemError, match="another torque model"):
        estimate(MODEL, REGRESSION, base=base_parameters(_twin()))


def test_regressions_estimates_and_base_parameters_of_twins_do_not_mix():
    other = build_regression(_twin(), LOG)
    with pytest.raises(ProblemError, match="cannot be added"):
        _ = REGRESSION + other
    mine, theirs = least_squares(MODEL, REGRESSION), least_squares(_twin(), other)
    with pytest.raises(ProblemError, match="different parameters"):
        compare([mine, theirs], [LOG])
    with pytest.raises(ProblemError, match="another torque model"):
        base_feasibility(MODEL, base_parameters(_twin()), mine.base_values)


def test_the_same_model_built_twice_is_the_same():
    def arm(scale):
        robot = from_modified_dh("arm", [DHRow(0, 0), DHRow(-np.pi / 2, 0.3)])
        return TorqueModel(robot, DriveTerms(coulomb="tanh", velocity_scale=scale))

    assert arm(0.1).fingerprint == arm(0.1).fingerprint
    assert arm(0.1).fingerprint != arm(0.2).fingerprint


@pytest.mark.parametrize(
    "estimate",
    [
        lambda log: least_squares(MODEL, build_regression(MODEL, log)),
        lambda log: weighted_least_squares(MODEL, build_regression(MODEL, log)),
        lambda log: constrained_least_squares(MODEL, build_regression(MODEL, log)),
        lambda log: huber(MODEL, log),
    ],
)
def test_a_dead_torque_channel_is_named(estimate):
    dead = replace(LOG, torque=LOG.torque * [1.0, 0.0])
    with pytest.raises(NotExcitedError, match="zero throughout for j1"):
        estimate(dead)


def test_without_redundancy_no_standard_error_is_made_up():
    few = build_regression(MODEL, LOG.samples(slice(0, 4)))
    estimate = least_squares(MODEL, few)
    assert estimate.standard_errors is None
    assert any("unknown" in note for note in estimate.notes)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: NonNegativeDrive(("viscuous",)).lower(MODEL), "viscuous"),
        (lambda: SymmetricLink(A, ("Y",)).lower(MODEL), "planes"),
        (lambda: EqualLinks(A, B, "q").lower(MODEL), "mirror"),
        (lambda: TotalMass(3, 3, (A, A)).lower(MODEL), "distinct"),
        (lambda: TotalMass(3, 3, ()).lower(MODEL), "distinct"),
        (lambda: MassBounds({A: (5, 1)}).lower(MODEL), "not below"),
        (lambda: FixedMasses({A: np.nan}).lower(MODEL), "finite"),
        (lambda: FixedParameters({f"{A}.Izz": np.nan}).lower(MODEL), "finite"),
        (lambda: CentreOfMassBoxes().lower(MODEL), "com_box"),
    ],
)
def test_constraints_that_say_nothing_or_nonsense_are_refused(make, message):
    with pytest.raises(ProblemError, match=message):
        make()


def test_an_infinite_mass_bound_is_none():
    rows = MassBounds({A: (1.0, np.inf)}).lower(MODEL)
    assert rows.in_labels == (f"{A}: mass >= 1 kg",)
    estimate = constrained_least_squares(
        MODEL,
        REGRESSION,
        constraints=[PhysicalConsistency(), MassBounds({A: (1.0, np.inf)})],
    )
    assert estimate.certificate.verdict == "certified"


@pytest.mark.parametrize("values", [np.zeros(1), np.full(3, np.nan), np.ones(2)])
def test_base_values_of_the_wrong_kind_are_refused(values):
    base = base_parameters(MODEL)
    with pytest.raises(ProblemError, match="base values"):
        base_feasibility(MODEL, base, values)


@pytest.mark.parametrize(
    "change",
    [{"format": "other 2"}, {"certificate": {"verdict": "CERTIFIED!", "reason": ""}}],
)
def test_a_saved_estimate_is_not_trusted_blindly(tmp_path, change):
    estimate = least_squares(MODEL, REGRESSION)
    path = estimate.save(tmp_path / "e.json")
    loaded = Estimate.load(path, MODEL, estimate.base)
    assert np.array_equal(loaded.parameters, estimate.parameters)
    record = json.loads(path.read_text())
    record["sigma"] = dict(reversed(record["sigma"].items()))
    path.write_text(json.dumps(record))
    reordered = Estimate.load(path, MODEL, estimate.base)
    assert np.array_equal(reordered.sigma, estimate.sigma)
    path.write_text(json.dumps(record | change))
    with pytest.raises(ProblemError, match=r"e\.json: not an estimate"):
        Estimate.load(path, MODEL, estimate.base)

"""Both stages of a constrained fit: shares, slacks and what is said of their proofs."""

from types import SimpleNamespace

import numpy as np
import pytest

from consistent_id import PhysicalConsistency
from consistent_id.constraints import Penalty, PointToSet
from consistent_id.constraints.cones.certificate import GAP_TOLERANCE
from consistent_id.estimation import best_fit as best_fits
from consistent_id.estimation import constrained_fit as stages
from consistent_id.estimation import fit
from consistent_id.estimation.constrained_fit import BestInside, ConstrainedFit


def proof(**changed):
    values = {"gap": 1e-9, "violation": 2e-9, "radius": 30.0, "objective": 0.2}
    return SimpleNamespace(**values | {"verdict": "certified"} | changed)


def fitted(final=None, distance_gap=0.004, slack_gap=0.0, **first):
    final = {"gap": 3e-9, "violation": 1e-9, "radius": 24.0} | (final or {})
    return ConstrainedFit(
        best=SimpleNamespace(optimality=proof(**first)),
        distance=SimpleNamespace(nominal=np.array([3.0, 4.0])),
        final=SimpleNamespace(optimality=proof(**final), weight=0.3),
        slack=0.02,
        distance_gap=distance_gap,
        slack_gap=slack_gap,
        note="",
    )


@pytest.mark.parametrize(
    ("fit", "certified"),
    [
        (fitted(distance_gap=0.01, slack_gap=0.01, verdict="uncertified"), True),
        (fitted(distance_gap=0.0101), False),
        (fitted(slack_gap=0.0101), False),
        (fitted({"verdict": "uncertified"}), False),
    ],
)
def test_an_estimate_is_certified_with_its_distance_and_slack(fit, certified):
    assert fit.proof.certified == fit.certified == certified
    assert fit.proof.statement.startswith("best fit proven") == certified


@pytest.mark.parametrize(("first", "final"), [(30.0, 24.0), (24.0, 30.0)])
def test_what_is_proven_is_said(first, final):
    """The nominal robot has the length five, and proofs a reach of 24: four robots."""
    said = fitted({"radius": final}, radius=first).proof.statement
    assert "parameters up to 4 times the nominal ones" in said
    assert "fit proven to a relative 1.0e-09, final estimate to 3.0e-09" in said
    assert "violated by at most 2.0e-09" in said
    assert "squared distance to nominal to 4.0e-03" in said
    assert "a compromise" in fitted(distance_gap=0.0).proof.statement


@pytest.mark.parametrize(
    ("misfit", "one_error", "share"),
    [(3.0, 0.5, 0.5 / 9.0), (1.5, 0.5, 0.5 / 4.0), (3.0, 0.0, 10.0 * GAP_TOLERANCE)],
)
def test_a_slack_is_one_error_of_the_misfit_or_of_what_counts_as_one(
    misfit, one_error, share
):
    best = SimpleNamespace(misfit=misfit, scaled=SimpleNamespace(size=2.0))
    slack = BestInside(best, one_error, ()).slack(PointToSet())
    assert slack == pytest.approx(np.sqrt(1.0 + share) - 1.0)


@pytest.mark.parametrize(("objective", "least"), [(0.2, 0.5), (3.0, 3.0)])
@pytest.mark.parametrize("verdict", ["certified", "uncertified"])
def test_of_a_slack_as_much_is_unsure_as_of_the_best_fit(objective, least, verdict):
    best = SimpleNamespace(
        optimality=proof(gap=1e-4, objective=objective, verdict=verdict),
        misfit=2.0,
        misfit_of=lambda u: 2.5,
    )
    fit = SimpleNamespace(solution=SimpleNamespace(u=None))
    near = SimpleNamespace(fit=fit, slack=0.25, allowed=0.04, distance_gap=0.003)
    found = stages._nearest(best, None, PointToSet(), near, ("by hand",))
    sure = verdict == "certified"
    assert found.slack_gap == (0.0 if sure else pytest.approx(2e-4 * least / 0.04))
    assert (found.slack, found.distance_gap, found.final) == (0.25, 0.003, fit)
    assert "residuals 6.25, least within the constraints 4:" in found.note
    assert found.note.endswith("one standard error at most; by hand")


@pytest.mark.parametrize(
    ("excess", "least", "residual", "given"),
    [(6.0, 1.0, 3.0, np.sqrt(1.5)), (3.0, 0.0, 0.5, np.sqrt(3.25)), (1.0, 2.0, 3.0, 1)],
)
def test_a_compromise_gives_what_its_misfit_is_above_the_least(
    monkeypatch, excess, least, residual, given
):
    fit = SimpleNamespace(excess=excess)
    monkeypatch.setattr(stages, "penalised_fit", lambda scaled, distance, weight: fit)
    scaled = SimpleNamespace(excess=lambda u: least, residual=residual)
    best = SimpleNamespace(scaled=scaled, solution=SimpleNamespace(u=None))
    found = stages._compromise(best, None, Penalty(0.5), ())
    assert found.slack == pytest.approx(given - 1.0)
    assert (found.distance_gap, found.slack_gap, found.final) == (0.0, 0.0, fit)


@pytest.mark.parametrize(
    ("torque", "said"), [(99.0, 0), (101.0, 1), (1 / 99.0, 0), (1 / 101.0, 1)]
)
def test_torque_a_hundred_times_the_nominal_is_of_another_unit(
    monkeypatch, torque, said
):
    monkeypatch.setattr(stages, "reference_bodies", lambda robot: np.full((1, 10), 0.2))
    R = np.array([[*[0.3] * 10, 9.0, 0.6 * torque], [*[0.0] * 11, 0.0]])
    free = SimpleNamespace(regression=SimpleNamespace(stacked=lambda: R))
    problem = SimpleNamespace(free=free, model=SimpleNamespace(robot=None))
    assert bool(stages._of_torque_size(problem)) == said


A, STEPS = np.array([[1.0, 2.0], [0.0, 3.0]]), np.array([[0.5, 0.0], [0.1, 0.2]])
P = np.array([[2.0, 0.0], [1.0, 1.0]])


@pytest.mark.parametrize(
    ("move", "allowed", "share", "wanted"),
    [
        (
            2.5,
            1.0,
            0.009,
            0.1,
        ),  # nine tenths of a quarter, over the move of the whole share
        (0.25, 1.0, 0.1, 0.1),
        (2.5, 0.05, 0.01, 0.1),
        (1e9, 1.0, 0.0, 0.1),  # a smaller share would count as none
        (1e-9, 1.1e-3, 0.001, 0.1),
        (1e-9, 1.1e-4, 0.0, 0.1),
        (1e-9, 1.0, 1e-5, 1e-5),
    ],
)
def test_a_share_inside_moves_the_fit_by_a_quarter_of_an_error(
    monkeypatch, move, allowed, share, wanted
):
    """In three tries; constraints allow no larger share."""
    direction = np.array([0.3, -0.7])
    size = np.linalg.norm((A @ STEPS).T @ A @ P @ direction)

    def containing(model, constraints, best, tried):
        if tried > allowed:
            return None
        u = 1.0 + direction * move * (tried / 0.1) / size
        return SimpleNamespace(solution=SimpleNamespace(u=u))

    monkeypatch.setattr(best_fits, "_containing", containing)
    stacked = np.column_stack([A[:, 0], [7.0, 7.0], A[:, 1], [5.0, 5.0]])
    free = SimpleNamespace(
        base=SimpleNamespace(independent=(0, 2)),
        noise=SimpleNamespace(
            steps=STEPS, errors=lambda score: float(np.linalg.norm(score)) - 1e-12
        ),
        regression=SimpleNamespace(stacked=lambda: stacked),
    )
    problem = SimpleNamespace(
        model=None, free=free, constraints=[PhysicalConsistency()]
    )
    best = SimpleNamespace(
        scaled=SimpleNamespace(projection=P), solution=SimpleNamespace(u=np.ones(2))
    )
    found = best_fits.inner_fit(problem, best, share=wanted)
    assert found.share == pytest.approx(share)
    moved = move * share / 0.1
    assert found.move == pytest.approx(moved) and (found.best is best) == (not share)


def test_the_excess_is_that_of_one_degree_of_freedom():
    regression = SimpleNamespace(counts=(10, 30), sigma=np.array([0.5, 2.0]))
    own, least = np.array([0.7, 1.5]), np.array([0.4, 1.0])
    mine = 10 * 1.4**2 + 30 * 0.75**2
    best = 10 * 0.8**2 + 30 * 0.5**2
    found = fit._excess(regression, own, least, 8)
    assert found == pytest.approx(np.sqrt((mine / 40) / (best / 32)))
    assert np.isnan(fit._excess(regression, own, least, 40))

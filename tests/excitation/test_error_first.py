"""Designs for the least errors: never worse than random, bounded, judged, refused."""

import numpy as np
import pytest
from excited import arm, arm_limits

from consistent_id import InfeasibleError, NotExcitedError, ProblemError, TorqueModel
from consistent_id.excitation.accuracy import (
    predicted_accuracy,
    relative_accuracy,
    with_default_noise,
)
from consistent_id.excitation.aims import Aim, PathForm, forms_to_try
from consistent_id.excitation.design import design_trajectory
from consistent_id.excitation.design_record import design_tables
from consistent_id.excitation.search_problem import search_problem
from consistent_id.motion.limits import MotionLimits
from consistent_id.regression import base_parameters

FORM = PathForm(5.0, 3)


def designed(aim=None, form=FORM, joints=2, **how):
    robot = arm(joints)
    given = {"limits": arm_limits(robot), "starts": 1, "workers": 1, "time_limit": 60.0}
    return design_trajectory(robot, form, aim, **(given | how))


def mean_error(path, joints=2):
    """Geometric mean of the errors along principal axes, by singular values."""
    model = TorqueModel(arm(joints))
    accuracy = predicted_accuracy(model, base_parameters(model), path)
    singular = np.linalg.svd(accuracy.factor, compute_uv=False)
    return float(np.exp(-np.log(singular).mean()))


def searched(joints=2, form=FORM):
    robot = arm(joints)
    model, limits = TorqueModel(robot), arm_limits(robot)
    return search_problem(model, base_parameters(model), form, Aim(), limits)


def random_paths(count, joints=2, form=FORM):
    problem = searched(joints, form)
    return [problem.basis.trajectory(problem.random(k)) for k in range(count)]


@pytest.mark.slow
def test_least_errors_are_the_default_and_the_condition_number_is_reported():
    design = designed()
    (stage,) = design.stages
    assert stage.objective == "D"
    assert stage.value == pytest.approx(mean_error(design.trajectory), rel=1e-6)
    assert stage.value < 0.8 * min(map(mean_error, random_paths(8)))
    text = "\n".join(table.text() for table in design_tables(design))
    assert "condition number of" in text and "Share of each limit" in text


@pytest.mark.slow
def test_least_errors_need_a_better_path_than_the_least_condition_number():
    errors = mean_error(designed().trajectory)
    condition = designed(Aim("condition", refine=None)).trajectory
    assert errors < mean_error(condition)


@pytest.mark.slow
def test_no_design_is_worse_than_the_best_random_path():
    # No work at all is allowed: what is returned is still the best of eight.
    design = designed(time_limit=1e-9, starts=8)
    best = min(map(mean_error, random_paths(8)))
    assert mean_error(design.trajectory) <= best * (1.0 + 1e-9)
    assert any("no improvement in" in note for note in design.notes)
    assert any("time limit ended" in note for note in design.notes)


def test_a_second_stage_that_finds_nothing_says_so_and_is_there():
    # A bound of one leaves the second stage nothing but the path it begins with.
    design = designed(Aim("condition", growth=1.0), time_limit=1e-9)
    first, second = design.stages
    assert np.array_equal(first.trajectory.sine, second.trajectory.sine)
    assert second.objective == "D" and not second.improved
    assert any(note.startswith("D: no improvement in") for note in design.notes)


@pytest.mark.slow
def test_a_bound_on_the_condition_number_is_kept_or_refused():
    least = designed(Aim("condition", refine=None), joints=3).condition.value
    free = designed(joints=3).condition.value
    bound = 1.02 * least
    assert free > bound  # so that the bound is in the way
    design = designed(Aim(condition_at_most=bound), joints=3)
    assert [stage.objective for stage in design.stages] == ["condition", "D"]
    # Searches take fewer samples than will be recorded, hence half a percent.
    assert design.condition.value <= 1.005 * bound
    with pytest.raises(InfeasibleError, match="above the 1 that is allowed"):
        designed(Aim(condition_at_most=1.0), joints=3)


@pytest.mark.slow
def test_of_several_forms_the_best_is_taken():
    forms = [PathForm(5.0, 3), PathForm(5.0, 6)]
    design = designed(form=forms)
    assert design.form == forms[1] and design.tried == tuple(forms)
    assert mean_error(design.trajectory) < mean_error(designed().trajectory)


def test_faster_joints_get_higher_frequencies():
    def limits(speed):
        return MotionLimits(("a",), [-1], [1], [speed], [1e3], [np.inf], [np.inf])

    arm_like, leg_like = forms_to_try(limits(0.6)), forms_to_try(limits(6.0))
    assert [form.frequencies[-1] for form in arm_like] == pytest.approx([0.5, 0.8, 1.2])
    assert leg_like[-1].frequencies[-1] > 5.0
    assert max(len(form.frequencies) for form in leg_like) <= 24
    # a short search gets further over few harmonics
    assert leg_like[0].frequencies[-1] == pytest.approx(1.6)


def test_paths_from_rest_to_rest_repeat_near_five_seconds_and_longer_if_slow():
    def periods(speed, duration, **how):
        limits = MotionLimits(("a",), [-1], [1], [speed], [1e3], [np.inf], [np.inf])
        forms = forms_to_try(limits, duration, **how)
        assert {form.duration for form in forms} == {duration}
        return {form.period for form in forms}

    least = MotionLimits(("a",), [-1], [1], [1.0], [1e3], [np.inf], [np.inf])
    assert [form.harmonics for form in forms_to_try(least, 10.0)] == [8, 12]
    assert [form.harmonics for form in forms_to_try(least, 5.0)] == [5, 8, 12]
    for duration, period in ((2.5, 2.5), (6.0, 6.0), (10.0, 5.0), (30.0, 5.0)):
        assert periods(1.0, duration) == {period}
    # A slower robot has longer periods: 0.7 of the time of a swing over its range.
    assert periods(0.6, 30.0) == {7.5}
    assert periods(0.06, 10.0) == {10.0}
    assert periods(1.0, 10.0, rest=False) == {10.0}


@pytest.mark.parametrize("rest", [True, False])
def test_a_path_that_repeats_is_searched_in_one_repetition(rest):
    once = searched(form=PathForm(3.0, 4, rest=rest))
    twice = searched(form=PathForm(6.0, 4, 2.0 / 6.0, rest=rest))
    assert twice.limits.matrix.shape == once.limits.matrix.shape
    assert np.allclose(twice.grid, once.grid)
    assert twice.information.samples == once.information.samples
    variables = once.random(0)
    for problem, duration in ((once, 3.0), (twice, 6.0)):
        assert problem.basis.trajectory(variables).duration == duration
    # Twice as long, twice the information.
    M, twofold = (p.information(variables).matrix for p in (once, twice))
    assert np.allclose(twofold, 2.0 * M)


def test_without_a_statement_noise_is_a_share_of_the_effort_limits():
    robot = arm(2)
    limits = arm_limits(robot, effort=[40.0, 10.0])
    aim = with_default_noise(Aim(), TorqueModel(robot), limits)
    assert np.allclose(aim.noise, [0.2, 0.05]) and aim.assumed_noise
    for other in (Aim("condition"), Aim(noise=1.0)):
        assert with_default_noise(other, TorqueModel(robot), limits) is other
    without = with_default_noise(Aim(), TorqueModel(robot), arm_limits(robot))
    assert without.noise is None


def test_an_assumed_noise_does_not_weigh_the_condition_number():
    model = TorqueModel(arm(2))
    base, (path,) = base_parameters(model), random_paths(1)
    plain = predicted_accuracy(model, base, path)
    noise = [0.2, 0.01]
    assumed = predicted_accuracy(
        model, base, path, Aim(noise=noise, assumed_noise=True)
    )
    stated = predicted_accuracy(model, base, path, Aim(noise=noise))
    assert assumed.condition.value == pytest.approx(plain.condition.value, rel=1e-9)
    assert stated.condition.value != pytest.approx(plain.condition.value, rel=1e-2)
    assert np.allclose(assumed.standard_errors(), stated.standard_errors())


def test_correlated_noise_widens_errors_by_the_root_of_its_length():
    model = TorqueModel(arm(2))
    base, (path,) = base_parameters(model), random_paths(1)
    white = predicted_accuracy(model, base, path, Aim(correlation_time=0.0))
    alike = predicted_accuracy(model, base, path, Aim(correlation_time=0.25))
    assert np.allclose(alike.standard_errors(), 5.0 * white.standard_errors())
    assert (
        "25 samples" in alike.noise_note and "unlike on real robots" in white.noise_note
    )


def test_repetitions_for_five_percent_bring_five_percent():
    model = TorqueModel(arm(2))
    base, (path,) = base_parameters(model), random_paths(1)
    accuracy = predicted_accuracy(model, base, path, Aim(noise=0.5))
    found = relative_accuracy(model, accuracy)
    x = base.projection @ arm(2).nominal
    places = [base.names.index(name) for name in found.matter]
    errors = accuracy.standard_errors(found.repetitions)
    assert (errors / abs(x))[places].max() == pytest.approx(0.05, rel=1e-4)
    assert f"{int(np.ceil(found.repetitions))} times" in found.note


@pytest.mark.slow
def test_a_motion_that_noise_drowns_is_refused():
    with pytest.raises(NotExcitedError, match="useless"):
        designed(Aim(noise=1e4))


def test_a_bound_that_makes_no_sense_is_refused():
    with pytest.raises(ProblemError, match=r"condition_at_most is 0\.5"):
        Aim(condition_at_most=0.5)
    with pytest.raises(ProblemError, match="correlation_time"):
        Aim(correlation_time=-1.0)


@pytest.mark.slow
def test_a_smooth_design_begins_and_ends_without_jerk():
    robot = arm(2)
    form = PathForm(6.0, 5, smooth=True)
    options = {"limits": arm_limits(robot), "starts": 1, "workers": 1}
    design = design_trajectory(robot, form, **options, time_limit=20.0)
    ends = design.trajectory.evaluate([0.0, 6.0], 3)
    bounds = np.array([design.trajectory.derivative_bound(k) for k in range(4)])
    assert (abs(ends[1:]) <= 1e-9 * bounds[1:, None]).all()
    assert design.proof.holds
    with pytest.raises(ProblemError, match="rest = true"):
        PathForm(6.0, 5, rest=False, smooth=True)

"""Shapes of friction by variable projection."""

import os
from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from some_fast import some_fast

from consistent_id import (
    DHRow,
    DriveTerms,
    NotExcitedError,
    ProblemError,
    TorqueModel,
    build_regression,
    from_modified_dh,
    least_squares,
    load_problem,
    simulate_torque,
)
from consistent_id.estimation import fit_shapes, shape_fit
from consistent_id.estimation.shape_profile import ShapeGroup, ShapeMisfit
from consistent_id.recordings.joint_paths import Sinusoid, SinusoidalMotion
from consistent_id.regression import (
    GearCoupling,
    base_parameters,
    shapes_of,
    with_shapes,
)
from consistent_id.regression.correlation_lengths import correlation_length
from consistent_id.regression.friction_shapes import shape_regression
from consistent_id.robot.scaling import reference_bodies

TRUE = DriveTerms(
    viscous=True,
    coulomb="tanh",
    velocity_scale=0.03,
    stribeck_velocity=0.25,
    stribeck_exponent=1.5,
)
GUESS = replace(TRUE, velocity_scale=0.2, stribeck_velocity=0.05, stribeck_exponent=1.0)
COUPLING = GearCoupling("joint2", "joint3", coulomb="tanh", velocity_scale=0.03)


@cache
def _experiment(drive=TRUE, couplings=(), noise=0.05, seed=1):
    """A simulated arm and its recording."""
    rng = np.random.default_rng(seed)
    table = [DHRow(0, 0), DHRow(-np.pi / 2, 0.1), DHRow(0, 0.4)]
    robot = from_modified_dh("arm", table)
    model = TorqueModel(robot, drive, couplings)
    joints = tuple(
        tuple(Sinusoid(a, a, f, p) for a, f, p in rng.uniform(0.1, 0.6, (5, 3)))
        for _ in range(3)
    )
    motion = SinusoidalMotion(40.0, 100.0, joints).recording(robot.joint_names)
    drive_values = rng.uniform(1.0, 3.0, len(model.layout) - 30)
    x = np.concatenate([reference_bodies(robot).ravel(), drive_values])
    return model, simulate_torque(model, x, motion, noise=noise, rng=rng)


def _guess(model, **changes):
    drive = tuple(replace(GUESS, **changes) for _ in model.terms)
    couplings = tuple(replace(c, velocity_scale=0.2) for c in model.couplings)
    return replace(model, drive=drive, couplings=couplings)


def _misfit(model, log, groups=None):
    data = shape_regression(model, [log])
    if groups is None:
        groups = tuple(ShapeGroup(s.name, (s,)) for s in shapes_of(model))
    return ShapeMisfit(data, base_parameters(model), groups, np.array([1.0, 2.0, 3.0]))


def test_shapes_are_named_and_changed_by_name():
    model, _ = _experiment(couplings=(COUPLING,))
    shapes = {shape.name: shape for shape in shapes_of(model)}
    assert len(shapes) == 10
    assert shapes["joint2.stribeck_exponent"].unit == "1"
    assert shapes["joint2+joint3.velocity_scale"].value == 0.03
    other = with_shapes(
        model, {"joint2.stribeck_velocity": 0.7, "joint2+joint3.velocity_scale": 0.1}
    )
    assert [t.stribeck_velocity for t in other.terms] == [0.25, 0.7, 0.25]
    assert other.couplings[0].velocity_scale == 0.1
    assert other.layout == model.layout
    with pytest.raises(ProblemError, match=r"no shape 'joint2\.colour'"):
        with_shapes(model, {"joint2.colour": 1.0})


@pytest.mark.slow
@pytest.mark.parametrize("load", [False, True])
def test_other_shapes_give_the_regression_that_starting_anew_gives(load):
    model, log = _experiment(couplings=(COUPLING,))
    if load:
        drive = tuple(replace(t, load_friction=True) for t in model.terms)
        bodies = reference_bodies(model.robot).ravel()
        model = replace(model, drive=drive, load_reference=bodies)
    model = replace(model, torque_joints=("joint1", "joint3"))
    values = {s.name: 1.7 * s.value for s in shapes_of(model)}
    other = with_shapes(model, values)
    data = shape_regression(model, [log, log])
    quick, anew = data.regression(other), build_regression(other, [log, log])
    assert (quick.counts, quick.fingerprint) == (anew.counts, anew.fingerprint)
    for mine, theirs in zip(quick.factors, anew.factors, strict=True):
        gram = theirs.T @ theirs
        assert np.allclose(mine.T @ mine, gram, rtol=0, atol=1e-13 * abs(gram).max())
    x = least_squares(other, anew).parameters
    residuals = data.residuals(x, data.columns(other))
    rms = [np.sqrt(np.mean(r**2)) for r in residuals]
    assert np.allclose(rms, anew.residual_rms(x), rtol=1e-9)


@pytest.mark.slow
def test_the_misfit_is_that_of_weighted_least_squares():
    model, log = _experiment()
    misfit = _misfit(model, log)
    values = np.log([1.3 * s.value for s in shapes_of(model)])
    other = misfit.model(values)
    regression = build_regression(other, log).weighted([1.0, 2.0, 3.0])
    x = least_squares(other, regression).parameters
    expected = np.linalg.norm(regression.stacked() @ np.append(x, -1.0))
    assert np.exp(misfit.at(values).half_log) == pytest.approx(expected, rel=1e-10)


@pytest.mark.parametrize("shared", some_fast([True, False]))
def test_the_misfits_slope_is_that_of_finite_differences(shared):
    model, log = _experiment(couplings=(COUPLING,))
    groups = None
    if shared:
        scales = tuple(s for s in shapes_of(model) if s.kind == "velocity_scale")
        groups = (ShapeGroup("velocity_scale", scales),)
    misfit = _misfit(model, log, groups)
    u = np.log([1.5 * group.value for group in misfit.groups])
    slope, h = misfit.at(u).slope, 1e-5
    for i, step in enumerate(h * np.eye(len(u))):
        change = misfit.at(u + step).half_log - misfit.at(u - step).half_log
        # Misfits are known to 1e-15, differences of them to 1e-10.
        assert slope[i] == pytest.approx(change / (2 * h), rel=1e-5, abs=1e-8)


@pytest.mark.slow
def test_known_shapes_are_found_and_lie_in_their_intervals():
    model, log = _experiment()
    found = fit_shapes(_guess(model), log)
    for kind in ("velocity_scale", "stribeck_velocity", "stribeck_exponent"):
        shape = found[kind]
        truth = getattr(TRUE, kind)
        assert shape.determined
        assert shape.low < truth < shape.high, str(shape)
        assert shape.value == pytest.approx(truth, rel=0.2)
        assert found[f"joint3.{kind}"] is shape
    assert found.error_after < 0.5 * found.error_before
    assert min(found.misfits) == 1.0
    assert shapes_of(found.model)[0].value == found["velocity_scale"].value
    # White noise: no sample repeats what another said.
    assert found.correlation < 1.5


@pytest.mark.slow
def test_each_joint_may_have_shapes_of_its_own():
    model, log = _experiment(couplings=(COUPLING,))
    drive = tuple(replace(t, stribeck_velocity=None) for t in model.terms)
    simple = replace(model, drive=drive)
    scales = {"joint1": 0.02, "joint2": 0.05, "joint3": 0.1, "joint2+joint3": 0.03}
    truth = with_shapes(
        simple, {f"{owner}.velocity_scale": v for owner, v in scales.items()}
    )
    x = np.concatenate([reference_bodies(model.robot).ravel(), np.full(7, 2.0)])
    rng = np.random.default_rng(2)
    log = simulate_torque(truth, x, replace(log, torque=None), noise=0.02, rng=rng)
    found = fit_shapes(simple, log, shared=False, starts=2)
    for owner, value in scales.items():
        shape = found[f"{owner}.velocity_scale"]
        assert shape.low < value < shape.high
        assert shape.value == pytest.approx(value, rel=0.2)


@pytest.mark.slow
def test_intervals_hold_the_truth_as_often_as_they_say():
    drive = DriveTerms(viscous=True, coulomb="tanh", velocity_scale=0.05)
    inside = 0
    for seed in range(40):
        model, log = _experiment(drive, noise=1.0, seed=100 + seed)
        shape = fit_shapes(model, log, starts=1)["velocity_scale"]
        inside += shape.low < 0.05 < shape.high
    # Of 40 intervals of 95 %, 33 or fewer would hold the truth once in 300 times.
    assert inside > 33


@pytest.mark.slow
def test_a_shape_that_the_motion_cannot_show_is_left_open():
    # All rates are far beyond the velocity scale: the sign would do as well.
    model, log = _experiment(DriveTerms(coulomb="tanh", velocity_scale=1e-3), noise=1.0)
    shape = fit_shapes(model, log, starts=2)["velocity_scale"]
    assert not shape.determined
    assert "at most" in str(shape)


def test_repeated_samples_tell_nothing_new():
    rng = np.random.default_rng(0)
    white = rng.normal(size=20_000)
    window = np.convolve(white, np.ones(10), mode="valid")
    ones = np.ones(1)
    # 1 + 2 sum_k (1 - k / 10) = 10 for a sum of ten; estimates err by a tenth.
    assert correlation_length([white], ones) == pytest.approx(1.0, abs=0.2)
    assert correlation_length([window], ones) == pytest.approx(10.0, rel=0.3)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"kinds": ("colour",)}, "unknown"),
        ({"kinds": ()}, "has no"),
        ({"bounds": {"velocity_scale": (1.0, 0.1)}}, "expected 0 < low < high"),
        ({"starts": 0}, "starts is 0"),
    ],
)
def test_fits_that_make_no_sense_are_refused(options, message):
    model, log = _experiment()
    with pytest.raises(ProblemError, match=message):
        fit_shapes(model, log, **options)
    with pytest.raises(ProblemError, match="no shape 'a'"):
        fit_shapes(model, log, kinds=("velocity_scale",), starts=1)["a"]


def test_an_exact_fit_tells_nothing_of_shapes():
    model, log = _experiment()
    with pytest.raises(NotExcitedError, match="exact"):
        fit_shapes(
            model, replace(log, torque=np.zeros_like(log.torque)), weighted=False
        )


@pytest.mark.slow
@pytest.mark.skipif(
    "CONSISTENT_ID_DATASETS" not in os.environ,
    reason="CONSISTENT_ID_DATASETS does not name the folder of recordings",
)
def test_the_ur10es_friction_turns_at_a_hundredth_of_a_radian_per_second():
    problem = load_problem("problems/ur10e")
    simple = tuple(replace(t, load_friction=False) for t in problem.model.terms)
    model = replace(problem.model, drive=simple)
    found = fit_shapes(model, problem.training, weighted=False)
    shape = found["velocity_scale"]
    # Least squares at 0.005, 0.01, 0.015, 0.02 and 0.05 rad/s: 3.42, 3.40, 3.44, 3.51
    # and 4.25 %.  Rows of filtered samples say 0.016: their corners are rounded off.
    assert 0.005 < shape.low < shape.value < shape.high < 0.015
    assert found.error_before == pytest.approx(0.0340, abs=1e-4)
    assert found.error_after == pytest.approx(0.0339, abs=1e-4)
    # Its residuals, filtered at 8.5 Hz, go on for many samples.
    assert found.correlation > 10.0


def test_a_joint_may_have_points_in_its_name():
    drive = DriveTerms(coulomb="tanh", velocity_scale=0.1)
    robot = from_modified_dh("arm", [DHRow(0, 0)])
    named = replace(robot, joints=(replace(robot.joints[0], name="left.arm.j1"),))
    model = with_shapes(TorqueModel(named, drive), {"left.arm.j1.velocity_scale": 0.2})
    assert model.terms[0].velocity_scale == 0.2


def test_an_error_is_the_misfit_over_the_torque():
    rows = SimpleNamespace(stacked=lambda: np.array([[9.0, 3.0], [9.0, 4.0]]))
    fit = SimpleNamespace(half_log=np.log(0.5), regression=rows)
    assert shape_fit._error(SimpleNamespace(at=lambda u: fit), None) == 0.1


def test_bounds_are_those_of_the_term_if_none_are_given():
    group = SimpleNamespace(kind="width", members=[SimpleNamespace(bounds=(2.0, 3.0))])
    assert shape_fit._bounds(group, None) == (2.0, 3.0)
    assert shape_fit._bounds(group, {"width": (1.0, 4.0)}) == (1.0, 4.0)
    assert shape_fit._bounds(group, {"height": (1.0, 4.0)}) == (2.0, 3.0)


def test_samples_count_as_many_times_as_they_are_independent(monkeypatch):
    """Of two joints with 300 samples each, every third one says something new."""
    asked, linear = [], SimpleNamespace(parameters=None, model="model")
    misfit = SimpleNamespace(at=lambda u: linear)
    data = SimpleNamespace(
        samples=300,
        regression=lambda model: SimpleNamespace(sigma=[1.0, 2.0]),
        residuals=lambda x, columns: [None] * 2,
        columns=lambda model: None,
    )
    search = shape_fit._ShapeSearch

    def rise(independent, confidence):
        asked.append((independent, confidence))
        return 0.0

    for name, fake in {
        "_groups": lambda *a: (),
        "shape_regression": lambda *a: data,
        "joint_noise": lambda *a, base: [3.0, 4.0],
        "ShapeMisfit": lambda *a: misfit,
        "_searches": lambda *a: [search(None, 2.0, 5), search(None, 1.5, 6)],
        "correlation_length": lambda residuals, sigma: 3.0,
        "allowed_rise": rise,
        "_error": lambda misfit, u: 0.25,
    }.items():
        monkeypatch.setattr(shape_fit, name, fake)
    log = SimpleNamespace()
    monkeypatch.setattr(shape_fit, "several", lambda logs: [log])
    found = fit_shapes(None, log, base="base")
    assert asked == [(200.0, 0.95)]
    assert found.misfits == pytest.approx((np.exp(0.5), 1.0))
    assert (found.evaluations, found.correlation) == (11, 3.0)
    assert 0.0 <= found.seconds < 60.0

"""What parameters rest on: verdicts that follow from how a robot is built."""

from functools import lru_cache

import numpy as np
import pytest
from experiments import pendulum

from consistent_id import (
    DHRow,
    DriveTerms,
    FixedMasses,
    InertialParameters,
    NonNegativeDrive,
    PhysicalConsistency,
    ProblemError,
    Recording,
    TorqueModel,
    from_modified_dh,
    simulate_torque,
)
from consistent_id.constraints import ParameterBounds
from consistent_id.estimation.uncertainties.parameter_uncertainty import uncertainty
from consistent_id.regression.segments import segment_regressions
from consistent_id.robot import Datasheet

BODIES = (PhysicalConsistency(), FixedMasses(), NonNegativeDrive())


def answers(model, truth, log, constraints=BODIES, noise=0.1, **options):
    rng = np.random.default_rng(0)
    log = simulate_torque(model, truth, log, noise=noise, rng=rng)
    sigma = np.full(len(model.robot), max(noise, 1e-3))
    segments = [s.weighted(sigma) for s in segment_regressions(model, log)]
    found = uncertainty(
        model, segments, constraints=constraints, replicates=40, **options
    )
    return {p.name: p for p in found.parameters}, found


def arm():
    """Two parallel axes half a metre apart, of 3 and 2 kg."""
    robot = from_modified_dh("arm", [DHRow(0, 0), DHRow(0, 0.5)])
    sheets = {"link1": Datasheet(mass=3.0), "link2": Datasheet(mass=2.0)}
    model = TorqueModel(robot.with_datasheet(sheets), DriveTerms(viscous=True))
    bodies = [
        InertialParameters.from_central(m, (0.2, 0.05, 0.0), 0.02 * m * np.eye(3))
        for m in (3.0, 2.0)
    ]
    rng = np.random.default_rng(0)
    states = rng.uniform(-2, 2, (3, 400, 2))
    log = Recording(robot.joint_names, np.arange(400) / 100, *states)
    return model, np.concatenate([*(b.vector for b in bodies), [0.3, 0.2]]), log


@lru_cache
def pendulum_answers():
    return answers(*pendulum(), noise=0.05)


@pytest.mark.slow
def test_a_pendulum_shows_what_turns_about_its_axis_and_nothing_else():
    by_name, _ = pendulum_answers()
    expected = {name: "prior" for name in by_name}
    expected |= {"link1.m": "constraint"}
    expected |= dict.fromkeys(
        ("link1.hx", "link1.hy", "link1.Izz", "joint1.viscous"), "data"
    )
    assert {name: p.verdict for name, p in by_name.items()} == expected


@pytest.mark.slow
def test_the_three_answers_enclose_the_value_and_agree_in_size():
    by_name, found = pendulum_answers()
    _, truth, _ = pendulum()
    for p, x in zip(found.parameters, truth, strict=True):
        # The nominal robot that fills in what cannot be seen is not the true one.
        low, high = p.consistent
        assert low - 1e-6 <= p.value <= high + 1e-6
        assert p.resampled[0] - 1e-6 <= p.value <= p.resampled[1] + 1e-6
        if p.verdict == "data":
            assert low <= x <= high
            assert abs(p.value - x) <= 5 * p.standard_error
            # 95 % are four standard errors wide; 24 segments are good to 15 %.
            width = p.resampled[1] - p.resampled[0]
            assert width == pytest.approx(3.92 * p.standard_error, rel=0.6)
    assert by_name["link1.m"].standard_error == pytest.approx(0.0, abs=1e-9)
    assert by_name["link1.m"].consistent == (2.0, 2.0)
    assert len(found.bootstrap.estimates) == 40


@pytest.mark.slow
def test_of_an_arm_that_lies_flat_data_fix_sums():
    # The first link's inertia about its axis adds to half a metre squared times the
    # second's mass, and nothing tells them apart.
    model, truth, log = arm()
    loose = (PhysicalConsistency(), NonNegativeDrive())
    by_name, _ = answers(model, truth, log, loose)
    assert by_name["link1.Izz"].verdict == "combination"
    assert by_name["link2.m"].verdict == "combination"
    for name in ("link2.hx", "link2.hy", "link2.Izz"):
        assert by_name[name].verdict == "data"
    for name in ("link1.hz", "link1.Ixz", "link2.Ixx", "link2.hz"):
        assert by_name[name].verdict == "prior"


@pytest.mark.slow
def test_the_datasheets_mass_takes_such_a_sum_apart():
    by_name, _ = answers(*arm())
    assert by_name["link2.m"].verdict == "constraint"
    assert by_name["link1.Izz"].verdict == "data"
    assert by_name["link1.Izz"].value == pytest.approx(arm()[1][9], abs=0.1)


@pytest.mark.slow
def test_bounds_that_leave_no_room_pin_what_the_data_do_not_see():
    model, truth, log = pendulum()
    bounds = ParameterBounds({"link1.Ixx": (0.01, 0.0101)})
    by_name, _ = answers(model, truth, log, (*BODIES, bounds))
    assert by_name["link1.Ixx"].verdict == "constraint"


@pytest.mark.slow
def test_data_drowned_in_noise_determine_nothing():
    model, truth, log = pendulum()
    by_name, _ = answers(model, truth, log, noise=100.0)
    assert by_name["link1.Izz"].verdict == "loose"
    assert np.isnan(by_name["link1.Izz"].standard_error)


@pytest.mark.slow
@pytest.mark.parametrize("noise", [0.05, 3.0])
def test_scatter_between_recordings_is_stated_where_data_or_constraints_have_a_say(
    noise,
):
    model, truth, log = pendulum()
    sources = np.repeat([0, 1], 12)
    by_name, found = answers(model, truth, log, noise=noise, sources=sources)
    verdicts = {p.verdict for p in found.parameters}
    assert verdicts >= {"prior", "constraint", "data" if noise < 1.0 else "loose"}
    for p in found.parameters:
        known = p.verdict in ("data", "constraint")
        assert np.isfinite(p.standard_error) == known
        assert np.isfinite(p.between_recordings) == (known or p.verdict == "loose")
    assert by_name["link1.m"].between_recordings == 0.0
    assert by_name["link1.Izz"].between_recordings > 0.0


def test_a_single_segment_is_refused():
    model, _, log = pendulum()
    segments = segment_regressions(model, log)
    for few in ((), segments[:1]):
        with pytest.raises(ProblemError, match="segments"):
            uncertainty(model, few)

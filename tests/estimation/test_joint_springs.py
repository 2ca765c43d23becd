"""Springs between motors and links, found in closed forms of two masses."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq
from some_fast import some_fast

from consistent_id import DriveTerms, Recording, TorqueModel, from_modified_dh
from consistent_id.constraints import FixedParameters
from consistent_id.estimation.transmission_springs import (
    _FACTOR,
    _HALVINGS,
    JointSprings,
    _search,
    joint_springs,
)
from consistent_id.regression.elastic_joints import DAMPING, as_rigid, deflection_torque
from consistent_id.robot.inertia import InertialParameters
from consistent_id.robot.loaders import DHRow

LINK, ROTOR = 0.03, 0.05  # kg m^2
SPRING = LINK * (2.0 * np.pi * 8.3) ** 2  # N m/rad: between frequencies that are tried
TIME, SLOW = np.arange(1600) / 200.0, 2.0 * np.pi / 8.0
# rad/s: each tone swells and fades, which is the product with (1 - cos(SLOW t)) / 2.
MAIN = 2.0 * np.pi * np.array([0.5, 1.25, 2.0, 3.0, 3.5])
TONES = np.concatenate([MAIN, MAIN + SLOW, MAIN - SLOW])
SIZES = 0.1 * np.repeat([0.5, -0.25, -0.25], 5) * np.tile(np.exp(1j * np.arange(5)), 3)


def one_joint(gravity=0.0, reach=0.0):
    robot = from_modified_dh("arm", [DHRow(0.0, 0.0)], gravity=(0.0, -gravity, 0.0))
    body = InertialParameters([1.0, reach, 0, 0, 0.002, 0, 0.05, 0, 0, LINK])
    link = replace(robot.links[0], nominal=body)
    return TorqueModel(replace(robot, links=(link,)), DriveTerms(rotor_inertia=True))


def states_of(compliance):
    """Position to acceleration and torque of the motor; the link moves further."""
    motor = SIZES * np.exp(1j * TIME[:, None] * TONES)
    larger = 1.0
    if compliance > 0.0:
        own = np.sqrt(1.0 / (compliance * LINK))
        coupling = own**2 + 2j * DAMPING * own * TONES
        larger = coupling / (coupling - TONES**2)
    torque = -(TONES**2) * (ROTOR + LINK * larger) * motor
    states = motor, 1j * TONES * motor, -(TONES**2) * motor
    return [x.imag.sum(axis=1, keepdims=True) for x in (*states, torque)]


def log_of(compliance, noise, seed=0):
    *states, torque = states_of(compliance)
    shaken = torque + noise * np.random.default_rng(seed).normal(size=torque.shape)
    return Recording(one_joint().robot.joint_names, TIME, *states, shaken)


def test_a_unit_of_compliance_lets_the_link_vibrate_at_one_hertz():
    (unit,) = _search(one_joint(), [log_of(0.0, 0.01)], (), ()).units
    assert np.sqrt(1.0 / (unit[0] * LINK)) / (2.0 * np.pi) == pytest.approx(1.0)


def test_a_unit_of_compliance_is_that_of_one_group_alone():
    """Of equal motors it is the mean of those that are one hertz."""
    model = one_joint()
    body = replace(model.robot.links[0], name="other")
    axis = replace(model.robot.joints[0], name="other")
    pair = replace(
        model.robot,
        joints=(*model.robot.joints, axis),
        links=(*model.robot.links, body),
    )
    log = log_of(0.0, 0.01)
    both = [np.hstack([x, x]) for x in (log.position, log.velocity, log.acceleration)]
    logs = [Recording(pair.joint_names, TIME, *both, np.hstack([log.torque] * 2))]
    pair = TorqueModel(pair, DriveTerms(rotor_inertia=True))
    one = 1.0 / (LINK * (2.0 * np.pi) ** 2)
    alone = _search(pair, logs, (), ()).units
    np.testing.assert_allclose(alone, np.diag([one, one]))
    (together,) = _search(pair, logs, (pair.robot.joint_names,), ()).units
    np.testing.assert_allclose(together, [one, one])


def error_of(noise):
    """Return the error of a compliance by white noise, beside one column of inertia."""
    c, h = 1.0 / SPRING, 1e-3 / SPRING
    slope = (states_of(c + h)[3] - states_of(c - h)[3])[:, 0] / (2.0 * h)
    column = states_of(0.0)[2][:, 0]
    seen = slope - column * (column @ slope) / (column @ column)
    return noise / np.linalg.norm(seen)


@pytest.mark.parametrize("offset", [0.0, 3.0])
@pytest.mark.parametrize("noise", [0.002, 0.02])
def test_the_error_of_a_compliance_is_that_of_noise_beside_the_inertia(noise, offset):
    """Whatever is known besides, such as an offset."""
    model = replace(one_joint(), drive=DriveTerms(rotor_inertia=True, offset=True))
    log = log_of(1.0 / SPRING, noise)
    log = replace(log, torque=log.torque + offset)
    known = FixedParameters({"joint1.offset": offset})
    search = _search(model, [log], (), [known])
    found = search.error(np.array([1.0 / SPRING]), search.units[0])
    # The noise at the spring's few frequencies is estimated from the residual.
    assert found == pytest.approx(error_of(noise), rel=0.3)


@pytest.mark.slow
def test_a_spring_between_those_that_are_tried_is_found_with_its_error():
    noise = 0.02
    found = joint_springs(one_joint(), [log_of(1.0 / SPRING, noise)])
    # Steps of the search are 2 % of the frequency, and so 4 % of the stiffness.
    assert found.stiffness == pytest.approx([SPRING], rel=0.04)
    assert 0.0 < found.misfit < 0.5
    error = error_of(noise)
    assert error < 0.1 / SPRING
    assert found.standard_errors == pytest.approx([error], rel=0.3)


@pytest.mark.slow
@pytest.mark.parametrize("frequency", [5.5, 12.0, 17.0])
def test_soft_and_stiff_springs_are_found(frequency):
    """The search begins with the stiffest."""
    stiffness = LINK * (2.0 * np.pi * frequency) ** 2
    found = joint_springs(one_joint(), [log_of(1.0 / stiffness, 0.002)])
    assert found.stiffness == pytest.approx([stiffness], rel=0.04)


@pytest.mark.slow
@pytest.mark.parametrize("noise", [0.002, 0.02])
def test_a_spring_is_found_between_the_steps_of_the_search(noise):
    """At the least of the misfit, to half a per cent."""
    log = log_of(1.0 / SPRING, noise)
    found = joint_springs(one_joint(), [log]).compliance
    misfit = _search(one_joint(), [log], (), ()).misfit
    below, least, above = (misfit(found * factor) for factor in (0.995, 1.0, 1.005))
    assert least < min(below, above)


@pytest.mark.parametrize("seed", some_fast(range(3)))
def test_a_rigid_joint_has_no_spring(seed):
    found = joint_springs(one_joint(), [log_of(0.0, 0.02, seed)])
    assert found.compliance.tolist() == found.standard_errors.tolist() == [0.0]
    assert found.misfit == 1.0
    assert found.stiffness.tolist() == [np.inf]


def test_at_rest_a_spring_is_bent_by_the_weight_from_the_first_sample():
    model, spring, motor = one_joint(9.81, 0.2), 20.0, 0.4
    link = brentq(lambda x: spring * (motor - x) - 9.81 * 0.2 * np.cos(x), 0.0, 0.4)
    still, weight = np.zeros((200, 1)), 9.81 * 0.2 * np.cos([link, motor])
    names, time = model.robot.joint_names, np.arange(200) / 200.0
    log = Recording(names, time, still + motor, still, still, still + weight[0])
    rigid = as_rigid(model.robot, log, np.array([1.0 / spring])).torque
    # A round leaves a twenty-fifth: the slope of the weight over the spring's.
    bent = abs(weight[1] - weight[0])
    np.testing.assert_allclose(rigid, weight[1], rtol=0, atol=bent / 25**2)
    assert np.ptp(rigid) < 1e-3 * bent


def test_where_a_spring_moves_the_link_its_velocity_is_the_slope_of_that(monkeypatch):
    states, predict = [], TorqueModel.predict

    def seen(self, x, *moved, **options):
        states.append(moved)
        return predict(self, x, *moved, **options)

    monkeypatch.setattr(TorqueModel, "predict", seen)
    log = log_of(0.0, 0.0)
    deflection_torque(one_joint(9.81, 0.2).robot, log, np.array([1.0 / SPRING]))
    rigid, soft = np.array(states[0]), np.array(states[-1])
    moved = (soft - rigid)[..., 0]
    slopes = np.gradient(moved, TIME, axis=1)
    inner = slice(200, -200)
    for higher, slope in zip(moved[1:], slopes, strict=False):
        size = abs(higher[inner]).max()
        np.testing.assert_allclose(higher[inner], slope[inner], atol=0.05 * size)


def test_the_error_of_a_spring_may_be_infinite():
    found = JointSprings(("a", "b"), [0.0, 1e-3], [0.0, np.inf], 0.5)
    assert found.stiffness.tolist() == [np.inf, 1e3]


def test_a_soft_spring_is_found_behind_stiffer_ones_that_are_worse():
    search = _search(one_joint(), [log_of(0.0, 0.01)], (), ())
    misfits = {0.0: 1.0, 20.0: 2.4, 14.0: 12.0, 10.0: 4.5, 7.0: 0.3, 5.0: 1.5}

    def resonant(soft):
        return misfits[round(soft[0] ** -0.5, 6) if soft[0] else 0.0]

    soft = replace(search, misfit=resonant).softened(np.zeros(1), np.ones(1))
    assert soft[0] == pytest.approx(7.0**-2)


@pytest.mark.parametrize("target", [0.3, 0.9, 1.0, 1.6, 3.0])
def test_a_finer_search_ends_within_its_last_step_either_way(target):
    """Of the second group alone, whose misfit is the distance of logarithms."""
    search = _search(one_joint(), [log_of(0.0, 0.01)], (), ())

    def apart(soft):
        return abs(np.log(soft[1] / (2e-3 * target)))

    away = replace(search, misfit=apart)
    found = away.finer(np.array([7e-4, 2e-3]), np.array([0.0, 1.0]))
    last = _FACTOR ** (2.0 * 0.5**_HALVINGS)
    reach = min(max(target, _FACTOR**-1.875), _FACTOR**1.875)
    assert found[0] == 7e-4
    assert 1.0 / last <= found[1] / (2e-3 * reach) <= last


@pytest.mark.parametrize(
    ("bend", "away", "moved"),
    [(1e-6, 0.4, 0.4), (1e-6, 1.7, 1.0), (1e3, -1.7, -1.0), (-1.0, 0.4, 0.0)],
)
def test_a_spring_moves_to_the_vertex_and_no_farther_than_a_step(bend, away, moved):
    """Of the second joint alone, in steps of a twentieth of its compliance."""
    search = _search(one_joint(), [log_of(0.0, 0.01)], (), ())

    def parabola(soft):
        return 5.0 + bend * ((soft[1] / 2e-3 - 1.0) / 0.05 - away) ** 2

    found = replace(search, misfit=parabola).at_vertex(
        np.array([7e-4, 2e-3]), np.array([0.0, 1.0])
    )
    np.testing.assert_allclose(found, [7e-4, 2e-3 * (1.0 + 0.05 * moved)], rtol=1e-6)


def test_a_spring_moves_its_own_branch_alone():
    alone, rng = one_joint(9.81, 0.2).robot, np.random.default_rng(0)
    twice = replace(
        alone,
        joints=(alone.joints[0], replace(alone.joints[0], name="other")),
        links=(alone.links[0], replace(alone.links[0], name="its link")),
    )
    log, soft = log_of(0.0, 0.0), 1.0 / SPRING
    both = replace(
        log,
        joints=twice.joint_names,
        **{
            name: np.hstack([getattr(log, name), rng.normal(size=(len(log), 1))])
            for name in ("position", "velocity", "acceleration", "torque")
        },
    )
    found = deflection_torque(twice, both, np.array([soft, 0.0]))
    expected = deflection_torque(alone, log, np.array([soft]))
    np.testing.assert_array_equal(found, np.hstack([expected, 0.0 * expected]))

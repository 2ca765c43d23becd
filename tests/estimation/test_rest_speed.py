"""Rows of joints at rest are left out where they pull at the parameters."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from quadrupeds import quadruped_text, standing

import consistent_id as ci
from consistent_id.estimation import resting
from consistent_id.estimation.resting import _errors

RATE, SECONDS, STICKS = 100.0, 60, 0.15  # Hz, s, rad/s below which friction is anything
DRIVE = ci.DriveTerms(viscous=True, coulomb="tanh", velocity_scale=0.01)


def pendulum(*, sticks):
    """A pendulum that creeps and swings; what it weighs, and a log of it.

    At rest friction bears two thirds of what its Coulomb friction could, against
    gravity.
    """
    robot = ci.from_modified_dh("pendulum", [ci.DHRow(-np.pi / 2, 0)])
    model = ci.TorqueModel(robot, DRIVE)
    truth = np.zeros(len(model.layout))
    for name, value in (
        ("link1.hx", 1.0),
        ("link1.hy", 0.3),
        ("link1.Izz", 0.5),
        ("joint1.viscous", 0.2),
        ("joint1.coulomb", 3.0),
    ):
        truth[model.layout.index(name)] = value
    rng, time = np.random.default_rng(0), np.arange(SECONDS * RATE) / RATE
    waves = [(0.9, 0.11, 0.3), (0.3, 0.37, 1.2), (0.15, 0.9, 2.0)]
    q, dq, ddq = (
        sum(
            a * (2 * np.pi * f) ** k * np.sin(2 * np.pi * f * time + p + k * np.pi / 2)
            for a, f, p in waves
        )[:, None]
        for k in range(3)
    )
    torque = model.predict(truth, q, dq, ddq)
    if sticks:
        still = truth.copy()
        still[model.layout.index("joint1.coulomb")] = 0.0
        weight = model.predict(still, q, dq, ddq)
        held = weight - 2.0 * np.sign(weight)
        torque = np.where(abs(dq) < STICKS, held, torque)
    torque += 0.02 * rng.normal(size=torque.shape)
    return model, truth, ci.Recording(robot.joint_names, time, q, dq, ddq, torque)


def off(model, truth, log):
    found = ci.least_squares(model, ci.build_regression(model, log))
    names = ["link1.hx", "link1.hy", "link1.Izz"]
    return max(abs(found[n] - truth[model.layout.index(n)]) for n in names)


@pytest.mark.slow
def test_the_lowest_speed_whose_squared_error_is_near_the_least_is_chosen(monkeypatch):
    # At the next speed the error is 3.7 times the least, its square 14 times.
    monkeypatch.setattr(resting, "GAIN", 5.0)
    model, _, log = pendulum(sticks=True)
    some = log.samples(slice(0, 6000, 4))
    found = ci.estimation.rest_speed(model, some, reach=0.01)
    squared = (found.errors**2).mean(axis=1)
    near = squared <= 6.0 * squared.min()
    assert found.speed == found.tried[near].min() > STICKS
    # The first speed leaves enough rows with the whole reach.
    assert len(found.tried) > 1 and found.reach == 0.01


@pytest.mark.slow
def test_rests_that_pull_at_the_parameters_are_left_out():
    model, truth, log = pendulum(sticks=True)
    found = ci.estimation.rest_speed(model, log)
    assert STICKS <= found.speed <= 4 * STICKS
    without = ci.signals.without_rests(log, found.speed)
    assert off(model, truth, without) < 1e-3 < 0.02 < off(model, truth, log)


@pytest.mark.slow
def test_where_friction_is_as_modelled_no_row_is_left_out():
    model, _, log = pendulum(sticks=False)
    found = ci.estimation.rest_speed(model, log)
    assert found.speed == 0.0
    assert found.tried[-1] == 0.0 and (np.diff(found.tried) < 0.0).all()


@pytest.mark.slow
def test_rows_free_of_contact_forces_are_compared_too(tmp_path):
    """The torque of slow joints is off by what dry friction may hold."""
    path = tmp_path / "quadruped.xml"
    path.write_text(quadruped_text())
    robot = ci.robot.load_mjcf(path, base="floating")
    patterns = np.array([[i != j for j in range(4)] for i in range(4)] * 40)
    log = standing(robot, patterns, noise=0.05)
    slow = abs(log.velocity) < np.quantile(abs(log.velocity), 0.1)
    log = replace(log, torque=log.torque + 2.0 * slow)
    model = ci.regression.contact_free_model(ci.TorqueModel(robot))
    known = dict(zip(model.layout.names[10:], robot.nominal[10:], strict=True))
    found = ci.estimation.rest_speed(
        model, log, constraints=[ci.constraints.FixedParameters(known)]
    )
    left = ci.signals.without_rests(log, found.speed).torque_known
    assert not left[slow].any()
    assert left.mean() > 0.5


@pytest.mark.slow
def test_some_torque_of_each_joint_is_left(tmp_path):
    """One joint is slow all the time: what would leave it out is not tried."""
    path = tmp_path / "quadruped.xml"
    path.write_text(quadruped_text())
    robot = ci.robot.load_mjcf(path, base="floating")
    patterns = np.array([[i != j for j in range(4)] for i in range(4)] * 50)
    log = standing(robot, patterns, noise=0.05)
    velocity = log.velocity.copy()
    velocity[:, 3] *= 0.01
    log = replace(log, velocity=velocity, wrenches=())
    known = dict(
        zip(
            ci.TorqueModel(robot).layout.names[10:],
            robot.nominal[10:],
            strict=True,
        )
    )
    model = ci.regression.contact_free_model(ci.TorqueModel(robot))
    found = ci.estimation.rest_speed(
        model, log, constraints=[ci.constraints.FixedParameters(known)]
    )
    assert found.tried.max() < 0.01 < np.median(abs(log.velocity))
    for speed in found.tried[:-1]:
        assert ci.signals.without_rests(log, speed).torque_known.any(axis=0).all()


@pytest.mark.slow
def test_a_reach_that_leaves_too_few_rows_is_shortened():
    """Every 0.5 s a joint turns back: guards of 0.3 s to either side are all of it."""
    model, _, log = pendulum(sticks=False)
    time = log.time[:, None]
    log = replace(
        log, velocity=np.cos(2 * np.pi * time), position=np.sin(2 * np.pi * time)
    )
    assert ci.estimation.rest_speed(model, log, reach=0.06).reach == 0.06
    found = ci.estimation.rest_speed(model, log, reach=0.3)
    assert found.reach == pytest.approx(0.2)
    assert len(found.tried) > 1


def test_what_does_not_move_has_no_rests():
    model, _, log = pendulum(sticks=False)
    with pytest.raises(ci.NotExcitedError, match="no joint moves"):
        ci.estimation.rest_speed(model, replace(log, velocity=0 * log.velocity))
    with pytest.raises(ci.ProblemError, match="rests show in velocity"):
        ci.estimation.rest_speed(model, replace(log, velocity=None, acceleration=None))


def test_parts_are_predicted_by_the_others_along_the_allowed_combinations():
    """Rows of steps, of a start that is known, and of the torque."""
    rng = np.random.default_rng(0)
    parts = [rng.normal(size=(n, 5)) for n in (9, 12, 7)]
    tested = [rng.normal(size=(6, 5)) for _ in parts]
    turn = rng.normal(size=(3, 2))
    found = _errors(parts, tested, turn)
    for k, rows in enumerate(tested):
        A, start, torque = np.split(
            np.vstack(parts[:k] + parts[k + 1 :]), [3, 4], axis=1
        )
        y = turn @ np.linalg.lstsq(A @ turn, torque - start, rcond=None)[0]
        rest = rows[:, :3] @ y[:, 0] + rows[:, 3] - rows[:, 4]
        assert found[k] == pytest.approx(
            np.linalg.norm(rest) / np.linalg.norm(rows[:, 4])
        )


LEFT_OF = {0.5: [2, 1], 0.25: [6, 4], 0.2: [0, 50], 0.1: [9, 0.9], 0.05: [8, 3]}
ENDS = {0.5: 0.0, 0.25: 0.0, 0.2: 1.0, 0.1: 0.0, 0.05: 2.0, 0.0: 0.0}


@pytest.mark.parametrize("whole", [[60, 40], [50, 49]])
def test_speeds_leave_a_tenth_of_the_rows_and_some_of_each_block(monkeypatch, whole):
    """Whether contact-free or not; a block in which a joint rests is not regarded."""
    rows = {**LEFT_OF, 0.0: whole}

    def factors(model, block, combinations):
        return [SimpleNamespace(rows=rows[v][k], factor=(v, k)) for v, k in block]

    monkeypatch.setattr(resting, "masked_factors", factors)
    monkeypatch.setattr(
        resting, "_tells_of_each_joint", lambda left, all: ENDS[left[0][0]] < 2.0
    )
    masked = [resting._Masked(v, [(v, 0), (v, 1)]) for v in rows]
    found = resting._contact_free(None, masked, None)
    kept = [0.25, *([] if sum(whole) == 100 else [0.1]), 0.0]
    assert [one.speed for one in found] == kept
    assert all(one.parts == [(one.speed, 0), (one.speed, 1)] for one in found)


def test_all_rows_are_weighted_by_the_noise_of_the_highest_speed(monkeypatch):
    rng = np.random.default_rng(0)
    counts = {0.5: (2, 7), 0.25: (4, 6), 0.1: (9, 20), 0.0: (60, 40)}
    R, combinations = rng.normal(size=(5, 4)), rng.normal(size=(3, 2))

    def build(model, block, noise):
        if block[0] == 0.1:
            raise ci.NotExcitedError("a joint is slow")
        k = block[1]
        return SimpleNamespace(
            counts=(counts[block[0]][k] - 1, 1),
            weighted=lambda s: SimpleNamespace(stacked=lambda: s * (k + 1) * R),
            speed=block[0],
        )

    monkeypatch.setattr(resting, "build_regression", build)
    monkeypatch.setattr(resting, "merged", lambda parts: parts[0].speed)
    monkeypatch.setattr(resting, "joint_noise", lambda model, speed, base: 10.0 + speed)
    masked = [resting._Masked(v, [(v, 0), (v, 1)]) for v in counts]
    found = resting._every_row(None, masked, combinations, None)
    assert [one.speed for one in found] == [0.25, 0.0]
    for one in found:
        for k, part in enumerate(one.parts):
            rows = 10.25 * (k + 1) * R
            np.testing.assert_allclose(part[:, :2], rows[:, :3] @ combinations)
            np.testing.assert_allclose(part[:, 2], rows[:, 3])


@pytest.mark.parametrize(
    ("errors", "chosen"),
    [
        ([[0.1, 0.3], [0.2, 0.1], [0.23, 0.0228], [0.3, 0.3]], 1),
        ([[0.1, 0.3], [0.2, 0.1], [0.22, 0.0525], [0.3, 0.3]], 2),
        ([[0.5e-6], [1.01e-6], [1.02e-6], [2e-6]], 1),  # less than a millionth is none
    ],
)
def test_the_lowest_speed_near_the_least_square_is_chosen(monkeypatch, errors, chosen):
    """At a third of the reach, as more of it leaves no speed to try."""
    reaches, speeds = [], []

    def rows(model, masked, combinations, base):
        speeds.append([one.speed for one in masked])
        enough = errors if len(speeds) == 3 else errors[:1]
        parts = [[np.eye(3) * k] for k in range(len(enough))]
        return [resting._TriedSpeed(0.8 / (k + 1), p) for k, p in enumerate(parts)]

    def without(log, speed, reach):
        reaches.append(reach)
        return log

    free = SimpleNamespace(directions=np.eye(1), start=np.zeros(1))
    for name, fake in {
        "_every_row": rows,
        "without_rests": without,
        "base_of_recordings": lambda model, logs: "base",
        "_independent": lambda A: None,
        "_errors": lambda parts, yardstick, turn: np.array(errors[int(parts[0][0, 0])]),
    }.items():
        monkeypatch.setattr(resting, name, fake)
    monkeypatch.setattr(resting.FreeParameters, "of", staticmethod(lambda *a: free))
    model = SimpleNamespace(robot=SimpleNamespace(floating=False), torque_joints=("a",))
    time = np.arange(24.0)
    velocity = np.array([0.0] * 4 + [0.2] * 9 + [-0.4] * 2 + [0.9] * 9)[:, None]
    log = ci.Recording(("a",), time, np.zeros((24, 1)), velocity)
    found = ci.estimation.rest_speed(model, log, reach=0.3)
    assert found.speed == 0.8 / (chosen + 1) and len(found.tried) == 4
    assert found.reach == pytest.approx(0.1)
    assert sorted(set(np.round(reaches, 9))) == pytest.approx([0.1, 0.2, 0.3])
    assert speeds == [[*(0.4 * 0.5 ** np.arange(8)), 0.0]] * 3

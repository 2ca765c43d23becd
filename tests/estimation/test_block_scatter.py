"""Scatter between blocks, of blocks whose parameters are known to differ."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from robots import random_robot
from scipy.stats import t

from consistent_id import DriveTerms, NotExcitedError, Recording, TorqueModel
from consistent_id.constraints import FixedParameters
from consistent_id.estimation.uncertainties.block_scatter import (
    BlockScatter,
    _freedom,
    block_scatter,
)
from consistent_id.regression.regression import build_regression

RATE, BLOCKS = 100.0, 24
NOISE = 0.05


def block(model, x, seed):
    """Two seconds of random smooth motion, with white noise of torque."""
    rng = np.random.default_rng(seed)
    time = np.arange(200) / RATE
    w = rng.uniform(2.0, 8.0, (1, 3))
    a, b = rng.normal(0.0, 0.5, (2, 1, 3))
    s, c = np.sin(w * time[:, None]), np.cos(w * time[:, None])
    q, dq, ddq = (
        (part.sum(axis=1))[:, None]
        for part in (a * s + b * c, w * (a * c - b * s), -(w**2) * (a * s + b * c))
    )
    torque = model.predict(x, q, dq, ddq) + NOISE * rng.standard_normal(q.shape)
    log = Recording(model.robot.joint_names, time, q, dq, ddq, torque)
    return build_regression(model, log).weighted([NOISE])


def found(scatter, seed=3, count=BLOCKS):
    """The scatter of blocks whose drive terms are shifted at random."""
    rng = np.random.default_rng(seed)
    _, robot = random_robot(np.random.default_rng(5), 1)
    model = TorqueModel(robot, DriveTerms(viscous=True, offset=True))
    x = np.append(robot.nominal, [0.3, 0.1])
    bodies = FixedParameters(
        dict(zip(model.layout.names[:10], x[:10].tolist(), strict=True))
    )
    shifts = np.zeros((count, 12))
    shifts[:, 10:] = scatter * rng.standard_normal((count, 2))
    blocks = [block(model, x + shift, 100 + k) for k, shift in enumerate(shifts)]
    return model, bodies, blocks, shifts[:, 10:]


@pytest.mark.slow
def test_scatter_that_is_there_is_found():
    model, bodies, blocks, shifts = found(0.05)
    known = block_scatter(model, blocks, constraints=[bodies])
    assert [name.split(".")[1] for name in known.names] == ["viscous", "offset"]
    # A draw of 24 has its own deviation; noise is a tenth of it.
    assert known.between == pytest.approx(shifts.std(axis=0, ddof=1), rel=0.3)
    assert (known.noise < 0.2 * known.between).all()
    # The mean of the blocks, whose weights are not quite alike.
    errors = abs(known.values - [0.3, 0.1])
    assert (errors < 3.0 * known.standard_errors).all()


@pytest.mark.slow
def test_of_noise_alone_little_scatter_is_left():
    model, bodies, blocks, _ = found(0.0)
    known = block_scatter(model, blocks, constraints=[bodies])
    single = block_scatter(model, blocks[:1], constraints=[bodies])
    # 24 blocks know a variance to 29 %; two such errors are 0.76 of a deviation.
    assert (known.between < 0.8 * single.noise).all()
    assert single.between.tolist() == [0.0, 0.0]


@pytest.mark.slow
def test_intervals_hold_other_blocks_as_often_as_they_say():
    held, by_noise = [], []
    for seed in range(20):
        model, bodies, blocks, _ = found(0.05, seed, 9)
        known = block_scatter(model, blocks[:8], constraints=[bodies])
        other = block_scatter(model, blocks[8:], constraints=[bodies])
        held.append(known.holds(other))
        by_noise.append(known.holds(other, between=False))
    # 40 values: 95 % less three standard errors of a share is 85 %.
    assert np.mean(held) >= 0.85
    assert np.mean(by_noise) < 0.6


def one(value, noise, between, blocks):
    each = np.array([[value], [noise], [between]])
    return BlockScatter(("a",), *each, blocks, [np.inf])


def test_errors_of_a_mean_are_noise_and_the_scatter_over_the_blocks():
    assert one(0.0, 3.0, 8.0, 4).standard_errors == pytest.approx(5.0)


@pytest.mark.parametrize(
    ("noise", "other", "blocks", "between", "width"),
    [
        # Without noise, of a new block's deviation and of the known blocks' mean:
        # 2^2 (1 + 1/4).  Student's 97.5 % for 3 degrees of freedom is 3.1824 in tables.
        (0.0, 0.0, 4, True, 3.1824 * np.sqrt(5.0)),
        # By noise alone: 3^2 + 4^2; a normal's quantile is 1.960.
        (3.0, 4.0, 4, False, 1.960 * 5.0),
        (3.0, 4.0, 1, True, 1.960 * np.sqrt(25.0 + 4.0 * 2.0)),
        # Variances 5 of each, of 3 degrees of freedom and of many: 3 (5 + 5)^2 / 5^2
        # are 12, for which tables have 2.1788.
        (np.sqrt(2.5), np.sqrt(2.5), 4, True, 2.1788 * np.sqrt(10.0)),
    ],
)
def test_another_motion_is_within_an_interval_of_both_errors(
    noise, other, blocks, between, width
):
    known = one(10.0, noise, 2.0, blocks)
    assert known.widths_for(one(0.0, other, 7.0, 1), between=between) == pytest.approx(
        width, rel=1e-4
    )
    for side in (-1.0, 1.0):
        for share, inside in ((0.999, True), (1.001, False)):
            away = one(10.0 + side * share * width, other, 7.0, 1)
            assert known.holds(away, between=between).tolist() == [inside]


def test_noise_alone_needs_no_wider_quantile_however_few_the_blocks():
    assert one(0.0, 3.0, 0.0, 4).quantiles == pytest.approx(1.960, abs=1e-3)


def test_a_block_that_leaves_a_parameter_open_is_refused():
    model, _, blocks, _ = found(0.0, count=2)
    with pytest.raises(NotExcitedError, match="fewer"):
        block_scatter(model, blocks)


def test_friction_that_has_faded_in_a_block_leaves_it_open():
    """At 1 rad/s, of friction that fades at 0.05 rad/s, 1e-174 is left."""
    _, robot = random_robot(np.random.default_rng(5), 1)
    drive = DriveTerms(viscous=True, coulomb="sign", stribeck_velocity=0.05)
    model, rng = TorqueModel(robot, drive), np.random.default_rng(6)
    names = zip(model.layout.names[:10], robot.nominal.ravel().tolist(), strict=True)
    blocks = []
    for slowest in (0.01, 1.0):
        dq = rng.choice([-1.0, 1.0], 200) * rng.uniform(slowest, 2.0, 200)
        q, ddq, torque = rng.standard_normal((3, 200, 1))
        motion = (q, dq[:, None], ddq, torque)
        log = Recording(model.robot.joint_names, np.arange(200) / RATE, *motion)
        blocks.append(build_regression(model, log).weighted([NOISE]))
    known = [FixedParameters(dict(names))]
    block_scatter(model, blocks[:1], constraints=known)
    with pytest.raises(NotExcitedError, match="fewer"):
        block_scatter(model, blocks, constraints=known)


def test_freedoms_are_those_of_joints_by_their_shares_in_the_variance():
    rng = np.random.default_rng(0)
    factors = rng.normal(size=(2, 6, 4)) * [[[1.0]], [[0.3]]]
    level = np.array([0.5 * 1.2, 2.0 * 0.9])
    regression = SimpleNamespace(
        noise=SimpleNamespace(freedom=np.array([7.0, 40.0])),
        sigma=np.array([0.5, 2.0]),
        correlation=np.array([1.2, 0.9]) ** 2,
        factors=factors,
        weighted=lambda sigma: SimpleNamespace(
            stacked=lambda: np.vstack(factors / sigma[:, None, None])
        ),
    )
    A = factors[:, :, :-1] / level[:, None, None]
    inverse = np.linalg.inv(np.einsum("jki,jkl->il", A, A))
    parts = np.sum((A @ inverse) ** 2, axis=1)
    shares = parts / np.diag(inverse)
    expected = 1.0 / (shares[0] ** 2 / 7.0 + shares[1] ** 2 / 40.0)
    found = _freedom(regression, SimpleNamespace(directions=np.eye(3)))
    np.testing.assert_allclose(found, expected, rtol=1e-9)


def test_the_unit_of_a_parameter_does_not_matter():
    model, bodies, blocks, _ = found(0.05, count=3)
    unit = np.ones(13)
    unit[10] = 1e-9  # viscous friction in nano instead of N m s
    other = [replace(b, factors=tuple(F * unit for F in b.factors)) for b in blocks]
    one, same = (block_scatter(model, b, constraints=[bodies]) for b in (blocks, other))
    assert same.values * unit[10:12] == pytest.approx(one.values)
    assert same.noise * unit[10:12] == pytest.approx(one.noise)


def test_errors_of_noise_and_of_blocks_have_students_quantile_together():
    """By Satterthwaite, with 7 and 30 degrees of freedom, and 3 of four blocks."""
    noise, between, freedom = (np.array(x) for x in ([2e-3, 3], [5e-3, 0.5], [7, 30]))
    known = BlockScatter(("a", "b"), [1e-3, 9.0], noise, between, 4, freedom)
    parts = noise**2, between**2 / 4
    together = sum(parts) ** 2 / (parts[0] ** 2 / freedom + parts[1] ** 2 / 3)
    np.testing.assert_allclose(known.quantiles, t.ppf(0.975, together))
    np.testing.assert_allclose(known.standard_errors**2, sum(parts))

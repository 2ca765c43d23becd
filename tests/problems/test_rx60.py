"""The RX-60: closed-form model, Pinocchio, the paper's tables, no body at all."""

import numpy as np
import pinocchio as pin
import pytest
import rx60
from rx60 import PROBLEM

from consistent_id import InertialParameters, TorqueModel
from consistent_id.problems.published import parametrisation_of


def _inertia_matrix(a, q):
    """The corrected inertia matrix of the three links; `a` counts from 1."""
    _, t2, t3 = q
    c2, s2, t23 = np.cos(t2), np.sin(t2), t2 + t3
    c23, s23, s3 = np.cos(t23), np.sin(t23), np.sin(t3)
    D11 = a[1] * c2**2 + a[2] * s2**2 + a[3] * c23**2 + a[7] * s23**2
    D11 += a[4] * c2 * s23 + a[5] * np.sin(2 * t2) + a[6] * np.sin(2 * t23) + a[8]
    D13 = a[11] * c23 + a[12] * s23
    D12 = a[9] * c2 + a[10] * s2 + D13
    D33 = a[7] + a[14]
    D23 = D33 + a[4] * s3 / 2
    D22 = a[1] + a[13] + D33 + a[4] * s3
    return np.array([[D11, D12, D13], [D12, D22, D23], [D13, D23, D33]])


def _closed_form(alpha, q, dq, ddq):
    """Torque of the closed-form model; Christoffel terms by central differences."""
    a = np.concatenate([[0.0], alpha])
    step = 1e-5
    dD = [
        (_inertia_matrix(a, q + e) - _inertia_matrix(a, q - e)) / (2 * step)
        for e in step * np.eye(3)
    ]
    D_dot = sum(rate * slope for rate, slope in zip(dq, dD, strict=True))
    coriolis = D_dot @ dq - 0.5 * np.array([dq @ slope @ dq for slope in dD])
    c2, s23 = np.cos(q[1]), np.sin(q[1] + q[2])
    gravity = np.array([0.0, a[15] * c2 + a[16] * s23, a[16] * s23])
    return _inertia_matrix(a, q) @ ddq + coriolis + gravity


def _pinocchio():
    """The arm of Table I, built with Pinocchio alone; links without inertia."""
    model = pin.Model()
    model.gravity = pin.Motion(np.array([0, 0, 9.8, 0, 0, 0.0]))
    table = [(0.0, 0.0, 0.237), (-np.pi / 2, 0.0, 0.0), (0.0, 0.29, 0.049)]
    for k, (alpha, a, d) in enumerate(table):
        twist = pin.SE3(pin.utils.rotate("x", alpha), np.array([0.0, 0.0, 0.0]))
        place = twist * pin.SE3(np.eye(3), np.array([a, 0.0, d]))
        model.addJoint(k, pin.JointModelRZ(), place, f"j{k}")
    return model


def test_the_published_regressor_is_that_of_the_closed_form_model():
    mine = parametrisation_of(PROBLEM)
    rng = np.random.default_rng(0)
    q, dq, ddq = rng.uniform(-2.0, 2.0, (3, 20, 3))
    Y = mine.regressor(q, dq, ddq)
    for k, alpha in enumerate(np.eye(16)):
        expected = [_closed_form(alpha, *s) for s in zip(q, dq, ddq, strict=True)]
        # Central differences of sines: step^2 / 6 times rates squared, below 1e-8.
        assert np.allclose(Y[:, k].T, expected, atol=1e-8), mine.names[k]


def test_the_published_regressor_gives_the_torque_of_pinocchio():
    mine = parametrisation_of(PROBLEM)
    rng = np.random.default_rng(1)
    reference = _pinocchio()
    data = reference.createData()
    x = rng.normal(size=30)
    x[[mine.model.layout.index(name) for name in mine.zero]] = 0.0
    states = rng.uniform(-2.0, 2.0, (3, 10, 3))
    torque = np.einsum("jas,a->sj", mine.regressor(*states), mine.matrix @ x)
    for s, state in enumerate(zip(*states, strict=True)):
        expected = pin.computeJointTorqueRegressor(reference, data, *state) @ x
        assert np.allclose(torque[s], expected, atol=1e-11 * abs(expected).max())


def test_the_datasheet_gives_every_constant_that_the_paper_prints():
    a2, d3, g0 = 0.29, 0.049, 9.8
    sheet = {link.name: link.datasheet for link in PROBLEM.model.robot.links}
    m2, a2c = sheet["link2"].mass, sheet["link2"].com[0]
    m3, d4c = sheet["link3"].mass, -sheet["link3"].com[1]
    printed = {
        0.5597: a2**2 * m3 + m2 * a2c**2,
        0.1255: 2 * m3 * a2 * d4c,
        0.0130: m3 * d4c**2,
        0.0087: m3 * d3**2,
        0.0512: a2 * d3 * m3,
        0.0106: d3 * m3 * d4c,
        24.7750: g0 * (m2 * a2c + m3 * a2),
        2.1197: g0 * m3 * d4c,
    }
    for expected, value in printed.items():
        assert value == pytest.approx(expected, abs=0.5e-4)  # four decimals


@pytest.mark.slow
def test_the_rank_is_14_of_16_and_11_of_13_with_the_two_known_null_directions():
    report = rx60.report()
    assert (len(report.all_columns.columns), report.all_columns.rank) == (16, 14)
    assert (len(report.free_columns.columns), report.free_columns.rank) == (13, 11)
    assert set(report.free_columns.null_directions) == {
        "alpha1 + alpha2 - alpha8 - alpha13",
        "alpha3 + alpha7 - alpha8 - alpha14",
    }


def test_no_torque_changes_along_the_null_directions():
    mine = parametrisation_of(PROBLEM)
    rng = np.random.default_rng(2)
    Y = mine.regressor(*rng.uniform(-2.0, 2.0, (3, 10, 3)))
    for names in (("1", "2", "8", "13"), ("3", "7", "8", "14")):
        first, second, *others = [mine.names.index(f"alpha{n}") for n in names]
        change = Y[:, first] + Y[:, second] - Y[:, others].sum(axis=1)
        assert abs(change).max() <= 1e-12 * abs(Y).max()


@pytest.mark.slow
def test_tables_4_and_5_follow_from_table_3_to_the_printed_digits():
    # Half of the last printed digit, twice where a table was rounded before.
    for name, difference in rx60.report().largest_differences.items():
        assert difference <= 1e-4, name


@pytest.mark.slow
def test_no_body_with_the_datasheet_masses_has_any_of_the_published_vectors():
    report = rx60.report()
    assert len(report.vectors) == 7
    for vector in report.vectors:
        assert vector.feasibility.answer == "impossible"
        assert vector.feasibility.proof.bound < -0.5
        assert [v.link for v in vector.feasibility.violations] == ["link3"]


def test_link_3_of_the_mean_violates_the_triangle_inequality_whatever_is_free():
    # In the published vector: B3 > A3 + C3, and both null directions shift both sides
    # alike; so does the largest moment in any axes.
    body = InertialParameters(rx60.report().mean_links["link3"])
    A, B, C = np.diag(body.central_inertia)
    assert (B, A + C) == pytest.approx((1.246, 0.7597), abs=1e-3)
    moments = np.linalg.eigvalsh(body.central_inertia)
    excess = moments[2] - moments[0] - moments[1]
    sentence = rx60.report().vectors[0].feasibility.summary
    stated = float(sentence.partition(" (proven")[0].rsplit(" ", 1)[1])
    # The statement is made one hundredth of the depth away from the extreme point.
    assert stated == pytest.approx(excess, rel=0.02)


def test_the_nearest_consistent_robot_keeps_the_datasheet_and_the_torque():
    report = rx60.report()
    for vector in report.vectors:
        nearest = vector.nearest
        assert nearest.certificate.verdict == "certified"
        assert nearest["link2.m"] == pytest.approx(8.5699, rel=1e-7)
        assert nearest["link3.m"] == pytest.approx(3.603, rel=1e-7)
        assert nearest["link2.hx"] == pytest.approx(8.5699 * 0.17307, rel=1e-6)
        assert abs(nearest["link3.hx"]) < 1e-7
        for body in nearest.links:
            assert InertialParameters(body).is_consistent()
    # A separate prototype reached 0.077, 0.037, 0.027 N m for the mean; the certified
    # optimum cannot be worse.
    assert np.linalg.norm(report.vectors[0].torque_change) <= np.linalg.norm(
        [0.077, 0.037, 0.027]
    )


def test_the_torque_change_is_that_of_pinocchios_inverse_dynamics():
    report = rx60.report()
    motion, vector = report.motion, report.vectors[0]
    reference = _pinocchio()
    data = reference.createData()
    printed = np.concatenate(
        [report.mean_links[k] for k in ("link1", "link2", "link3")]
    )
    change = vector.nearest.parameters - printed
    difference = [
        pin.computeJointTorqueRegressor(reference, data, *state) @ change
        for state in zip(
            motion.position[::100],
            motion.velocity[::100],
            motion.acceleration[::100],
            strict=True,
        )
    ]
    rms = np.sqrt(np.mean(np.square(difference), axis=0))
    # A hundredth of the samples of a smooth periodic motion.
    assert rms == pytest.approx(vector.torque_change, rel=0.02)


def test_the_model_is_the_first_three_links_with_gravity_up():
    robot = PROBLEM.model.robot
    assert robot.link_names == ("link1", "link2", "link3")
    assert robot.gravity.tolist() == [0.0, 0.0, 9.8]
    assert isinstance(PROBLEM.model, TorqueModel)

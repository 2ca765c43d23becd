"""A regression comes back from its file bit by bit, and does the work of the data."""

import json
from dataclasses import replace

import numpy as np
import pytest
from robots import random_robot, random_states

from consistent_id.errors import ProblemError
from consistent_id.estimation.base_least_squares import least_squares
from consistent_id.recordings.recording import Recording
from consistent_id.regression.drive.drive_terms import DriveTerms
from consistent_id.regression.given_regression import load_regression, save_regression
from consistent_id.regression.regression import build_regression
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.residual_noise import joint_noise

DRIVE = DriveTerms(viscous=True, coulomb="sign")


def case(samples=(300, 200), joints=3, drive=DRIVE):
    rng = np.random.default_rng(7)
    _, robot = random_robot(rng, joints)
    model = TorqueModel(robot, drive)
    logs = [
        Recording(
            robot.joint_names,
            0.01 * np.arange(n),
            *random_states(rng, joints, n),
            rng.normal(size=(n, joints)),
        )
        for n in samples
    ]
    return model, logs


def same(a, b):
    assert (a.layout, a.joints, a.counts) == (b.layout, b.joints, b.counts)
    assert a.fingerprint == b.fingerprint
    for one, other in (
        *zip(a.factors, b.factors, strict=True),
        *zip(a.noise.scores, b.noise.scores, strict=True),
        *zip(a.noise.shapes, b.noise.shapes, strict=True),
        (a.noise.effective, b.noise.effective),
        (a.sigma, b.sigma),
        (a.peaks, b.peaks),
    ):
        np.testing.assert_array_equal(one, other)


def test_every_number_comes_back_to_the_last_bit(tmp_path):
    model, logs = case()
    regression = build_regression(model, logs).weighted([0.1, 1 / 3, 7.0])
    same(load_regression(save_regression(regression, tmp_path / "r.json")), regression)


def test_errors_of_stribeck_velocities_come_back_as_well(tmp_path):
    drive = DriveTerms(viscous=True, coulomb="sign", stribeck_velocity=0.2)
    regression = build_regression(*case(drive=drive))
    assert [len(N) for N in regression.noise.shapes] == [3, 3, 3]
    file = save_regression(regression, tmp_path / "r.json")
    same(load_regression(file), regression)
    record = json.loads(file.read_text())
    record["noise"]["shared"].pop()
    file.write_text(json.dumps(record))
    with pytest.raises(ProblemError, match="shared errors of 2 joints, expected 3"):
        load_regression(file)
    record["noise"]["shared"].append([])
    file.write_text(json.dumps(record))
    with pytest.raises(ProblemError, match="3 and 3 and 0 rows of the joints"):
        load_regression(file)


def test_a_file_of_this_package_can_be_written_again(tmp_path):
    model, logs = case()
    parts = [build_regression(model, log) for log in logs]
    for part in parts:
        save_regression(part, tmp_path / "r.json")
    same(load_regression(tmp_path / "r.json"), parts[1])


def test_parts_add_and_are_weighted_and_estimated_from_without_the_recordings(tmp_path):
    model, logs = case()
    files = [
        save_regression(build_regression(model, log), tmp_path / f"{i}.json")
        for i, log in enumerate(logs)
    ]
    first, second = map(load_regression, files)
    whole = build_regression(model, logs)
    sigma = joint_noise(model, first + second)
    found = least_squares(model, (first + second).weighted(sigma)).parameters
    truth = least_squares(model, whole.weighted(sigma)).parameters
    # The same least squares through another order of triangles.
    np.testing.assert_allclose(found, truth, rtol=0, atol=1e-10 * abs(truth).max())


def test_a_regression_whose_noise_is_not_known_comes_back_so(tmp_path):
    from dataclasses import replace

    model, logs = case()
    white = replace(build_regression(model, logs), noise=None)
    assert load_regression(save_regression(white, tmp_path / "r")).noise is None


def test_fewer_rows_than_columns_come_back(tmp_path):
    model, logs = case(samples=(5,))
    regression = build_regression(model, logs)
    same(load_regression(save_regression(regression, tmp_path / "r")), regression)


SPOILED = {
    "format": ("consistent_id estimate 1", "its format is 'consistent_id estimate 1'"),
    "counts": ([3, 4], "3 joints need 3 factors and 3 counts"),
    "sigma": ([1.0, -1.0, 1.0], "expected positive values"),
    "factors": ([[[1.0]], [], []], r"a row of 1 numbers, expected 37"),
    "links": (["a", "a", "b"], "not unique"),
    "noise": ({"effective": [1.0, 2.0, 0.0], "scores": [[], [], []]}, "positive"),
    "peaks": ("none", "not a regression: Expected `array`"),
    "unknown": (1, "unknown field `unknown`"),
}


@pytest.mark.parametrize("key", SPOILED)
def test_a_file_that_does_not_fit_together_is_refused_with_its_name(key, tmp_path):
    model, logs = case()
    path = save_regression(build_regression(model, logs), tmp_path / "r.json")
    content = json.loads(path.read_text())
    content[key], expected = SPOILED[key]
    path.write_text(json.dumps(content))
    with pytest.raises(ProblemError, match=expected) as refused:
        load_regression(path)
    assert str(path) in str(refused.value)


@pytest.mark.parametrize(
    "changes",
    [
        {"effective": [1.0, 2.0, 0.0]},
        {"freedom": [1.0, 2.0, 0.0]},
        {"freedom": [1.0, 2.0]},
        {"effective": [1.0, 2.0, 3.0, 4.0]},
        {"scores": [[], []]},
    ],
)
def test_noise_is_of_every_joint_and_positive(changes, tmp_path):
    model, logs = case()
    path = save_regression(build_regression(model, logs), tmp_path / "r.json")
    content = json.loads(path.read_text())
    content["noise"] |= changes
    path.write_text(json.dumps(content))
    with pytest.raises(ProblemError, match="expected positive numbers of 3"):
        load_regression(path)


@pytest.mark.parametrize("content", [b"", b"{", b"[1]", b"\xff\xfe", b"[" * 10**5])
def test_what_is_no_regression_is_refused(content, tmp_path):
    path = tmp_path / "r.json"
    path.write_bytes(content)
    with pytest.raises(ProblemError, match="not a regression"):
        load_regression(path)


def test_degrees_of_freedom_may_be_less_than_one(tmp_path):
    model, logs = case()
    regression = build_regression(model, logs)
    few = replace(regression.noise, freedom=np.array([0.5, 0.01, 3.0]))
    path = save_regression(replace(regression, noise=few), tmp_path / "r.json")
    assert load_regression(path).noise.freedom.tolist() == [0.5, 0.01, 3.0]


def test_the_file_of_a_regression_is_one_line_with_blanks(tmp_path):
    model, logs = case(samples=(5,))
    path = save_regression(build_regression(model, logs), tmp_path / "r.json")
    text = path.read_text()
    assert len(text.splitlines()) == 1 and '{"format": ' in text

"""What is asked of a design is checked at the door, and between is between."""

import json

import numpy as np
import pytest
from paths import one_sine

from consistent_id import ProblemError, load_problem
from consistent_id.excitation.aims import Aim, PathForm
from consistent_id.excitation.request import design_request
from consistent_id.motion import write_trajectory
from consistent_id.recordings.joint_paths import harmonics_of


@pytest.mark.parametrize("bases", [(0.1, 0.15), (0.1, 0.2), (0.1, 0.3, 0.7), 0.2])
@pytest.mark.parametrize("harmonics", [2, 3, 5])
def test_frequencies_between_are_none_of_those_of_the_form(bases, harmonics):
    own = PathForm(10.0, harmonics, bases).frequencies
    other = PathForm(10.0, harmonics, bases, between=True).frequencies
    assert len(other)
    assert abs(own[:, None] - other).min() > 1e-6
    assert (np.diff(other) > 1e-6).all()


def test_frequencies_that_differ_by_rounding_are_one():
    # 0.3 / 2 and 3 (0.1 / 2) are not the same number.
    found = PathForm(10.0, 3, (0.1, 0.3), between=True).frequencies
    assert len(found) == len(np.unique(found.round(9)))


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (("5", 3), "duration is '5', expected a number"),
        ((np.nan, 3), "duration is nan"),
        ((5.0, 2.5), "harmonics is 2.5, expected a whole number"),
        ((5.0, np.nan), "harmonics is nan"),
        ((5.0, None), "harmonics is None, expected a number"),
        ((5.0, 3, ()), "at least one of either"),
        ((5.0, 3, "x"), "base frequencies"),
        ((5.0, 3, (0.1, np.nan)), "expected positive ones"),
    ],
)
def test_a_form_that_makes_no_sense_is_refused(given, said):
    with pytest.raises(ProblemError, match=said):
        PathForm(*given)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"noise": "x"}, "noise is 'x', expected a number"),
        ({"noise": ["x", 1.0]}, "noise: expected numbers"),
        ({"noise": [[1.0], [1.0, 2.0]]}, "noise: expected numbers"),
        ({"rate": "x"}, "rate is 'x', expected a number"),
        ({"rate": np.nan}, "rate is nan"),
        ({"growth": "x"}, "growth is 'x', expected a number"),
        ({"earlier": [1]}, "earlier holds a int, expected regressions"),
        ({"earlier": 1.0}, "earlier holds a float, expected regressions"),
        ({"task": 3}, "task is int, expected a Recording"),
    ],
)
def test_an_aim_that_makes_no_sense_is_refused(given, said):
    with pytest.raises(ProblemError, match=said):
        Aim(**given)


def test_noise_by_name_must_be_numbers():
    with pytest.raises(ProblemError, match="noise: expected numbers"):
        Aim(noise={"a": "x", "b": 1.0}).noise_of(("a", "b"))


def test_numbers_of_numpy_become_plain_ones():
    form = PathForm(np.int64(5), np.int64(3))
    assert type(form.duration) is float and type(form.harmonics) is int
    path = one_sine(duration=np.int64(2), start=np.int64(1))
    assert json.loads(json.dumps(path.to_dict()))["duration_s"] == 2.0


@pytest.mark.parametrize("rate", ["x", None, [1.0, 2.0], np.nan, -1.0])
def test_samples_at_no_rate_are_refused(rate, tmp_path):
    with pytest.raises(ProblemError, match="rate"):
        write_trajectory(one_sine(), tmp_path / "path.csv", rate=rate)


@pytest.mark.parametrize("name", ["duration", "start"])
def test_a_path_at_no_time_is_refused(name):
    with pytest.raises(ProblemError, match=f"{name} is 'x', expected a number"):
        one_sine(**{name: "x"})


def test_no_base_frequencies_are_not_a_base_frequency():
    with pytest.raises(ProblemError, match="at least one of either"):
        harmonics_of([], 3)


ARM = """
name = "arm"
[model]
modified_dh = [{{ alpha_deg = 0.0, a = 0.0, lower = -1, upper = 1, velocity = 2.0 }}]
[constraints]
masses = "free"
[excitation]
{excitation}
"""


@pytest.mark.parametrize(
    ("excitation", "said"),
    [
        ("periods = 3", "periods is 3, but a path that rests"),
        ("base_frequencies = []", "base_frequencies"),
    ],
)
def test_a_problem_file_that_contradicts_itself_is_refused(excitation, said, tmp_path):
    file = tmp_path / "arm.toml"
    file.write_text(ARM.format(excitation=excitation))
    with pytest.raises(ProblemError, match=said):
        design_request(load_problem(file))

"""How often to play a path, where earlier recordings tell something already."""

import numpy as np
import pytest
from excited import arm
from paths import random_path

from consistent_id import (
    NotExcitedError,
    ProblemError,
    TorqueModel,
    build_regression,
    simulate_torque,
)
from consistent_id.excitation.accuracy import predicted_accuracy
from consistent_id.excitation.aims import Aim
from consistent_id.regression import base_parameters

MODEL = TorqueModel(arm(2))
BASE = base_parameters(MODEL)
NAME = BASE.names[1]


def accuracy(seed=1, earlier_rate=20.0):
    """A path's accuracy, with a recording of another path before it."""
    motion = random_path(0, MODEL.robot.joint_names).recording(earlier_rate)
    rng = np.random.default_rng(0)
    known = build_regression(
        MODEL, simulate_torque(MODEL, arm(2).nominal, motion, noise=0.1, rng=rng)
    )
    path = random_path(seed, MODEL.robot.joint_names)
    return predicted_accuracy(MODEL, BASE, path, Aim(earlier=known))


def test_nothing_is_played_where_earlier_recordings_suffice():
    told = accuracy()
    known = told.standard_errors(0.0)[1]
    assert told.repetitions_for({NAME: known}) == 0.0
    assert told.repetitions_for({NAME: 10.0 * known}) == 0.0
    assert told.repetitions_for({}) == 0.0


@pytest.mark.parametrize("share", [0.999_999, 0.99, 0.5, 0.1])
def test_just_enough_is_played_where_earlier_recordings_nearly_suffice(share):
    told = accuracy()
    wanted = share * told.standard_errors(0.0)[1]
    often = told.repetitions_for({NAME: wanted})
    assert often > 0.0
    assert told.standard_errors(often)[1] <= wanted
    assert told.standard_errors(often * (1.0 - 1e-5) - 2e-9)[1] > wanted


def test_repetitions_that_make_no_sense_are_refused():
    told = accuracy()
    for repetitions in (-1.0, np.nan, np.inf):
        with pytest.raises(ProblemError, match="expected 0 or more"):
            told.standard_errors(repetitions)
    with pytest.raises(ProblemError, match="expected numbers"):
        told.repetitions_for({NAME: "small"})


def test_a_path_that_tells_too_little_is_refused_before_it_is_repeated():
    still = random_path(0, MODEL.robot.joint_names, amplitude=0.0)
    with pytest.raises(NotExcitedError, match="does not identify all"):
        predicted_accuracy(MODEL, BASE, still).repetitions_for({NAME: 1.0})

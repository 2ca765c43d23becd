"""Typical sizes of links, where the model says little."""

import numpy as np

from consistent_id import DHRow, from_modified_dh
from consistent_id.robot.scaling import link_scales


def test_a_robot_whose_joints_are_all_in_one_place_is_a_metre_long():
    table = [DHRow(0, 0), DHRow(-np.pi / 2, 0)]
    scales = link_scales(from_modified_dh("wrist", table))
    assert scales.length.tolist() == [0.1, 0.1]  # a tenth of it, at the least
    assert scales.mass.tolist() == [1.0, 1.0]

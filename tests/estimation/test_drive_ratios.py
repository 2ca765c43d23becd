"""Drives on a bound: where a bound ends, in units that are not one."""

import numpy as np
import pytest

from consistent_id import DHRow, DriveTerms, TorqueModel, from_modified_dh
from consistent_id.constraints import ParameterBounds
from consistent_id.estimation.drive_ratios import errors_off_bounds


@pytest.mark.parametrize("at", [2e-3, -400.0])
@pytest.mark.parametrize(("off", "on"), [(0.0, True), (9e-5, True), (1.1e-4, False)])
def test_a_value_within_a_part_in_ten_thousand_of_a_bound_has_no_error(at, off, on):
    robot = from_modified_dh("arm", [DHRow(0, 0)])
    layout = TorqueModel(robot, DriveTerms(viscous=True, offset=True)).layout
    name = layout.names[-2]
    bounds = ParameterBounds({name: (min(at, 0.0), max(at, 0.0))})
    errors = np.arange(1.0, 1.0 + len(layout))
    x = np.zeros(len(layout))
    x[-2] = at * (1.0 - off)
    found = errors_off_bounds(layout, x, errors, [bounds])
    assert np.isnan(found[-2]) == on
    assert np.isfinite(np.delete(found, -2)).all() and np.isfinite(errors).all()
    assert errors_off_bounds(layout, x, None, [bounds]) is None

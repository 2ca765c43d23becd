"""Filtered torque: edges of friction that rows of samples miss accuse no log."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from consistent_id import (
    DHRow,
    DriveTerms,
    InertialParameters,
    Recording,
    TorqueModel,
    from_modified_dh,
    low_passed,
    simulate_torque,
)
from consistent_id.diagnosis import diagnose
from consistent_id.diagnosis.channel_factors import channel_factors
from consistent_id.diagnosis.explain import (
    datasheet_constraints,
    fitted_log,
    of_samples,
    rounded_misfit,
)
from consistent_id.regression.base import base_parameters
from consistent_id.robot.model import Link

SHARP = DriveTerms(viscous=True, coulomb="sign")
SLENDER = np.diag([0.004, 0.02, 0.022])  # kg m^2 per kg
CUTOFFS = [1.0, 2.0, 5.0]


@cache
def _run():
    """Return an arm with sharp friction, and its log without noise."""
    rows = [DHRow(0, 0, 0.3), DHRow(-np.pi / 2, 0), DHRow(0, 0.5, 0.1)]
    robot = from_modified_dh("arm", rows)
    centres = ([0, 0.02, -0.1], [0.2, 0, 0.1], [0, -0.1, 0.05])
    bodies = (
        InertialParameters.from_central(mass, centre, mass * SLENDER)
        for mass, centre in zip((8.0, 6.0, 4.0), centres, strict=True)
    )
    links = tuple(
        Link(link.name, body) for link, body in zip(robot.links, bodies, strict=True)
    )
    model = TorqueModel(replace(robot, links=links), SHARP)
    time = np.arange(3000) / 100.0
    rates = 2 * np.pi * np.array([0.07, 0.16, 0.31])[:, None] * [1.0, 1.1, 0.9]
    angle = time[:, None, None] * rates + np.arange(9).reshape(3, 3)
    motion = Recording(
        model.robot.joint_names,
        time,
        0.5 * np.sin(angle).sum(axis=1),
        0.5 * (rates * np.cos(angle)).sum(axis=1),
        -0.5 * (rates**2 * np.sin(angle)).sum(axis=1),
    )
    truth = np.concatenate([np.ravel(model.robot.nominal), [5.0, 12.0] * 3])
    return model, simulate_torque(model, truth, motion)


def _fitted(model, log):
    base = base_parameters(model)
    return fitted_log(model, log, datasheet_constraints(model), base)


@pytest.mark.parametrize("cutoff", CUTOFFS)
def test_rows_filtered_like_the_torque_explain_a_log_without_noise(cutoff):
    model, log = _run()
    smooth = low_passed(log, torque_cutoff=cutoff)
    (factors,) = channel_factors(model, base_parameters(model), [smooth])
    assert factors.least_misfit() < 1e-9
    as_is = _fitted(model, smooth)
    assert as_is.misfit < 1e-5  # of a cone programme
    assert as_is.least_likely < 1e-5


@pytest.mark.parametrize("cutoff", CUTOFFS)
def test_what_rows_of_samples_miss_is_the_misfit_of_a_log_without_noise(cutoff):
    model, log = _run()
    smooth = low_passed(log, torque_cutoff=cutoff)
    known = datasheet_constraints(model)
    missed = rounded_misfit(model, smooth, known, base_parameters(model))
    assert missed > 0.01
    assert missed == pytest.approx(_fitted(model, of_samples(smooth)).misfit, rel=0.15)
    assert rounded_misfit(model, log, known, base_parameters(model)) == 0.0


def test_columns_of_drives_may_come_from_another_filtered_motion():
    model, log = _run()
    smooth = low_passed(log, torque_cutoff=2.0)
    base = base_parameters(model)
    own, other = channel_factors(model, base, [smooth] * 2, drives=[None, smooth])
    for A, B in zip(own.factors, other.factors, strict=True):
        assert np.allclose(A, B, rtol=0, atol=1e-12 * abs(A).max())


def _kinds(model, log, cutoff):
    found = diagnose(
        model, log, prepare=lambda raw: low_passed(raw, torque_cutoff=cutoff)
    )
    return {f.kind for f in found.suspicious}


@pytest.mark.slow
def test_a_clean_log_is_not_called_unexplained_for_its_filter():
    model, log = _run()
    assert _fitted(model, of_samples(low_passed(log, torque_cutoff=1.0))).misfit > 0.06
    assert not _kinds(model, log, 1.0)


@pytest.mark.slow
def test_a_log_that_no_robot_explains_is_still_called_so_behind_a_filter():
    model, log = _run()
    swing = np.sin(2 * np.pi * 0.43 * log.time + np.arange(3)[:, None]).T
    spoilt = replace(log, torque=log.torque + log.torque.std(axis=0) * swing)
    assert "model does not explain" in _kinds(model, spoilt, 1.0)

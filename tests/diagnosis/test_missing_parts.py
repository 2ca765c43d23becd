"""What a log's residuals look like: contact in a while, magnitudes without a sign."""

from dataclasses import replace

import numpy as np
import pytest
from faulty_logs import arm, clean_log, logs

from consistent_id import base_parameters
from consistent_id.diagnosis.explain import datasheet_constraints, fitted_log
from consistent_id.diagnosis.lost_signs import lost_signs
from consistent_id.diagnosis.missing_parts import Residual, of_a_while


def _as_is(log):
    model = arm()
    ready = logs().prepared(log)
    return fitted_log(
        model, ready, datasheet_constraints(model), base_parameters(model)
    )


def _pushed(log, start, stop):
    """Return a log in which something pushes for a while."""
    torque = np.array(log.torque)
    rows = slice(int(start * len(log)), int(stop * len(log)))
    torque[rows] += 10.0 * torque.std(axis=0)
    return replace(log, torque=torque)


@pytest.mark.parametrize(
    ("start", "stop", "kinds"),
    [(0.45, 0.47, ["contact"]), (0.0, 0.03, []), (0.97, 1.0, [])],
)
def test_residuals_of_a_while_are_contact_but_at_the_ends_filters_settle(
    start, stop, kinds
):
    as_is = _as_is(_pushed(clean_log(4), start, stop))
    samples = len(as_is.recording)
    rest = np.full(samples, 1e-3)
    rest[int(start * samples) : int(stop * samples)] = 1.0
    left = [Residual(np.zeros((samples, 0)), rest, 1.0)]
    assert [c.cause.kind for c in of_a_while(as_is, left)] == kinds


@pytest.mark.parametrize("joint", [0, 1])
def test_the_sign_that_a_torque_has_lost_is_found_again(joint):
    log = clean_log(4)
    torque = np.array(log.torque)
    torque[:, joint] = abs(torque[:, joint])
    as_is = _as_is(replace(log, torque=torque))
    (found,) = lost_signs(as_is)
    assert (found.cause.kind, found.cause.where) == ("torque sign", log.joints[joint])
    clean = _as_is(log).factors.least_misfit()
    # Filters round the cusps of a magnitude: not all of it comes back.
    assert found.factors.least_misfit() < 5.0 * clean + 0.02
    assert found.factors.least_misfit() < 0.3 * as_is.factors.least_misfit()


def test_a_torque_with_its_sign_has_lost_none():
    assert list(lost_signs(_as_is(clean_log(4)))) == []
    assert list(lost_signs(_as_is(_pushed(clean_log(4), 0.4, 0.5)))) == []

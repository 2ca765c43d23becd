"""Offsets and springs that may be zero are not in exported files."""

import re
from dataclasses import replace

import numpy as np
import pytest
from estimates import estimate_of

from consistent_id import (
    DHRow,
    DriveTerms,
    TorqueModel,
    from_modified_dh,
    to_mjcf,
)
from consistent_id.export.actuator_config import readme
from consistent_id.export.export_formats import exported, without_doubtful
from consistent_id.export.mjcf_export import WEAK
from consistent_id.robot.inertia import InertialParameters
from consistent_id.robot.model import JointLimits
from consistent_id.rollout.commanded_motion import FileError


@pytest.fixture(scope="module")
def estimate():
    terms = DriveTerms(viscous=True, offset=True, spring=True)
    model = TorqueModel(
        from_modified_dh("arm", [DHRow(0.0, 0.0), DHRow(0.0, 0.3)]), terms
    )
    body = InertialParameters.from_central(1.0, [0.1, 0.0, 0.0], 0.01 * np.eye(3))
    values = {"viscous": 0.3, "offset": 0.05, "spring": 0.2}
    names = model.layout.names[model.layout.inertial_size :]
    x = [values[name.split(".")[1]] for name in names]
    made = estimate_of(model, [body, body], np.array(x))
    errors = np.full(len(model.layout), np.nan)
    index = model.layout.names.index
    errors[index("joint1.offset")] = 0.06  # may be zero
    errors[index("joint2.offset")] = 0.01  # is not
    errors[index("joint1.spring")] = 0.19  # is not
    errors[index("joint2.spring")] = 0.3  # may be zero
    errors[index("joint1.viscous")] = 1.0  # friction is never left out
    return replace(made, parameter_errors=errors, sigma=np.array([1.0, 4.0]))


def test_only_offsets_and_springs_within_their_error_are_left_out(estimate):
    kept, (note,) = without_doubtful(estimate)
    changed = np.flatnonzero(kept.parameters != estimate.parameters)
    left_out = {estimate.model.layout.names[i] for i in changed}
    assert left_out == {"joint1.offset", "joint2.spring"}
    assert (kept.parameters[changed] == 0.0).all()
    assert "joint1.offset 0.05 +- 0.06" in note and "joint2.spring" in note


def test_a_spring_that_is_a_solvers_rounding_carries_no_offset(estimate):
    """It would be stretched by the offset over 1e14 rad; without errors, too."""
    x, index = estimate.parameters.copy(), estimate.model.layout.names.index
    x[[index("joint1.spring"), index("joint2.spring")]] = 1.5e-16, -4e-17
    x[index("joint1.offset")] = 3.0
    made = replace(estimate, parameters=x, parameter_errors=None)
    kept, notes = without_doubtful(made)
    assert not notes and not kept.parameters[index("joint1.spring")]
    assert kept.parameters[index("joint1.offset")] == 3.0
    text = exported(made, "mjcf").content.decode()
    for found in re.findall(r'springref="([^"]*)"', text):
        assert abs(float(found)) <= 1.01 / WEAK


def test_a_term_that_the_torque_needs_stays(estimate):
    # An offset beyond a fifth of the residual, a spring that is so far from zero.
    exact = replace(estimate, sigma=np.array([0.2, 0.2 * np.pi]))
    assert without_doubtful(exact) == (exact, ())
    kept, _ = without_doubtful(replace(exact, sigma=np.array([0.26, 1.01 * np.pi])))
    assert np.count_nonzero(kept.parameters != exact.parameters) == 2
    # Together they are not felt either.
    both = replace(estimate, parameter_errors=np.full(len(estimate.parameters), 1.0))
    kept, (note,) = without_doubtful(replace(both, sigma=np.array([4.0, 3.2])))
    assert "joint2.offset" in note and "joint2.spring" not in note


@pytest.mark.parametrize(("reach", "held"), [(1.5, True), (2.0, False)])
def test_friction_by_position_is_listed_where_a_tendon_cannot_hold_it(reach, held):
    """Between the limits of these joints a tendon turns by 3 and by 4 rad."""
    terms = DriveTerms(coulomb="tanh", velocity_scale=0.02, friction_slope=True)
    rows = [DHRow(0.0, 0.0, limits=JointLimits(-reach, reach))]
    model = TorqueModel(from_modified_dh("arm", rows), terms)
    body = InertialParameters.from_central(1.0, [0.1, 0.0, 0.0], 0.01 * np.eye(3))
    values = {"coulomb": 0.3, "friction_slope": 0.04}
    names = model.layout.names[model.layout.inertial_size :]
    x = [values[name.split(".")[1]] for name in names]
    made = estimate_of(model, [body], np.array(x))
    text = readme(made, "mjcf", "arm.xml", []).content.decode()
    assert ("every drive term" in text) == held
    assert ("| joint1 | friction_slope | 0.04" in text) != held


def test_what_is_left_out_is_listed_as_what_a_file_lacks(estimate):
    text = readme(estimate, "mjcf", "arm.xml", []).content.decode()
    assert "| joint1 | offset | 0.05 N m | `offset` |" in text
    assert "| joint2 | spring | 0.2 N m/rad |" in text
    assert "every drive term" not in text


@pytest.mark.slow
def test_mjcf_lacks_them_and_says_so_at_both_doors_but_functions_have_them(estimate):
    pytest.importorskip("mujoco")
    mjcf = exported(estimate, "mjcf", allow_refused=True)
    assert any("left out" in n and "joint1.offset" in n for n in mjcf.notes)
    stiff = b'stiffness="0.2"'
    assert mjcf.content.count(stiff) == 1
    assert to_mjcf(whole(estimate)).content.count(stiff) == 2
    assert to_mjcf(estimate, allow_refused=True) == mjcf
    for form in ("json", "numpy"):
        found = exported(estimate, form, allow_refused=True)
        assert not any("left out" in note for note in found.notes)


def whole(estimate):
    """The same estimate, all of whose terms are sure."""
    return replace(estimate, parameter_errors=None)


def test_an_estimate_without_errors_stays_as_it_is(estimate):
    bare = replace(estimate, parameter_errors=None)
    assert without_doubtful(bare) == (bare, ())


def test_a_delay_that_the_file_lacks_is_priced_and_shown_in_python():
    first, second = FileError(4e-3, 3e-3, 0.005).lines()
    assert "4.00 mrad" in first and "3.00 with commands 5.00 ms late" in first
    assert "round(0.005 / model.opt.timestep)" in second
    assert FileError(4e-3, 4e-3, 0.0).lines() == [first.split(";")[0]]

"""Where constraints and data disagree, the constraint that is wrong is named."""

import numpy as np
import pytest

from consistent_id import (
    DHRow,
    DriveTerms,
    FixedMasses,
    InertialParameters,
    NonNegativeDrive,
    PhysicalConsistency,
    Recording,
    TorqueModel,
    build_regression,
    from_modified_dh,
    simulate_torque,
)
from consistent_id.comparison.constraint_prices import (
    ConstraintCost,
    constraint_costs,
    shadow_prices,
)
from consistent_id.report.summary import costly_constraints


def _costly(second_mass):
    """Two axes at right angles; the second link weighs two kilograms."""
    robot = from_modified_dh("arm", [DHRow(0, 0), DHRow(-np.pi / 2, 0.5)])
    model = TorqueModel(robot, DriveTerms(viscous=True))
    bodies = [
        InertialParameters.from_central(m, (0.2, 0.05, 0.0), 0.002 * m * np.eye(3))
        for m in (3.0, 2.0)
    ]
    truth = np.concatenate([*(b.vector for b in bodies), [0.3, 0.2]])
    rng = np.random.default_rng(0)
    log = Recording(
        robot.joint_names, np.arange(400) / 100, *rng.uniform(-2, 2, (3, 400, 2))
    )
    log = simulate_torque(model, truth, log, noise=0.02, rng=rng)
    constraints = (
        PhysicalConsistency(),
        FixedMasses({"link2": second_mass}),
        NonNegativeDrive(),
    )
    regression = build_regression(model, log)
    return costly_constraints(
        constraint_costs(model, regression, constraints),
        shadow_prices(model, regression, constraints),
    )


def test_a_mass_that_the_motion_contradicts_is_named():
    # With a hundredth of the mass the same moments of first and second order would be
    # those of no body: m Izz > hx^2.
    (line,) = _costly(0.02)
    assert line.startswith("constraints that increase the misfit, each alone: ")
    assert "FixedMasses" in line and "NonNegativeDrive" not in line
    assert "link2" in line.partition("most of all")[2]


@pytest.mark.parametrize(
    ("increase", "said"),
    [(0.3, "(misfit +30%)"), (1.0, "(misfit 2 times)"), (1.4e6, "1.4e+06 times")],
)
def test_large_costs_are_multiples(increase, said):
    constraint, rms = FixedMasses({"link2": 1.0}), np.ones(2)
    cost = ConstraintCost(constraint, rms, rms, increase, "certified")
    (line,) = costly_constraints([cost], [])
    assert said in line


def test_a_right_mass_costs_nothing():
    assert _costly(2.0) == ()

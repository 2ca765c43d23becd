"""Each linear constraint, at both sides of its bounds; and bounds that cannot be."""

from dataclasses import replace

import numpy as np
import pytest

from consistent_id import DHRow, DriveTerms, ProblemError, TorqueModel, from_modified_dh
from consistent_id.constraints import (
    CentreOfMassBoxes,
    EqualLinks,
    FixedCentresOfMass,
    FixedMasses,
    FixedParameters,
    LinearRelation,
    MassBounds,
    NonNegativeDrive,
    ParameterBounds,
    SymmetricLink,
    TotalMass,
)
from consistent_id.constraints.cones.sets import ConicSet
from consistent_id.robot import JointLimits

ARM = from_modified_dh("arm", [DHRow(-np.pi / 2, 0), DHRow(0, 0.5)])
LIMITS = JointLimits(-2.0, 1.0, 3.0)
ROBOT = replace(
    ARM,
    joints=tuple(replace(j, kind="revolute", limits=LIMITS) for j in ARM.joints),
)
MODEL = TorqueModel(
    ROBOT, DriveTerms(viscous=True, coulomb="sign", friction_slope=True, drag=True)
)
BODY = {"m": 2.0, "hx": 0.2, "hy": -0.4, "hz": 0.6, "Ixx": 1.0, "Iyy": 1.0, "Izz": 1.0}


def point(**changes):
    """Parameters of two like bodies, with friction; changes by name."""
    x = np.zeros(len(MODEL.layout))
    values = {f"link{k}.{name}": v for k in (1, 2) for name, v in BODY.items()}
    values |= {f"joint{k}.coulomb": 1.0 for k in (1, 2)}
    for name, value in (values | changes).items():
        x[MODEL.layout.index(name)] = value
    return x


def holds(constraint, **changes):
    return constraint.lower(MODEL).violation(point(**changes)) <= 1e-12


@pytest.mark.parametrize(
    ("constraint", "name", "inside", "outside"),
    [
        (FixedMasses({"link1": 2.5}), "link1.m", [2.5], [2.49, 2.51]),
        (FixedMasses({"link1": 0.0}), "link1.m", [0.0], [0.01]),
        (MassBounds({"link1": (1.0, 3.0)}), "link1.m", [1.0, 3.0], [0.99, 3.01]),
        (MassBounds({"link1": (-1.0, 0.0)}), "link1.m", [0.0], [0.01]),
        # Centres are 0.1, -0.2 and 0.3 m.
        (FixedCentresOfMass({"link1": [0.1, -0.2, 0.3]}), "link1.hy", [-0.4], [0.4]),
        (
            CentreOfMassBoxes({"link1": ([0.1, -0.2, 0.0], [0.2, 0.0, 0.3])}),
            "link1.hx",
            [0.2, 0.4],
            [0.19, 0.41],
        ),
        (
            CentreOfMassBoxes({"link1": ([0.1, -0.2, 0.0], [0.2, 0.0, 0.3])}),
            "link1.hz",
            [0.0, 0.6],
            [-0.01, 0.61],
        ),
        (TotalMass(3.0, 5.0), "link1.m", [1.0, 3.0], [0.99, 3.01]),
        (TotalMass(5.0, 5.0), "link1.m", [3.0], [2.99, 3.01]),
        (TotalMass(0.0, 3.0, ["link1"]), "link1.m", [3.0, 0.0], [3.01, -0.01]),
        (EqualLinks("link1", "link2"), "link1.hx", [0.2], [0.21, -0.2]),
        (FixedParameters({"joint1.viscous": 0.5}), "joint1.viscous", [0.5], [0.51]),
        (
            ParameterBounds({"joint1.drag": (-1.0, 2.0)}),
            "joint1.drag",
            [-1.0, 2.0],
            [-1.01, 2.01],
        ),
        (
            ParameterBounds({"joint1.drag": (-np.inf, 2.0)}),
            "joint1.drag",
            [-9.0],
            [2.1],
        ),
        (ParameterBounds({"joint1.drag": (1.0, np.inf)}), "joint1.drag", [9.0], [0.9]),
        (
            LinearRelation({"link1.m": 2.0, "link2.m": -1.0}, 1.0, 3.0),
            "link1.m",
            [1.5, 2.5],
            [1.49, 2.51],
        ),
        (
            LinearRelation({"link1.m": 2.0, "link2.m": -1.0}, 3.0, 3.0),
            "link1.m",
            [2.5],
            [2.49, 2.51],
        ),
        (NonNegativeDrive(), "joint1.viscous", [0.0, 1.0], [-0.01]),
        (NonNegativeDrive(), "joint1.drag", [0.0], [-0.01]),
        # Level 1 N m: at -2 and 1 rad, it is 1 - 2 s and 1 + s.
        (NonNegativeDrive(), "joint1.friction_slope", [0.5, -1.0], [0.51, -1.01]),
        (NonNegativeDrive(("viscous",)), "joint1.drag", [-9.0], []),
    ],
)
def test_a_constraint_holds_up_to_its_bounds_and_no_farther(
    constraint, name, inside, outside
):
    assert all(holds(constraint, **{name: value}) for value in inside)
    assert not any(holds(constraint, **{name: value}) for value in outside)


def test_drag_is_negative_as_far_as_friction_dissipates_at_three_radians_a_second():
    limited = NonNegativeDrive(dissipative=True)
    for drag, allowed in ((-0.5, True), (-0.51, False)):
        names = {"joint1.viscous": 1.5, "joint1.drag": drag}
        assert holds(limited, **names) is allowed
        assert not holds(NonNegativeDrive(), **names)


def test_symmetric_links_have_no_products_across_their_planes():
    plane = SymmetricLink("link1", ["y"])
    for name in ("hy", "Ixy", "Iyz"):
        assert not holds(plane, **{"link1.hy": 0.0, f"link1.{name}": 0.1})
    for name in ("hx", "hz", "Ixz", "Iyy"):
        assert holds(plane, **{"link1.hy": 0.0, f"link1.{name}": 0.1})


@pytest.mark.parametrize(
    "constraint",
    [
        MassBounds({"link1": (3.0, 2.9)}),
        MassBounds({"link1": (-2.0, -1e-9)}),
        TotalMass(-1e-9, 1.0),
        TotalMass(1.0, np.inf),
        TotalMass(1.1, 1.0),
        TotalMass(1.0, 2.0, []),
        TotalMass(1.0, 2.0, ["link1", "link1"]),
        ParameterBounds({"link1.m": (1.1, 1.0)}),
        FixedCentresOfMass({"link1": [0.0, 0.0]}),
        EqualLinks("link1", "link1"),
        SymmetricLink("link1", ["w"]),
    ],
)
def test_bounds_that_nothing_can_meet_are_refused(constraint):
    with pytest.raises(ProblemError):
        constraint.lower(MODEL)


def test_relations_need_terms_and_bounds_in_order():
    for values in (({}, 0.0, 1.0), ({"link1.m": 1.0}, 1.1, 1.0)):
        with pytest.raises(ProblemError, match="linear relation"):
            LinearRelation(*values)
    for value in (-1e-9, np.inf):
        with pytest.raises(ProblemError, match="fixed mass"):
            FixedMasses({"link1": value})


def test_rows_on_one_parameter_make_a_box_to_which_points_are_snapped():
    """``2 a <= 3``, ``-2 a <= 4``, ``-b <= 0``, ``4 c = 2``; rows of two make none."""
    rows = np.array([[2.0, 0, 0], [-2.0, 0, 0], [0, -1.0, 0], [1.0, 1.0, 0]])
    bounds = ConicSet.at_most(rows, np.array([3.0, 4.0, 0.0, 0.1]), "abcd")
    fixed = ConicSet.equal(np.array([[0, 0, 4.0]]), np.array([2.0]), "e")
    both = bounds & fixed
    low, high = both.box
    assert low.tolist() == [-2.0, 0.0, 0.5]
    assert high.tolist() == [1.5, np.inf, 0.5]
    assert both.snapped(np.array([9.0, -1.0, 0.0])).tolist() == [1.5, 0.0, 0.5]
    assert both.violation(np.array([1.0, 0.0, 0.75])) == 1.0
    assert both.violation(np.array([0.0, 0.25, 0.5])) == pytest.approx(0.15)
    assert both.violation(np.array([0.0, 0.0, 0.5])) == 0.0

"""Constraints on shape, symmetry and parameters: point masses as the truth."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from robots import random_body, random_robot, random_states

from consistent_id import (
    DHRow,
    DriveTerms,
    FixedMasses,
    InertialParameters,
    MassBounds,
    NonNegativeDrive,
    PhysicalConsistency,
    ProblemError,
    Recording,
    TorqueModel,
    build_regression,
    constrained_least_squares,
    from_modified_dh,
    load_problem,
    simulate_torque,
)
from consistent_id.constraints import (
    CentreOfMassIn,
    DensityOn,
    Ellipsoid,
    EqualLinks,
    LinearRelation,
    ParameterBounds,
    Polytope,
    SharedMotors,
    SymmetricLink,
    TotalMass,
)
from consistent_id.constraints.parameter_constraints import _dragged
from consistent_id.regression import GearCoupling
from consistent_id.robot import JointLimits

MODEL = TorqueModel(random_robot(np.random.default_rng(0), 2)[1])
LINK = MODEL.layout.links[0]
BALL = Ellipsoid([0.1, 0.0, -0.2], [0.3, 0.5, 0.2])
BOX = Polytope.box([-0.2, -0.1, 0.0], [0.4, 0.3, 0.5])


def _points(*masses_and_places):
    J = sum(m * np.outer([*r, 1.0], [*r, 1.0]) for m, r in masses_and_places)
    body = InertialParameters.from_pseudo_inertia(J)
    return np.concatenate([body.vector, np.zeros(10)])


def _slack(constraint, x):
    """Least slack of the lowered rows, or least eigenvalue of the lowered block."""
    domain = constraint.lower(MODEL)
    rows = domain.b_in - domain.A_in @ x
    eigenvalues = [np.linalg.eigvalsh(block.value(x))[0] for block in domain.blocks]
    return min([*rows, *eigenvalues])


places = st.tuples(*[st.floats(-1.0, 1.0)] * 3).map(np.array)


@pytest.mark.slow
@settings(max_examples=100, deadline=None)
@given(place=places, mass=st.floats(0.1, 10.0))
def test_a_point_mass_is_in_the_ellipsoid_iff_its_row_says_so(place, mass):
    inside = 1.0 - np.sum(((place - BALL.centre) / BALL.semi_axes) ** 2)
    # The row is the integral of exactly this quadratic.
    assert _slack(DensityOn(LINK, BALL), _points((mass, place))) == pytest.approx(
        mass * inside, abs=1e-9 * mass * (1 + abs(inside))
    )


@pytest.mark.slow
@settings(max_examples=100, deadline=None)
@given(first=places, second=places)
def test_the_centre_of_mass_is_in_the_shape_iff_the_constraint_holds(first, second):
    x = _points((1.0, first), (2.0, second))
    com = (first + 2.0 * second) / 3.0
    depth = 1.0 - np.linalg.norm((com - BALL.centre) / BALL.semi_axes)
    if abs(depth) > 1e-9:
        assert (_slack(CentreOfMassIn(LINK, BALL), x) > 0.0) == (depth > 0.0)
    margins = np.concatenate([com - [-0.2, -0.1, 0.0], [0.4, 0.3, 0.5] - com])
    expected = 3.0 * margins.min()
    assert _slack(CentreOfMassIn(LINK, BOX), x) == pytest.approx(expected, abs=1e-9)


def test_bodies_inside_a_polytope_satisfy_every_pair_of_facets():
    rng = np.random.default_rng(1)
    for _ in range(50):
        r = rng.uniform([-0.2, -0.1, 0.0], [0.4, 0.3, 0.5], (4, 3))
        x = _points(*zip(rng.uniform(0.1, 2.0, 4), r, strict=True))
        assert _slack(DensityOn(LINK, BOX), x) >= -1e-12


def test_a_body_wider_than_its_box_is_refused_though_its_centre_is_inside():
    x = _points((1.0, [-0.5, 0.1, 0.2]), (1.0, [0.7, 0.1, 0.2]))
    assert _slack(CentreOfMassIn(LINK, BOX), x) > 0.0
    assert _slack(DensityOn(LINK, BOX), x) < 0.0


def test_the_hull_of_a_boxes_corners_is_the_box():
    corners = (
        np.array(np.meshgrid([-0.2, 0.4], [-0.1, 0.3], [0.0, 0.5])).reshape(3, 8).T
    )
    hull = Polytope.hull(corners)
    assert {tuple(r) for r in hull.rows.round(9) + 0.0} == {
        tuple(r) for r in BOX.rows.round(9) + 0.0
    }


def test_points_in_a_plane_have_no_hull_and_boxes_must_not_be_inside_out():
    with pytest.raises(ProblemError, match="plane"):
        Polytope.hull(np.c_[np.random.default_rng(0).normal(size=(6, 2)), np.zeros(6)])
    with pytest.raises(ProblemError, match="box"):
        Polytope.box([0, 0, 1], [1, 1, 0])
    with pytest.raises(ProblemError, match="positive"):
        Ellipsoid([0, 0, 0], [1, 0, 1])


@pytest.mark.parametrize("mirror", [None, "x", "y", "z"])
def test_equal_links_are_equal_or_mirror_images(mirror):
    body = random_body(np.random.default_rng(2))
    M = np.eye(4)
    if mirror:
        M["xyz".index(mirror), "xyz".index(mirror)] = -1.0
    image = InertialParameters.from_pseudo_inertia(M @ body.pseudo_inertia @ M)
    domain = EqualLinks(*MODEL.layout.links, mirror=mirror).lower(MODEL)
    x = np.concatenate([body.vector, image.vector])
    assert np.allclose(domain.A_eq @ x, domain.b_eq, atol=1e-12)
    other = np.concatenate([body.vector, 1.1 * image.vector])
    assert not np.allclose(domain.A_eq @ other, domain.b_eq, atol=1e-3)


def test_a_symmetric_link_is_its_own_mirror_image():
    r = np.array([0.3, 0.2, 0.1])
    twins = _points((1.0, r), (1.0, r * [1, -1, 1]))
    domain = SymmetricLink(LINK, ["y"]).lower(MODEL)
    assert {label.split(" ")[0].split(".")[1] for label in domain.eq_labels} == {
        "hy",
        "Ixy",
        "Iyz",
    }
    assert np.allclose(domain.A_eq @ twins, 0.0)


def _data(truth):
    rng = np.random.default_rng(3)
    states = random_states(rng, 2, 400)
    log = Recording(MODEL.robot.joint_names, np.arange(400) / 100, *states)
    return build_regression(
        MODEL, simulate_torque(MODEL, truth, log, noise=1.0, rng=rng)
    )


@pytest.mark.slow
def test_every_constraint_holds_in_the_estimate_and_together():
    body = random_body(np.random.default_rng(4))
    regression = _data(np.concatenate([body.vector, body.vector]))
    a, b = MODEL.layout.links
    asked = [
        PhysicalConsistency(),
        TotalMass(5.0, 6.0),
        EqualLinks(a, b),
        ParameterBounds({f"{a}.hx": (-0.5, 0.5)}),
        LinearRelation({f"{a}.hy": 1.0, f"{a}.hz": -2.0}, 0.1, 0.1),
        CentreOfMassIn(a, Ellipsoid([0.1, 0.1, 0.0], [0.2, 0.2, 0.2])),
        DensityOn(a, Polytope.box([-2.0] * 3, [2.0] * 3)),
    ]
    estimate = constrained_least_squares(MODEL, regression, constraints=asked)
    assert estimate.certificate.verdict == "certified"
    x = estimate.parameters
    assert 5.0 - 1e-6 <= estimate[f"{a}.m"] + estimate[f"{b}.m"] <= 6.0 + 1e-6
    assert np.allclose(x[:10], x[10:], atol=1e-6)
    assert abs(estimate[f"{a}.hx"]) <= 0.5 + 1e-6
    assert estimate[f"{a}.hy"] - 2.0 * estimate[f"{a}.hz"] == pytest.approx(
        0.1, abs=1e-6
    )
    com = x[1:4] / x[0]
    assert np.linalg.norm((com - [0.1, 0.1, 0.0]) / 0.2) <= 1.0 + 1e-5
    assert _slack(asked[-1], x) >= -1e-5


def test_without_consistency_it_is_the_quadratic_programme():
    import cvxpy as cp

    _, robot = random_robot(np.random.default_rng(5), 2)
    regression = _data(robot.nominal)
    masses = dict(zip(MODEL.layout.links, robot.nominal[::10] * 1.3, strict=True))
    estimate = constrained_least_squares(
        MODEL, regression, constraints=[FixedMasses(masses)]
    )
    x = cp.Variable(20)
    R = regression.stacked()
    fixed = [
        x[0] == masses[MODEL.layout.links[0]],
        x[10] == masses[MODEL.layout.links[1]],
    ]
    best = cp.Problem(cp.Minimize(cp.sum_squares(R[:, :-1] @ x - R[:, -1])), fixed)
    least = np.sqrt(best.solve(solver=cp.CLARABEL))
    mine = np.linalg.norm(R @ [*estimate.parameters, -1.0])
    slack = estimate.certificate.figures["slack"]
    assert least * (1 - 1e-6) <= mine <= least * (1 + slack) * (1 + 1e-6)


@pytest.mark.parametrize(
    ("constraint", "message"),
    [
        (EqualLinks("a", "b"), "no link named 'a'"),
        (EqualLinks(LINK, LINK), "named twice"),
        (TotalMass(3.0, 2.0), "expected 0 <= lower"),
        (ParameterBounds({f"{LINK}.m": (2.0, 1.0)}), "not below"),
        (DensityOn("a", BALL), "no link named 'a'"),
        (MassBounds({LINK: (-2.0, -1.0)}), "-1 kg, which no body has"),
    ],
)
def test_constraints_that_make_no_sense_are_refused(constraint, message):
    with pytest.raises(ProblemError, match=message):
        constraint.lower(MODEL)


def test_a_problem_file_can_ask_for_all_of_them(tmp_path):
    (tmp_path / "problem.toml").write_text(
        """
name = "arm"
[model]
modified_dh = [{ alpha_deg = 0, a = 0 }, { alpha_deg = -90, a = 0.3 }]
[constraints]
masses = "free"
total_mass = [3, 9]
bounds = { "link1.Izz" = [0, 1] }
relations = [{ terms = { "link1.m" = 1, "link2.m" = -1 }, lower = 0 }]
symmetric = { link2 = ["y"] }
[[constraints.centre_of_mass_in]]
link = "link1"
ellipsoid = { centre = [0,0,0], semi_axes = [1,1,1] }
[[constraints.density_on]]
link = "link2"
box = [[-1,-1,-1], [1,1,1]]
"""
    )
    kinds = [type(c).__name__ for c in load_problem(tmp_path).constraints]
    assert kinds == [
        "PhysicalConsistency",
        "NonNegativeDrive",
        "ParameterBounds",
        "TotalMass",
        "LinearRelation",
        "SymmetricLink",
        "CentreOfMassIn",
        "DensityOn",
    ]


def test_signs_hold_for_springs_and_leave_coupled_gears_alone():
    table = [DHRow(0.0, 0.1), DHRow(1.0, 0.1)]
    drive = DriveTerms(viscous=True, offset=True, spring=True)
    coupling = GearCoupling("joint1", "joint2", viscous=True, rotor_inertia=True)
    model = TorqueModel(from_modified_dh("arm", table), drive, (coupling,))
    assert set(NonNegativeDrive().lower(model).in_labels) == {
        f"joint{j}.{term} >= 0" for j in (1, 2) for term in ("viscous", "spring")
    }
    named = NonNegativeDrive(("coupling_viscous",)).lower(model)
    assert named.in_labels == ("joint1+joint2.coupling_viscous >= 0",)


def test_drag_may_be_negative_as_far_as_friction_dissipates_at_the_speed_limit():
    limited, free = (
        from_modified_dh("arm", [DHRow(0.0, 0.1, limits=JointLimits(velocity=v))])
        for v in (2.0, np.inf)
    )
    terms = DriveTerms(viscous=True, coulomb="sign", drag=True)
    able = NonNegativeDrive(dissipative=True)
    domain = able.lower(TorqueModel(limited, terms))
    assert "joint1.viscous + 2 joint1.drag >= 0" in domain.in_labels
    x = np.zeros(13)
    x[10:] = 0.4, -0.19, 1.0  # viscous, drag, Coulomb
    assert (domain.A_in @ x <= domain.b_in).all()
    x[11] = -0.21
    assert not (domain.A_in @ x <= domain.b_in).all()
    plain = able.lower(TorqueModel(free, terms))
    alone = able.lower(TorqueModel(limited, DriveTerms(drag=True)))
    strict = NonNegativeDrive().lower(TorqueModel(limited, terms))
    for other in (plain, alone, strict):
        assert "joint1.drag >= 0" in other.in_labels


def _wrist(rotor=True):
    table = [DHRow(0.0, 0.1), DHRow(1.0, 0.1)]
    drive = DriveTerms(viscous=True, rotor_inertia=rotor)
    coupling = GearCoupling("joint1", "joint2", True, "sign", rotor_inertia=True)
    return TorqueModel(from_modified_dh("wrist", table), drive, (coupling,))


def test_a_motor_that_turns_with_the_sum_is_part_of_what_both_joints_have():
    model = _wrist()
    domain = SharedMotors().lower(model)
    names = list(model.layout.names[20:])
    x = np.zeros(len(model.layout))
    # Motor 1 on joint 1 alone, motor 2 on the sum of rates: viscous, inertia.
    first, second = np.array([0.3, 0.02]), np.array([0.5, 0.04])
    x[20:24] = [*(first + second), *second]
    x[24:] = [second[0], 0.7, second[1]]
    assert names[4:] == [
        f"joint1+joint2.coupling_{t}" for t in ("viscous", "coulomb", "rotor_inertia")
    ]
    assert (domain.A_in @ x <= domain.b_in + 1e-15).all()
    for place, value in ((24, 0.6), (24, -0.1), (25, -0.1), (26, 0.05), (26, -0.01)):
        wrong = x.copy()
        wrong[place] = value
        assert (domain.A_in @ wrong > domain.b_in).sum() == 1


@pytest.mark.parametrize(
    ("model", "message"),
    [
        (MODEL, "no gear coupling"),
        (_wrist(rotor=False), "no parameter named 'joint1.rotor_inertia'"),
    ],
)
def test_shared_motors_without_a_coupling_or_a_term_are_refused(model, message):
    with pytest.raises(ProblemError, match=message):
        SharedMotors().lower(model)


def test_a_problem_file_has_locks_springs_and_couplings(tmp_path):
    links = "".join(f'<link name="l{k}"/>' for k in range(4))
    joints = "".join(
        f'<joint name="j{k}" type="continuous"><parent link="l{k}"/>'
        f'<child link="l{k + 1}"/><origin xyz="0.1 0 0"/></joint>'
        for k in range(3)
    )
    (tmp_path / "arm.urdf").write_text(f'<robot name="arm">{links}{joints}</robot>')
    (tmp_path / "problem.toml").write_text(
        """
name = "arm"
[model]
urdf = "arm.urdf"
joints = ["j0", "j1"]
locked = { j2 = 0.5 }
[drive]
spring = true
[[couplings]]
first = "j0"
second = "j1"
coulomb = "tanh"
velocity_scale = 0.1
[constraints]
masses = "free"
"""
    )
    model = load_problem(tmp_path).model
    assert model.robot.joint_names == ("j0", "j1")
    assert model.layout.names[20:] == (
        "j0.spring",
        "j1.spring",
        "j0+j1.coupling_coulomb",
    )


def test_a_wrong_name_in_a_problem_files_constraints_is_found_at_once(tmp_path):
    (tmp_path / "problem.toml").write_text(
        'name = "arm"\n[model]\nmodified_dh = [{ alpha_deg = 0, a = 0 }]\n'
        '[constraints]\nmasses = "free"\nfixed = { "link1.mass" = 1 }\n'
    )
    with pytest.raises(ProblemError, match=r"link1\.mass"):
        load_problem(tmp_path)


@pytest.mark.parametrize("value", [0.4, 0.5, 1.0, 2.0, 2.1])
def test_a_linear_relation_holds_between_its_bounds_and_nowhere_else(value):
    relation = LinearRelation({f"{LINK}.m": 2.0, f"{LINK}.hx": -1.0}, 0.5, 2.0)
    x = np.zeros(len(MODEL.layout))
    x[MODEL.layout.index(f"{LINK}.m")] = 1.0
    x[MODEL.layout.index(f"{LINK}.hx")] = 2.0 - value
    missed = max(0.5 - value, value - 2.0, 0.0)
    assert relation.lower(MODEL).violation(x) == pytest.approx(missed, abs=1e-15)


@pytest.mark.parametrize(("low", "high"), [(0.5, np.inf), (-np.inf, 0.5)])
def test_a_linear_relation_with_one_bound_has_one_row_of_the_right_sign(low, high):
    domain = LinearRelation({f"{LINK}.m": 1.0}, low, high).lower(MODEL)
    x = np.zeros(len(MODEL.layout))
    for mass in (0.2, 0.9):
        x[MODEL.layout.index(f"{LINK}.m")] = mass
        inside = low <= mass <= high
        assert (domain.violation(x) == 0.0) is inside
    assert len(domain.b_in) == 1


@pytest.mark.parametrize("mass", [-1.0, np.nan, np.inf])
def test_a_fixed_mass_that_no_body_has_is_refused(mass):
    with pytest.raises(ProblemError, match=f"fixed mass of {LINK}: {mass:g} kg"):
        FixedMasses({LINK: mass})


def test_mass_bounds_that_are_equal_fix_the_mass():
    domain = MassBounds({LINK: (2.0, 2.0)}).lower(MODEL)
    low, high = domain.box
    place = MODEL.layout.index(f"{LINK}.m")
    assert low[place] == high[place] == 2.0
    x = np.zeros(len(MODEL.layout))
    x[place] = 2.0
    assert domain.violation(x) == 0.0


@pytest.mark.parametrize("limit", [0.4, 3.0])
def test_drag_may_be_negative_up_to_a_joints_speed_limit_however_low(limit):
    robot = from_modified_dh("arm", [DHRow(0, 0)])
    (joint,) = robot.joints
    limits = replace(joint.limits, velocity=limit)
    robot = replace(robot, joints=(replace(joint, limits=limits),))
    model = TorqueModel(robot, DriveTerms(viscous=True, drag=True))
    assert _dragged(model) == {"joint1.drag": ("joint1.viscous", limit)}

"""Ellipsoids, polytopes and hulls of meshes."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from robots import random_robot

from consistent_id import ProblemError, TorqueModel
from consistent_id.constraints import DensityOn, Ellipsoid, Polytope, mesh_vertices
from consistent_id.robot import solids
from consistent_id.robot.solids import mesh_triangles

CUBE = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)


def _stl(path, points):
    from scipy.spatial import ConvexHull

    facets = [
        "facet normal 0 0 0\nouter loop\n"
        + "".join(f"vertex {x} {y} {z}\n" for x, y, z in points[corners])
        + "endloop\nendfacet\n"
        for corners in ConvexHull(points).simplices
    ]
    path.write_text("solid part\n" + "".join(facets) + "endsolid part\n")
    return path


def test_the_ellipsoid_around_a_cube_is_the_ball_through_its_corners():
    ball = Ellipsoid.around(CUBE)
    assert ball.centre == pytest.approx([0.5] * 3, abs=1e-4)
    assert ball.semi_axes == pytest.approx([np.sqrt(0.75)] * 3, rel=1e-4)


def test_the_ellipsoid_around_a_stretched_cube_stretches_with_it():
    # The smallest ellipsoid is affinely invariant.
    stretch = np.array([1.0, 3.0, 0.2])
    ball = Ellipsoid.around(CUBE * stretch)
    assert np.sort(ball.semi_axes) == pytest.approx(
        np.sort(np.sqrt(0.75) * stretch), rel=1e-4
    )


@pytest.mark.slow
@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**31))
def test_the_ellipsoid_contains_every_point_and_touches_some(seed):
    points = np.random.default_rng(seed).normal(size=(30, 3)) * [1.0, 2.0, 0.3]
    ellipsoid = Ellipsoid.around(points)
    inside = np.column_stack([points, np.ones(30)])
    left = np.einsum("ia,ab,ib->i", inside, ellipsoid.quadratic, inside)
    assert left.min() == pytest.approx(0.0, abs=1e-9)
    assert (left <= 1e-3).sum() >= 4


def test_a_mesh_is_read_in_metres(tmp_path):
    file = _stl(tmp_path / "cube.stl", 1000.0 * CUBE)
    vertices = mesh_vertices(file, scale=0.001)
    assert vertices.min(axis=0) == pytest.approx([0.0] * 3, abs=1e-9)
    assert vertices.max(axis=0) == pytest.approx([1.0] * 3)
    assert len(Polytope.hull(vertices).normals) == 6


def test_points_of_the_hull_inside_the_ellipsoid_do_not_move_it():
    cube = 2.0 * np.array(CUBE) - 1.0
    bumps = [[1.3, 0.2, 0.1], [1.2, -0.3, 0.0], [0.1, 1.4, 0.0], [0.0, 0.0, 1.1]]
    ball = Ellipsoid.around(np.vstack([bumps, cube]))
    np.testing.assert_allclose(ball.centre, 0.0, atol=1e-4)
    np.testing.assert_allclose(ball.semi_axes, np.sqrt(3.0), rtol=1e-4)


@pytest.mark.parametrize("content", [None, "garbage", ""])
def test_what_is_no_mesh_is_refused_with_its_file(tmp_path, content):
    file = tmp_path / "part.stl"
    if content is not None:
        file.write_text(content)
    with pytest.raises(ProblemError, match=r"part\.stl: no mesh could be read"):
        mesh_vertices(file)


def test_a_scale_that_is_none_is_refused(tmp_path):
    for scale in (0.0, np.inf):
        with pytest.raises(ProblemError, match=f"scale is {scale}"):
            mesh_vertices(tmp_path / "part.stl", scale=scale)


def test_a_polytope_without_inside_is_refused():
    normals = np.vstack([np.eye(3), -np.eye(3)])
    with pytest.raises(ProblemError, match="no room"):
        Polytope(normals, [1, 1, 1, 0, 0, -2])


def test_a_polytope_without_end_is_refused():
    normals = np.vstack([np.eye(3), -np.eye(3)[:2]])
    with pytest.raises(ProblemError, match="do not close it"):
        Polytope(normals, [1, 1, 1, 0, 0])


def test_a_hull_of_too_many_facets_is_refused_for_densities_with_the_way_out():
    points = np.random.default_rng(0).normal(size=(200, 3))
    ball = Polytope.hull(points / np.linalg.norm(points, axis=1)[:, None])
    model = TorqueModel(random_robot(np.random.default_rng(0), 1)[1])
    with pytest.raises(ProblemError, match=r"Ellipsoid\.around"):
        DensityOn(model.layout.links[0], ball).lower(model)


@pytest.mark.parametrize("sides", [38, 39])
def test_forty_facets_are_not_too_many(sides):
    angle = 2.0 * np.pi * np.arange(sides) / sides
    round_ones = np.column_stack([np.cos(angle), np.sin(angle), 0.0 * angle])
    prism = Polytope([*round_ones, [0, 0, 1], [0, 0, -1]], np.ones(sides + 2))
    model = TorqueModel(random_robot(np.random.default_rng(0), 1)[1])
    density = DensityOn(model.layout.links[0], prism)
    if sides + 2 > 40:
        with pytest.raises(ProblemError, match="has 41 facets"):
            density.lower(model)
    else:
        assert len(density.lower(model).b_in) >= 40 * 39 / 2  # a row for each pair


def test_a_problem_file_may_name_a_mesh(tmp_path):
    from consistent_id import load_problem
    from consistent_id.constraints import CentreOfMassIn

    _stl(tmp_path / "part.stl", CUBE)
    (tmp_path / "problem.toml").write_text(
        """
name = "arm"
[[model.modified_dh]]
alpha_deg = 0.0
a = 0.0
[links.link1]
mass = 1.0
[[constraints.centre_of_mass_in]]
link = "link1"
mesh = "part.stl"
[[constraints.density_on]]
link = "link1"
mesh = "part.stl"
mesh_shape = "ellipsoid"
"""
    )
    problem = load_problem(tmp_path)
    shapes = [c.shape for c in problem.constraints if hasattr(c, "shape")]
    assert isinstance(shapes[0], Polytope)
    assert isinstance(shapes[1], Ellipsoid)
    assert any(isinstance(c, CentreOfMassIn) for c in problem.constraints)


def test_shapes_without_extent_or_with_bent_axes_are_refused():
    ball = Ellipsoid(np.zeros(3), [1.0, 2.0, 3.0])
    np.testing.assert_allclose(ball.unit_map, np.diag([1.0, 1 / 2.0, 1 / 3.0]))
    for changes, message in (
        ({"semi_axes": [1.0, 0.0, 1.0]}, "expected positive"),
        ({"semi_axes": [1.0, -1.0, 1.0]}, "expected positive"),
        ({"rotation": (1.0 + 6e-10) * np.eye(3)}, "not orthonormal"),
    ):
        values = {"centre": np.zeros(3), "semi_axes": np.ones(3)} | changes
        with pytest.raises(ProblemError, match=message):
            Ellipsoid(**values)
    Ellipsoid(np.zeros(3), np.ones(3), (1.0 + 4e-10) * np.eye(3))
    with pytest.raises(ProblemError, match="is not below upper"):
        Polytope.box([0, 0, 0], [1, 0, 1])
    with pytest.raises(ProblemError, match="normal is zero"):
        Polytope(np.vstack([np.eye(3), -np.eye(3), np.zeros(3)]), np.ones(7))


def test_a_box_has_its_corners_and_a_facet_at_its_distance():
    box = Polytope.box([-1.0, 0.0, 2.0], [1.0, 4.0, 3.0])
    for point, least in (
        ([0.0, 2.0, 2.5], 0.5),
        ([1.0, 4.0, 3.0], 0.0),
        ([1.5, 2.0, 2.5], -0.5),
        ([0.0, 2.0, 1.0], -1.0),
    ):
        assert (box.rows @ [*point, 1.0]).min() == pytest.approx(least)
    double = Polytope(2.0 * box.normals, 2.0 * box.offsets)
    np.testing.assert_allclose(double.rows, box.rows)


@pytest.mark.parametrize("seed", range(3))
def test_an_ellipsoid_is_found_again_from_its_quadratic(seed):
    rng = np.random.default_rng(seed)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    whole = Ellipsoid(rng.normal(size=3), rng.uniform(0.5, 2.0, 3), turn)
    again = Ellipsoid.from_quadratic(3.0 * whole.quadratic)
    np.testing.assert_allclose(again.centre, whole.centre, atol=1e-12)
    np.testing.assert_allclose(np.sort(again.semi_axes), np.sort(whole.semi_axes))
    np.testing.assert_allclose(again.quadratic, whole.quadratic, atol=1e-12)
    assert np.linalg.det(again.rotation) == pytest.approx(1.0)
    for sign, message in ((-1.0, "curvatures"), (0.0, "curvatures")):
        with pytest.raises(ProblemError, match=message):
            Ellipsoid.from_quadratic(sign * whole.quadratic)
    with pytest.raises(ProblemError, match="positive nowhere"):
        Ellipsoid.from_quadratic(np.diag([-1.0, -1.0, -1.0, 0.0]))


def test_the_faces_of_a_mesh_have_its_surface(tmp_path):
    corners = mesh_triangles(_stl(tmp_path / "cube.stl", 2.0 * CUBE))
    assert corners.shape == (12, 3, 3)
    sides = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert np.linalg.norm(sides, axis=1).sum() / 2.0 == pytest.approx(24.0)


@pytest.mark.parametrize("seed", [0, 1])
def test_the_ellipsoid_around_points_is_the_smallest(seed):
    """John: points on it are weighted to the centre, and to a ball's second moments."""
    from scipy.optimize import nnls

    points = np.random.default_rng(seed).normal(size=(25, 3)) * [1e-3, 20.0, 0.3] + 5.0
    found = Ellipsoid.around(points)
    y = (points - found.centre) @ found.unit_map.T
    touching = y[np.linalg.norm(y, axis=1) > 1.0 - 1e-6]
    sums = [np.append(p, np.outer(p, p)[np.triu_indices(3)]) for p in touching]
    _, off = nnls(
        np.transpose(sums), np.append(np.zeros(3), np.eye(3)[np.triu_indices(3)])
    )
    assert len(touching) >= 4 and off < 1e-5


def test_a_quadratic_that_is_open_in_one_direction_is_no_ellipsoid():
    for curvature in (0.0, 0.5):
        with pytest.raises(ProblemError, match="expected negative ones"):
            Ellipsoid.from_quadratic(np.diag([-4.0, curvature, -1.0, 1.0]))


def test_a_mesh_is_in_metres_if_nothing_else_is_said(tmp_path):
    file = _stl(tmp_path / "cube.stl", CUBE)
    assert mesh_vertices(file).max(axis=0).tolist() == [1.0] * 3
    assert mesh_triangles(file).max() == 1.0


@pytest.mark.parametrize("missing", range(6))
def test_a_box_without_one_of_its_facets_is_not_closed(missing):
    normals = np.delete(np.vstack([np.eye(3), -np.eye(3)]), missing, axis=0)
    with pytest.raises(ProblemError, match="5 facets do not close it"):
        Polytope(normals, np.ones(5))


def test_the_search_for_an_ellipsoid_ends_where_no_point_is_far(monkeypatch):
    """So far from the end, it is the ellipsoid of equal weights, swollen."""
    monkeypatch.setattr(solids, "_ROUND", 2.0)
    points = np.vstack([CUBE * [1.0, 2.0, 3.0], [[0.5, 1.0, 3.4]]])
    found = Ellipsoid.around(points)
    assert found.centre == pytest.approx(points.mean(axis=0))
    offset = points - found.centre
    squares = np.einsum("ia,ia->i", offset @ np.linalg.inv(np.cov(offset.T)), offset)
    volume = np.sqrt(np.linalg.det(np.cov(offset.T) * squares.max()))
    assert np.prod(found.semi_axes) == pytest.approx(volume)

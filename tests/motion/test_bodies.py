"""Shapes know their farthest points, and pieces of a mesh cover it."""

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from consistent_id import ProblemError
from consistent_id.motion import (
    Body,
    Box,
    Capsule,
    Cylinder,
    HalfSpace,
    Hull,
    Sphere,
    plane,
)
from consistent_id.motion.collisions.urdf_bodies import convex_pieces

CORNERS = np.array([[x, y, z] for x in (0, 1) for y in (0, 2) for z in (0, 3)])
BOX_FACES = [
    (0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1),
    (2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3),
]  # fmt: skip


def _points(shape, rng):
    """Points on the surface of a shape, or beyond no part of it."""
    unit = rng.normal(size=(400, 3))
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    match shape:
        case Sphere(radius):
            return radius * unit
        case Box(size):
            return rng.uniform(-0.5, 0.5, (400, 3)) * size
        case Capsule(radius, length):
            along = rng.uniform(-0.5, 0.5, 400) * length
            return radius * unit + np.outer(along, [0, 0, 1])
        case Cylinder(radius, length):
            flat = unit * [1, 1, 0]
            flat *= radius / np.linalg.norm(flat, axis=1, keepdims=True)
            return flat + np.outer(rng.uniform(-0.5, 0.5, 400) * length, [0, 0, 1])
    inner = rng.dirichlet(np.ones(len(shape.points)), 400) @ shape.points
    return np.concatenate([shape.points, inner])


SHAPES = [
    Sphere(0.3),
    Box((0.2, 0.4, 0.9)),
    Capsule(0.1, 0.5),
    Cylinder(0.2, 0.7),
    Hull(np.random.default_rng(1).normal(size=(12, 3))),
]


@pytest.mark.parametrize("shape", SHAPES, ids=lambda shape: type(shape).__name__)
def test_no_point_of_a_shape_is_beyond_its_farthest_or_its_ball(shape):
    rng = np.random.default_rng(0)
    points, directions = _points(shape, rng), rng.normal(size=(50, 3))
    directions[:3] = np.eye(3)
    farthest = shape.farthest(directions)
    reach = np.einsum("ni,ni->n", farthest, directions)
    inside = points @ directions.T
    assert (inside <= reach + 1e-12).all()
    # Nor is the shape smaller than it says.
    extent = np.ptp(inside, axis=0)
    assert (inside.max(axis=0) > reach - 0.35 * extent).all()
    centre, radius = shape.ball
    for some in (points, farthest):
        assert (np.linalg.norm(some - centre, axis=1) <= radius + 1e-12).all()


def test_a_hull_keeps_only_its_corners():
    inner = np.random.default_rng(0).uniform(0.1, 0.9, (20, 3)) * [1, 2, 3]
    hull = Hull(np.concatenate([CORNERS, inner]))
    assert sorted(map(tuple, hull.points.tolist())) == sorted(map(tuple, CORNERS))


def test_what_is_flat_or_has_no_size_is_refused():
    with pytest.raises(ProblemError, match=r"lie in a plane.*thin box"):
        Hull(CORNERS[:4])
    with pytest.raises(ProblemError, match=r"capsule: length is -1"):
        Capsule(0.1, -1.0)
    with pytest.raises(ProblemError, match="expected a rotation matrix"):
        Body("mirror", Sphere(1.0), rotation=np.diag([1.0, 1.0, -1.0]))
    with pytest.raises(ProblemError, match="half-space cannot move with 'link1'"):
        Body("floor", HalfSpace(), "link1")


def test_a_planes_surface_is_its_height_along_its_normal():
    wall = plane(0.5, (3.0, 0.0, 4.0), "wall")
    assert np.allclose(wall.rotation[:, 2], [0.6, 0.0, 0.8])
    assert np.allclose(wall.rotation.T @ wall.rotation, np.eye(3))
    assert np.isclose(wall.translation @ [0.6, 0.0, 0.8], 0.5)


def _box_surface(size, place):
    return (CORNERS / [1, 2, 3] * size + place)[np.array(BOX_FACES)]


def test_an_angle_is_cut_where_that_saves_most():
    foot, upright = (
        _box_surface([4, 1, 1.1], [0, 0, 0]),
        _box_surface([1, 1, 2.9], [0, 0, 1.1]),
    )
    angle = np.concatenate([foot, upright])
    pieces = convex_pieces(angle, 4)
    assert len(pieces) == 2
    volume = sum(_volume(piece) for piece in pieces)
    assert 4 * 1.1 + 2.9 <= volume < 0.7 * _volume(angle)


def test_what_is_convex_stays_in_one_piece():
    assert len(convex_pieces(_box_surface([1, 2, 3], [0, 0, 0]), 8)) == 1


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_pieces_cover_the_whole_surface(seed):
    rng = np.random.default_rng(seed)
    sizes, corners = rng.uniform(0.2, 2, (4, 3)), rng.uniform(-1, 1, (4, 3))
    parts = [_box_surface(*box) for box in zip(sizes, corners, strict=True)]
    surface = np.concatenate(parts) @ np.linalg.qr(rng.normal(size=(3, 3)))[0]
    pieces = convex_pieces(surface, 5, gain=0.01)
    assert len(pieces) > 1
    weights = rng.dirichlet(np.ones(3), (len(surface), 20))
    points = np.einsum("tkc,tci->tki", weights, surface).reshape(-1, 3)
    inside = np.zeros(len(points), dtype=bool)
    for piece in pieces:
        faces = ConvexHull(piece).equations
        inside |= (points @ faces[:, :3].T + faces[:, 3] <= 1e-9).all(axis=1)
    assert inside.all()


def _volume(points):
    return ConvexHull(points.reshape(-1, 3)).volume

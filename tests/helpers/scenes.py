"""Random robots with random bodies."""

from itertools import combinations

import numpy as np
from robots import random_robot

from consistent_id.motion import (
    Body,
    Box,
    Capsule,
    Cylinder,
    Hull,
    Scene,
    Sphere,
    plane,
)
from consistent_id.motion.collisions.scene import Pair


def random_shape(rng, round_only=False):
    sizes = rng.uniform(0.05, 0.3, 3)
    kinds = [Sphere(sizes[0]), Capsule(sizes[0], sizes[1])]
    if not round_only:
        kinds += [
            Box(tuple(sizes)),
            Cylinder(sizes[0], sizes[1]),
            Hull(sizes * rng.normal(size=(10, 3))),
        ]
    return kinds[rng.integers(len(kinds))]


def random_scene(rng, joints=4, tree=True, round_only=False):
    """A robot with a body on each link, a stone, a wall, and all of their pairs."""
    _, robot = random_robot(rng, joints, tree)
    bodies = [plane(-2.0, rng.normal(size=3), "wall")]
    stone = random_shape(rng, round_only)
    bodies.append(Body("stone", stone, translation=rng.normal(size=3)))
    for link in robot.link_names:
        turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        turn[:, 0] *= np.sign(np.linalg.det(turn))
        shape = random_shape(rng, round_only)
        bodies.append(Body(f"on {link}", shape, link, turn, rng.normal(size=3)))
    pairs = [Pair(i, j) for i, j in combinations(range(len(bodies)), 2) if j > 1]
    return Scene(robot, tuple(bodies), tuple(pairs))

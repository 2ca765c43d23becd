"""What an MJCF file states of its bodies' inertias, and the solids of their shapes."""

from collections.abc import Collection
from typing import Any

import numpy as np

from consistent_id._support.arrays import Array
from consistent_id.export.mjcf_body import require_mujoco, rotation_of
from consistent_id.export.repair.cause_search import LinkStatement
from consistent_id.export.repair.file_evidence import FileEvidence
from consistent_id.export.repair.link_solid import LinkSolid, directions, hull_solid
from consistent_id.robot.loaders.urdf_inertial import inertia_matrix


def mjcf_evidence(spec: Any, model: Any, blind: Collection[str]) -> FileEvidence:
    """Return what a specification states, and its shapes.

    Parameters
    ----------
    spec : mujoco.MjSpec
    model : mujoco.MjModel
        The specification, compiled.
    blind : collection of str
        Bodies with a shape that could not be read.
    """
    statements, solids = {}, {}
    for body in spec.bodies:
        b = int(body.id)
        # Inertias that MuJoCo computes from shapes have no mistakes.
        if b <= 0 or not body.explicitinertial or model.body_mass[b] <= 0.0:
            continue
        name = body.name or f"body{b}"
        statements[name] = _statement(name, body, model, b)
        solid = None if body.name in blind else _solid(model, b)
        if solid is not None:
            solids[name] = solid
    bodies = tuple(one.body(one.stated) for one in statements.values())
    return FileEvidence(statements, bodies, solids)


def _statement(name: str, body: Any, model: Any, b: int) -> LinkStatement:
    mass, com = float(model.body_mass[b]), np.array(model.body_ipos[b])
    if np.isfinite(body.fullinertia[0]):
        xx, yy, zz, xy, xz, yz = body.fullinertia
        inertia = inertia_matrix([xx, xy, xz, yy, yz, zz])
        return LinkStatement(name, mass, com, np.eye(3), inertia)
    axes = rotation_of(model.body_iquat[b])
    return LinkStatement(name, mass, com, axes, np.diag(model.body_inertia[b]))


def _solid(model: Any, b: int) -> LinkSolid | None:
    """Return the hull of a body's shapes; None if one of them has no end."""
    clouds = []
    for g in np.flatnonzero(model.geom_bodyid == b):
        points = _points(model, int(g))
        if points is None:
            return None
        clouds.append(points @ rotation_of(model.geom_quat[g]).T + model.geom_pos[g])
    return hull_solid(np.vstack(clouds)) if clouds else None


def _points(model: Any, g: int) -> Array | None:
    """Return points of a shape whose hull is the shape, in its own frame."""
    kinds = require_mujoco().mjtGeom
    kind, size = kinds(int(model.geom_type[g])), model.geom_size[g]
    around = directions()
    if kind == kinds.mjGEOM_MESH:
        mesh = int(model.geom_dataid[g])
        first = int(model.mesh_vertadr[mesh])
        vertices = model.mesh_vert[first : first + int(model.mesh_vertnum[mesh])]
        return np.asarray(vertices, dtype=np.float64)
    if kind == kinds.mjGEOM_BOX:
        return np.asarray(np.sign(around[-8:]) * size)
    if kind in (kinds.mjGEOM_SPHERE, kinds.mjGEOM_CAPSULE):
        half = size[1] if kind == kinds.mjGEOM_CAPSULE else 0.0
        ends = np.outer(np.sign(around[:, 2]), [0.0, 0.0, half])
        return np.asarray(around * size[0] + ends)
    if kind == kinds.mjGEOM_ELLIPSOID:
        return np.asarray(around * size)
    if kind == kinds.mjGEOM_CYLINDER:
        flat = np.linalg.norm(around[:, :2], axis=1, keepdims=True)
        rim = around[:, :2] / np.maximum(flat, 1e-9) * size[0]
        height = np.sign(around[:, 2:]) * size[1]
        return np.hstack([rim, height])
    return None

"""An MJCF file as the lint sees it: as MuJoCo compiles it."""

from collections.abc import Collection
from pathlib import Path
from typing import Any

import numpy as np

from consistent_id._support.arrays import Array
from consistent_id._support.extras import needed
from consistent_id.errors import ModelError
from consistent_id.export.lint.described import DescribedLink, DescribedRobot
from consistent_id.export.mjcf_body import require_mujoco
from consistent_id.export.repair.cause_search import LinkStatement
from consistent_id.export.repair.file_evidence import FileEvidence
from consistent_id.export.repair.link_solid import LinkSolid, directions, hull_solid
from consistent_id.robot.loaders.mjcf import compiled_body, load_mjcf, quaternion_matrix
from consistent_id.robot.loaders.mjcf_assets import stand_in
from consistent_id.robot.loaders.urdf_inertial import inertia_matrix
from consistent_id.robot.loaders.xml import Element


def described_mjcf(path: Path, root: Element) -> tuple[DescribedRobot, FileEvidence]:
    """Return what an MJCF file describes, and what it says of mistakes.

    Raises
    ------
    ModelError
        If MuJoCo is not installed, or refuses the file.
    """
    mujoco = needed("mujoco", "mjcf", f"{path}: reading MJCF", ModelError)
    try:
        spec = mujoco.MjSpec.from_file(str(path))
        unseen = set(stand_in(spec, path, mujoco))
        model = spec.compile()
    except (ValueError, mujoco.FatalError) as cause:
        raise ModelError(f"{path}: MuJoCo refuses it: {cause}") from None
    blind = {
        body.name
        for body in spec.bodies
        if any(geom.meshname in unseen for geom in body.geoms)
    }
    lines = _lines(root, "body")
    links = [
        _link(model, b, lines.get(model.body(b).name, 1), blind)
        for b in range(1, model.nbody)
        if model.body_mass[b] > 0.0
    ]
    try:
        robot = load_mjcf(path)
    except ModelError:
        robot = None  # a free base, or joints that are coupled
    described = DescribedRobot(tuple(links), robot, _lines(root, "joint"))
    return described, mjcf_evidence(spec, model, blind)


def _link(model: Any, b: int, line: int, blind: set[str]) -> DescribedLink:
    body, name = compiled_body(model, b), model.body(b).name or f"body{b}"
    com = np.array(model.body_ipos[b])
    geoms = [g for g in range(model.ngeom) if model.geom_bodyid[g] == b]
    # A shape is within a ball about its centre; so this is the reach, or more.
    reach = [
        float(np.linalg.norm(model.geom_pos[g] - com) + model.geom_rbound[g])
        for g in geoms
    ]
    children = [c for c in range(b + 1, model.nbody) if model.body_parentid[c] == b]
    places = [np.zeros(3), *(model.body_pos[c] for c in children)]
    before = float(np.linalg.norm(model.body_pos[b]))
    seen = bool(reach) and name not in blind
    return DescribedLink(
        name,
        line,
        float(model.body_mass[b]),
        com,
        body.central_inertia,
        max(reach) if seen else None,
        max(before, *(float(np.linalg.norm(place - com)) for place in places)),
    )


def _lines(root: Element, tag: str) -> dict[str, int]:
    found = (e for e in root.below(without=("default",)) if e.tag == tag)
    return {element.name: element.line for element in found if element.name}


def mjcf_evidence(spec: Any, model: Any, blind: Collection[str]) -> FileEvidence:
    """Return what a specification states, and its shapes.

    Parameters
    ----------
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
    axes = quaternion_matrix(model.body_iquat[b])
    return LinkStatement(name, mass, com, axes, np.diag(model.body_inertia[b]))


def _solid(model: Any, b: int) -> LinkSolid | None:
    """Return the hull of a body's shapes; None if one of them has no end."""
    clouds = []
    for g in np.flatnonzero(model.geom_bodyid == b):
        points = _points(model, int(g))
        if points is None:
            return None
        clouds.append(
            points @ quaternion_matrix(model.geom_quat[g]).T + model.geom_pos[g]
        )
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

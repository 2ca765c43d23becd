"""An MJCF file as the lint sees it: as MuJoCo compiles it."""

from pathlib import Path
from typing import Any

import numpy as np

from consistent_id._support.extras import needed
from consistent_id.errors import ModelError
from consistent_id.export.lint.described import DescribedLink, DescribedRobot
from consistent_id.export.lint.mjcf_evidence import mjcf_evidence
from consistent_id.export.mjcf_body import compiled_body
from consistent_id.export.repair.file_evidence import FileEvidence
from consistent_id.robot.loaders.mjcf import load_mjcf
from consistent_id.robot.loaders.mjcf_assets import stand_in
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

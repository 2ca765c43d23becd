"""All findings in a robot description, URDF or MJCF, and their output.

An MJCF file is read as compiled by MuJoCo.  Findings are printed for people, for
programs, and as SARIF 2.1.0.
"""

import re
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from consistent_id._support.arrays import Array, Vector
from consistent_id._support.extras import needed
from consistent_id.errors import ModelError
from consistent_id.repair.causes import LinkStatement
from consistent_id.repair.file_evidence import FileEvidence
from consistent_id.repair.link_evidence import LinkSolid, directions, hull_solid
from consistent_id.repair.lint_rules import (
    RULES,
    DescribedLink,
    DescribedRobot,
    LintFinding,
    all_findings,
    probable_mistakes,
)
from consistent_id.robot.loaders.mjcf import compiled_body, load_mjcf, quaternion_matrix
from consistent_id.robot.loaders.mjcf_spec import compiled_file, mjcf_elements
from consistent_id.robot.loaders.urdf import load_urdf
from consistent_id.robot.loaders.urdf_in_place import inertia_matrix, numbers
from consistent_id.robot.loaders.urdf_lint import (
    read_bytes,
    readable_numbers,
    urdf_findings,
)
from consistent_id.robot.loaders.xml import Element, XmlFault, parse

_LINE = re.compile(r"[Ll]ine (\d+)")

_SCHEMA = "https://json.schemastore.org/sarif-2.1.0.json"
Findings = Mapping[str, Sequence[LintFinding]]


def lint_robot(path: str | Path) -> tuple[LintFinding, ...]:
    """Find faults of a robot description that simulators refuse, or should refuse.

    Parameters
    ----------
    path : str or Path
        URDF or MJCF; the root element decides.

    Returns
    -------
    tuple of LintFinding
        In the order of the file's lines.

    Raises
    ------
    ModelError
        If the file cannot be read at all, or is MJCF and MuJoCo is not installed.

    See Also
    --------
    lint_urdf : Only faults that prevent a URDF from being loaded.
    """
    file = Path(path)
    try:
        root = parse(read_bytes(file))
    except XmlFault as fault:
        return (LintFinding(fault.line, "structure", "error", fault.sentence),)
    if root.tag == "mujoco":
        try:
            described, known = described_mjcf(file, root)
        except ModelError as refused:
            if "MuJoCo refuses it" not in str(refused):
                raise
            place = _LINE.search(str(refused))
            line = int(place[1]) if place else root.line
            sentence = " ".join(str(refused).partition(": ")[2].split())
            return (LintFinding(line, "structure", "error", sentence),)
        lines = {link.name: link.line for link in described.links}
        return tuple(
            sorted((*probable_mistakes(known, lines), *all_findings(described)))
        )
    if root.tag != "robot":
        sentence = f"root element is <{root.tag}>, expected <robot> or <mujoco>"
        return (LintFinding(root.line, "structure", "error", sentence),)
    described, known = described_urdf(file, root)
    return tuple(sorted((*urdf_only(root, known), *all_findings(described))))


def lint_text(found: Findings) -> str:
    """Return a line for each finding, and their number."""
    lines = [
        f"{path}:{f.line}: {f.severity}: {f.sentence} [{f.rule}]"
        for path, findings in found.items()
        for f in findings
    ]
    errors = sum(f.severity == "error" for of in found.values() for f in of)
    files = f"{len(found)} file{'s' * (len(found) != 1)}"
    lines.append(f"{files}: {errors} errors, {len(lines) - errors} warnings")
    return "\n".join(lines)


def lint_record(found: Findings) -> dict[str, Any]:
    """Return findings as plain values, ready for JSON."""
    return {
        "format": "consistent_id lint 1",
        "files": {path: [asdict(f) for f in of] for path, of in found.items()},
    }


def sarif(found: Findings, version: str) -> dict[str, Any]:
    """Return findings as SARIF 2.1.0, which code hosts show beside the lines."""
    rules = [{"id": k, "shortDescription": {"text": v}} for k, v in RULES.items()]
    driver = {"name": "consistent-id", "version": version, "rules": rules}
    results = [_result(path, f) for path, of in found.items() for f in of]
    run = {"tool": {"driver": driver}, "results": results}
    return {"$schema": _SCHEMA, "version": "2.1.0", "runs": [run]}


def _result(path: str, finding: LintFinding) -> dict[str, Any]:
    place = {
        "artifactLocation": {"uri": path.replace("\\", "/")},
        "region": {"startLine": finding.line},
    }
    return {
        "ruleId": finding.rule,
        "level": finding.severity,
        "message": {"text": finding.sentence},
        "locations": [{"physicalLocation": place}],
    }


def described_urdf(path: Path, root: Element) -> tuple[DescribedRobot, FileEvidence]:
    """Return what a URDF describes, and its evidence for mistakes."""
    known = FileEvidence.of(path, root)
    lines = {link.name: _line(link) for link in root.all("link")}
    links = []
    for body in known.bodies:
        solid = known.solids.get(body.name)
        places = [np.zeros(3), *_joints(root, "parent", body.name)]
        before = _joints(root, "child", body.name)
        links.append(
            DescribedLink(
                body.name,
                lines[body.name],
                body.mass,
                body.com,
                body.inertia,
                None if solid is None else solid.reach(body.com),
                max(_farthest(places, body.com), _farthest(before, np.zeros(3))),
                0.0 if solid is None else solid.outside(body.com),
            )
        )
    try:
        robot = load_urdf(path)
    except ModelError:
        robot = None  # the findings say why
    joints = {joint.name: joint.line for joint in root.all("joint")}
    return DescribedRobot(tuple(links), robot, joints), known


def urdf_only(root: Element, known: FileEvidence) -> Iterator[LintFinding]:
    """Yield what is found in the text, and mistakes that are probable."""
    for finding in urdf_findings(root, lambda joint: True):
        rule = "structure"
        severity = finding.severity
        if "not physically consistent" in finding.sentence:
            rule, severity = "inconsistent-inertia", "error"
        elif "other readers of URDF refuse" in finding.sentence:
            severity = "error"
        sentence = finding.sentence.partition("; this inertia is not")[0]
        yield LintFinding(finding.line, rule, severity, sentence)
    lines = {link.name: _line(link) for link in root.all("link")}
    yield from probable_mistakes(known, lines, "; see consistent-id repair")


def _line(link: Element) -> int:
    inertial = link.child("inertial")
    return link.line if inertial is None else inertial.line


def _farthest(places: Iterable[Vector], point: Vector) -> float:
    return max((float(np.linalg.norm(p - point)) for p in places), default=0.0)


def _joints(root: Element, end: str, name: str) -> Iterator[Vector]:
    """Yield origins of the joints whose parent or child a link is."""
    for joint in root.all("joint"):
        link, origin = joint.child(end), joint.child("origin")
        if link is None or link.attributes.get("link") != name or origin is None:
            continue
        stated = origin.attributes.get("xyz", "0 0 0")
        if readable_numbers(stated, 3):
            yield numbers(stated)


def described_mjcf(path: Path, root: Element) -> tuple[DescribedRobot, FileEvidence]:
    """Return what an MJCF file describes, and its evidence for mistakes.

    Raises
    ------
    ModelError
        If MuJoCo is not installed, or refuses the file.
    """
    mujoco = needed("mujoco", "mjcf", f"{path}: reading MJCF", ModelError)
    mjcf_elements(path)  # refuses pipes, which MuJoCo would wait for
    spec, model, blind = compiled_file(path, mujoco)
    lines = _lines(root, "body")
    known = mjcf_evidence(spec, model, blind)
    links = [
        _link(model, b, lines.get(model.body(b).name, 1), blind, known.solids)
        for b in range(1, model.nbody)
        if model.body_mass[b] > 0.0
    ]
    try:
        robot = load_mjcf(path)
    except ModelError:
        robot = None  # a free base, or joints that are coupled
    described = DescribedRobot(tuple(links), robot, _lines(root, "joint"))
    return described, known


def _link(
    model: Any, b: int, line: int, blind: set[str], solids: Mapping[str, LinkSolid]
) -> DescribedLink:
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
        solids[name].outside(com) if name in solids else 0.0,
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
    kinds = needed("mujoco", "mjcf", "reading MJCF", ModelError).mjtGeom
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

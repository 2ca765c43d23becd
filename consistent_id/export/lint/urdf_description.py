"""A URDF as the lint sees it."""

from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np

from consistent_id._support.arrays import Vector
from consistent_id.errors import ModelError
from consistent_id.export.lint.described import (
    DescribedLink,
    DescribedRobot,
    LintFinding,
)
from consistent_id.export.lint.rules import probable_mistakes
from consistent_id.export.repair.file_evidence import FileEvidence
from consistent_id.robot.loaders.urdf import load_urdf
from consistent_id.robot.loaders.urdf_inertial import numbers
from consistent_id.robot.loaders.urdf_lint import readable_numbers, urdf_findings
from consistent_id.robot.loaders.xml import Element


def described_urdf(path: Path, root: Element) -> tuple[DescribedRobot, FileEvidence]:
    """Return what a URDF describes, and what it says of mistakes."""
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

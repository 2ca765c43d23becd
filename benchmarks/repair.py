"""What is wrong with published URDFs, and how far the nearest inertias are.

Every inconsistent link gets its nearest consistent inertia, whatever mistake explains
it; ``benchmarks/repair_causes.py`` measures how well mistakes are found.

``python benchmarks/repair.py [--write docs/repair.md]``: the robots of the package
example-robot-data and, if ``CONSISTENT_ID_DATASETS`` is set, those of the recordings.
The page's text above the mark is kept.
"""

import argparse
import os
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np
import pinocchio as pin

from consistent_id.repair import Repair, repair_urdf
from consistent_id.robot.loaders.urdf_in_place import inertia_matrix
from consistent_id.robot.loaders.xml import parse

MARK = "<!-- measured: begin -->"
EXAMPLES = Path(pin.__file__).parents[4] / "share" / "example-robot-data" / "robots"
ENTRIES = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")


class Case(NamedTuple):
    """A file, its repair, and how many of its massive links MuJoCo refuses."""

    name: str
    repair: Repair
    refused: int
    refused_after: int
    refused_thick: int


def files() -> Iterator[tuple[str, Path]]:
    """Yield names and paths of the URDFs at hand."""
    for path in sorted(EXAMPLES.rglob("*.urdf")):
        package = path.relative_to(EXAMPLES).parts[0]
        yield f"{package.removesuffix('_description')}/{path.name}", path
    folder = os.environ.get("CONSISTENT_ID_DATASETS")
    for path in sorted(Path(folder).rglob("*.urdf")) if folder else ():
        yield f"recordings of {path.parent.name}/{path.name}", path


def refused(content: bytes) -> int:
    """Return how many links with mass MuJoCo refuses as bodies that move."""
    count = 0
    for link in parse(content).all("link"):
        inertial = link.child("inertial")
        if inertial is None:
            continue
        mass = float(inertial.child("mass").attributes["value"])
        stated = inertial.child("inertia").attributes
        if mass > 0.0:
            inertia = inertia_matrix([float(stated[entry]) for entry in ENTRIES])
            count += not taken(mass, inertia)
    return count


def taken(mass: float, inertia: np.ndarray) -> bool:
    """Tell whether MuJoCo takes a body that moves."""
    spec = mujoco.MjSpec()
    body = spec.worldbody.add_body(mass=mass)
    body.add_joint()
    body.explicitinertial = True
    order = [(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)]
    body.fullinertia = [inertia[place] for place in order]
    try:
        spec.compile()
    except ValueError:
        return False
    return True


def measure() -> list[Case]:
    """Repair every file."""
    cases = []
    for name, path in files():
        wrong = [link.link for link in repair_urdf(path).links if link.fault]
        nearest = dict.fromkeys(wrong, 0)
        repair = repair_urdf(path, choices=nearest)
        thick = repair_urdf(path, choices=nearest, thickness=1e-4)
        contents = (repair.original, repair.content, thick.content)
        cases.append(Case(name, repair, *map(refused, contents)))
    return cases


def page(cases: list[Case]) -> str:
    """Return the measured part of the page."""
    links = sum(len(case.repair.links) for case in cases)
    wrong = [case for case in cases if case.repair.repaired]
    same = sum(case.repair.content == case.repair.original for case in cases)
    unrepaired = sum(len(case.repair.refused) for case in cases)
    broken = sum(len(case.repair.repaired) for case in wrong)
    lines = [
        "Measured by `python benchmarks/repair.py`: every inconsistent link gets its",
        "nearest consistent inertia (`--choose LINK=0`), in the URDFs of the package",
        "example-robot-data and of the recordings that this package is tested on.",
        f"{len(cases)} files, {links} links with an `<inertial>`. Of these, {broken}",
        f"in {len(wrong)} files are inconsistent; {unrepaired} could not be repaired;",
        f"{same} files came out byte by byte as they were. The change is that of the",
        "second moments of mass, relative. The last column counts links with mass that",
        "MuJoCo refuses as moving bodies: as they were, repaired, and with",
        "`--thickness 1e-4`. Point masses have no inertia, but are consistent.",
        "",
        "| file | links | inconsistent | largest change | refused by MuJoCo |",
        "|---|---:|---:|---:|---|",
    ]
    for case in cases:
        count = (case.refused, case.refused_after, case.refused_thick)
        if not case.repair.repaired and not any(count):
            continue
        changes = [link.change for link in case.repair.repaired]
        largest = f"{max(changes):.2g}" if changes else "-"
        lines.append(
            f"| {case.name} | {len(case.repair.links)} | {len(changes)} | {largest} "
            f"| {count[0]}, {count[1]}, {count[2]} |"
        )
    lines += [
        "",
        "Link by link; links of the same numbers are listed once:",
        "",
        "| file | link | mass [kg] | wrong | moments after [kg m^2] | change |",
        "|---|---|---:|---|---|---:|",
        *details(wrong),
    ]
    return "\n".join(lines) + "\n"


def details(cases: list[Case]) -> Iterator[str]:
    seen = set()
    for case in cases:
        for link in case.repair.repaired:
            if (link.before, link.mass) in seen:
                continue
            seen.add((link.before, link.mass))
            after = " ".join(f"{moment:.4g}" for moment in link.after)
            yield (
                f"| {case.name} | {link.link} | {link.mass:g} | {link.fault} | {after} "
                f"| {link.change:.2g} |"
            )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", type=Path, help="page to write the figures into")
    options = parser.parse_args()
    measured = page(measure())
    print(measured)
    if options.write:
        text, _, _ = options.write.read_text().partition(MARK)
        options.write.write_text(f"{text}{MARK}\n\n{measured}")


if __name__ == "__main__":
    main()

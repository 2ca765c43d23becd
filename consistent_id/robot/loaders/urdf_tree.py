"""How the links and joints of a URDF hang together, before anything is loaded."""

from collections.abc import Iterator

from consistent_id._support.inputs import LARGEST_TREE
from consistent_id._support.run import current_run
from consistent_id.robot.loaders.urdf_finding import Finding
from consistent_id.robot.loaders.xml import Element
from consistent_id.robot.parameters import did_you_mean


def tree_findings(root: Element) -> Iterator[Finding]:
    """Find what keeps links and joints from being one tree."""
    joints = sum(1 for _ in root.all("joint"))
    if joints > LARGEST_TREE and not current_run().large_files:
        yield Finding(
            root.line,
            "error",
            f"{joints} joints, expected at most {LARGEST_TREE}; say --large-files "
            "(in Python: with consistent_id.large_files()) if it is meant",
        )
        return
    links = {link.name: link for link in root.all("link")}
    if not links:
        yield Finding(root.line, "error", "the robot has no <link>")
        return
    carried: dict[str, Element] = {}
    for joint in root.all("joint"):
        where = f"joint {joint.name!r}"
        for end in ("parent", "child"):
            name = _end(joint, end)
            if name and name not in links:
                near = did_you_mean(name, links)
                sentence = f"{where}: no {end} link named {name!r}; {near}"
                yield Finding(joint.line, "error", sentence)
        child = _end(joint, "child")
        if child in carried:
            first = carried[child]
            yield Finding(
                joint.line,
                "error",
                f"{where}: link {child!r} already hangs on joint {first.name!r} (line "
                f"{first.line}); closed loops are not supported, cut one of the two",
            )
        elif child:
            carried[child] = joint
    yield from _root_findings(links, carried)


def _root_findings(
    links: dict[str, Element], carried: dict[str, Element]
) -> Iterator[Finding]:
    roots = [link for name, link in links.items() if name not in carried]
    for extra in roots[1:]:
        yield Finding(
            extra.line,
            "error",
            f"link {extra.name!r} hangs on no joint, and neither does "
            f"{roots[0].name!r} (line {roots[0].line}); a robot has one root",
        )
    above = {name: _end(joint, "parent") for name, joint in carried.items()}
    for name, joint in carried.items():
        path = [name]
        while path[-1] in above and len(path) <= len(above):
            path.append(above[path[-1]])
            if path[-1] == name:
                break
        if path[-1] == name and len(path) > 1 and name == min(path):
            loop = " < ".join(path)
            sentence = f"joint {joint.name!r}: its links carry one another: {loop}"
            yield Finding(joint.line, "error", sentence)


def joints_between(root: Element, base: str | None, tip: str | None) -> frozenset[str]:
    """Return the names of the joints from `base` to `tip`, or to all that it carries.

    Links that are fixed to one another count as one.
    """
    joints = {_end(joint, "child"): joint for joint in root.all("joint")}
    above = {link: _end(joint, "parent") for link, joint in joints.items()}
    start = base
    for _ in above:  # links that carry one another are found by the lint
        if start in above and joints[start].attributes.get("type") == "fixed":
            start = above[start]
    found: set[str] = set()
    for link in [tip] if tip is not None else list(above):
        names: list[str] = []
        while link != start and link in above and len(names) < len(above):
            names.append(joints[link].name)
            link = above[link]
        if start is None or link == start:
            found |= set(names)
    return frozenset(found)


def _end(joint: Element, end: str) -> str:
    element = joint.child(end)
    return "" if element is None else element.attributes.get("link", "")

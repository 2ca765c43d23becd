"""Links whose weight a robot's model does not have: behind its tip, or not stated."""

from collections.abc import Iterator

import msgspec

from consistent_id.errors import ConsistentIdError
from consistent_id.motion.collisions.urdf_bodies import urdf_root
from consistent_id.problems.problem import Problem
from consistent_id.problems.stated_model import robot_of
from consistent_id.robot.model import Link, RobotModel


def links_behind_tip(problem: Problem) -> tuple[str, ...]:
    """Return links with weight that hang on moving ones, but are not in the model.

    They are behind joints that ``tip`` leaves out, such as the wrist behind a forearm.
    None are known where the whole file cannot be loaded.
    """
    table = problem.table
    if table.model.tip is None:
        return ()
    model = msgspec.structs.replace(table.model, tip=None)
    try:
        whole = robot_of(msgspec.structs.replace(table, model=model), problem.folder)
    except ConsistentIdError:  # such as a closed chain
        return ()
    known = set(_names(problem.moving))
    return tuple(
        link.name
        for link in whole.links
        if _mass(link) > 0.0
        and not known & set(_names_of(link))
        and _carried(whole, link, known)
    )


def massless_links(problem: Problem) -> tuple[str, ...]:
    """Return moving links that have shapes in a URDF, but no mass.

    A link without shapes is a frame, which has none.
    """
    file = problem.table.model.urdf
    if file is None:
        return ()
    shown = {
        link.name
        for link in urdf_root(problem.file(file)).all("link")
        if link.child("visual") is not None or link.child("collision") is not None
    }
    return tuple(
        link.name
        for link in problem.moving.links
        if _mass(link) == 0.0 and shown & set(_names_of(link))
    )


def _carried(whole: RobotModel, link: Link, known: set[str]) -> bool:
    """Return whether a link hangs on one that the model has."""
    parents = {
        one.name: joint.parent
        for one, joint in zip(whole.links, whole.joints, strict=True)
    }
    at = parents[link.name]
    while at >= 0:
        carrier = whole.links[at]
        if known & set(_names_of(carrier)):
            return True
        at = parents[carrier.name]
    return False


def _mass(link: Link) -> float:
    return 0.0 if link.nominal is None else link.nominal.mass


def _names(robot: RobotModel) -> Iterator[str]:
    for link in robot.links:
        yield from _names_of(link)


def _names_of(link: Link) -> Iterator[str]:
    yield link.name
    yield from (frame.name for frame in link.merged)

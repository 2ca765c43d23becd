"""Bodies and joints of a ``mujoco.MjSpec`` by name, in the order of the model."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True, slots=True, eq=False)
class SpecTree:
    """Bodies and joints of a specification, by the names that `load_mjcf` gives them.

    `places` are the bodies' numbers in the compiled model, `carried` the names of the
    bodies that joints move.
    """

    bodies: dict[str, Any]
    places: dict[str, int]
    joints: dict[str, Any]
    carried: dict[str, str]


def spec_tree(spec: Any) -> SpecTree:
    """Return the tree of a specification; what has no name is named by its number."""
    tree = SpecTree({}, {}, {}, {})
    for place, body in enumerate(_below(spec.worldbody)):
        body.name = body.name or f"body{place}"
        tree.bodies[body.name], tree.places[body.name] = body, place
        joint = body.first_joint()
        while joint is not None:
            joint.name = joint.name or f"joint{len(tree.joints)}"
            tree.joints[joint.name], tree.carried[joint.name] = joint, body.name
            joint = body.next_joint(joint)
    return tree


def _below(body: Any) -> Iterator[Any]:
    """Yield a body and all that it carries, depth first."""
    yield body
    child = body.first_body()
    while child is not None:
        yield from _below(child)
        child = body.next_body(child)

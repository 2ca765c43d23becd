"""The body of an MJCF model that floats."""

from pathlib import Path
from typing import Any

import numpy as np

from consistent_id.errors import ModelError
from consistent_id.robot.loaders.mjcf_checks import joint_name
from consistent_id.robot.model import Joint


def floating_body(model: Any, path: Path) -> int:
    """Return the body of the world that moves, or carries what moves.

    Raises
    ------
    ModelError
        If there is none, if there are several, or if it has other joints than a free
        one.
    """
    import mujoco

    roots = {
        int(model.body_rootid[body])
        for body in range(1, model.nbody)
        if model.body_jntnum[body]
    }
    names = [model.body(body).name for body in sorted(roots)]
    if len(roots) != 1:
        raise ModelError(
            f"{path}: the base is to float, but the world carries "
            f"{', '.join(names) or 'no body with joints'}; expected one robot. Remove "
            "the others from the file"
        )
    (root,) = roots
    free = mujoco.mjtJoint.mjJNT_FREE
    first = int(model.body_jntadr[root])
    for j in range(first, first + int(model.body_jntnum[root])):
        if mujoco.mjtJoint(int(model.jnt_type[j])) != free:
            raise ModelError(
                f"{path}: the base is to float, but body {names[0]!r} hangs on the "
                f"world by joint {joint_name(model, j)!r}; leave base out"
            )
    return root


def free_joint(model: Any, body: int) -> Joint:
    """Return the free joint of a body, at which it is at rest where the world is."""
    has_own = bool(model.body_jntnum[body])
    name = joint_name(model, int(model.body_jntadr[body])) if has_own else "root_joint"
    return Joint(name, "free", -1, np.eye(3), np.zeros(3), np.array([0.0, 0.0, 1.0]))

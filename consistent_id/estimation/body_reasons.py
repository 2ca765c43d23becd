"""Reasons from the bodies: whether links can have theirs, and the robot's size."""

from collections.abc import Iterator, Sequence

import numpy as np

from consistent_id._support.tables import some_of
from consistent_id.constraints.delivered_bodies import LinkCondition, RobotSize
from consistent_id.estimation.slope_reasons import where
from consistent_id.estimation.verdict import Reason

CONSTRAINED = "use a constrained estimate: all its links are physically consistent"
"""Advice where a body is impossible."""

# Inertia about a joint over the most that bodies have within their sizes, and extent of
# a body over its size.  In clean logs of real arms they are up to 0.7 and 1.9, and 1.4
# for a Z1 whose torque is computed from commands; for a UR10e whose clock runs at half
# speed, 2.4-2.9 and 2.1-3.9.
INERTIA_CARE = 1.5
INERTIA_REFUSED = 2.0
EXTENT_CARE = 3.0


def body_reasons(links: Sequence[LinkCondition]) -> Iterator[Reason]:
    """Name links that no body is, or that have no mass."""
    wrong = [link.link for link in links if not link.consistent]
    if wrong:
        said = f"not physically consistent: {some_of(wrong)}"
        yield Reason("inconsistent bodies", "do not use", said, CONSTRAINED)
    empty = [k.link for k in links if k.consistent and k.massless]
    if empty:
        yield Reason(
            "vanishing mass",
            "do not use",
            f"estimated without mass: {some_of(empty)}",
            "state masses of the datasheet ([constraints] masses), or mass bounds",
        )


def size_reasons(size: RobotSize, strong: Sequence[str]) -> Iterator[Reason]:
    """Compare the inertia about joints, and the bodies, with the robot's geometry.

    Parameters
    ----------
    strong : sequence of str
        Joints that carry much of the torque.
    """
    advice = (
        "check the clock (a log at half speed shows four times the inertia), the gain "
        "of torque, and lengths and masses of the model"
    )
    matters = np.isin(size.joints, strong)
    heavy = where(matters & (size.inertia > INERTIA_CARE))
    if heavy:
        said = ", ".join(f"{size.joints[j]} {size.inertia[j]:.3g}" for j in heavy)
        worst = max(float(size.inertia[j]) for j in heavy)
        yield Reason(
            "robot's size",
            "do not use" if worst > INERTIA_REFUSED else "use with care",
            "inertia about joints, over the most that bodies of these masses and the "
            f"model's lengths have: {said}",
            advice,
        )
    moved = np.isin(size.carried_by, strong)
    for what, extent in (
        ("radius of gyration", size.radius),
        ("distance of the centre of mass from the joint", size.centre),
    ):
        wide = where(moved & (extent > EXTENT_CARE * size.size))
        if wide:
            k = max(wide, key=lambda i: float(extent[i] / size.size[i]))
            yield Reason(
                "robot's size",
                "use with care",
                f"{what} of {size.links[k]}: {extent[k]:.3g} m, but its lengths in the "
                f"model are at most {size.size[k]:.3g} m",
                advice,
            )

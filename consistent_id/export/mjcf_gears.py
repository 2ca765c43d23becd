"""Coupled gears in MuJoCo: a tendon whose length is the sum of both positions.

What two joints share of viscous friction, ``[[d1, b], [b, d2]]``, is a damper ``b`` on
the sum of both rates and dampers ``d1 - b`` and ``d2 - b`` on each; rotor inertias
likewise, and Coulomb friction of the sum is the tendon's own.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from consistent_id.estimation.estimate import Estimate
from consistent_id.export.drive_values import coupling_values

_ROUNDING = 1e-8  # of what is shared; so far may a joint's own fall short of it
_SHARED = {
    "coupling_viscous": "damping",
    "coupling_coulomb": "frictionloss",
    "coupling_rotor_inertia": "armature",
}


def set_number(item: Any, name: str, value: float) -> None:
    """Set a number that newer versions of MuJoCo have as a polynomial's first."""
    stated = getattr(item, name)
    if np.ndim(stated):
        setattr(item, name, [value, *np.zeros(len(stated) - 1)])
    else:
        setattr(item, name, value)


def add_gears(
    spec: Any, joints: Mapping[str, Any], estimate: Estimate
) -> set[tuple[str, str]]:
    """Add a tendon for each coupling, to joints that have their drives already.

    Returns
    -------
    set of (str, str)
        Couplings and terms that are expressed: those whose dampers and inertias all
        come out positive.
    """
    expressed = set()
    for coupling, values in coupling_values(estimate):
        ends = (joints[coupling.first], joints[coupling.second])
        tendon = spec.add_tendon(name=coupling.label)
        shared = {
            term: value
            for term, value in values.items()
            # Older versions have no inertia of tendons.
            if hasattr(tendon, _SHARED[term]) and _fits(term, value, ends)
        }
        for name, end in zip((coupling.first, coupling.second), ends, strict=True):
            tendon.wrap_joint(name, 1.0)
            for term, value in shared.items():
                if term != "coupling_coulomb":
                    rest = max(_number(end, _SHARED[term]) - value, 0.0)
                    set_number(end, _SHARED[term], rest)
        for term, value in shared.items():
            set_number(tendon, _SHARED[term], value)
            expressed.add((coupling.label, term))
    return expressed


def _fits(term: str, value: float, ends: tuple[Any, Any]) -> bool:
    if value < 0.0:
        return False
    if term == "coupling_coulomb":
        return True
    least = (1.0 - _ROUNDING) * value
    return all(_number(end, _SHARED[term]) >= least for end in ends)


def _number(item: Any, name: str) -> float:
    return float(np.ravel(getattr(item, name))[0])

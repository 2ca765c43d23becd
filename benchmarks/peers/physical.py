"""FIGAROH's direct fit of the effort under LMIs (`physical_fit`), in the peers' Python.

Settings are those of its configuration, where nothing else is said: solver CVXOPT,
weight of the prior 1e-6.  It takes a second solver for where the first finds no
optimum, and names none; here that is QICS, the one of its tests.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

TERMS = ("m", "mx", "my", "mz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")
KINDS = ("fv", "fs", "ia", "off")
SOLVERS = ("cvxopt", "qics")


def names_of(joints: Sequence[str], width: int) -> list[str]:
    """Return FIGAROH's names of columns; more than it has are called more_0, ..."""
    names = [f"{term}_{joint}" for joint in joints for term in TERMS]
    if width > len(names):
        names += [f"{kind}_{joint}" for kind in KINDS for joint in joints]
    return names + [f"more_{k}" for k in range(width - len(names))]


class Found(NamedTuple):
    """Parameters, None if they are rejected, and which solvers failed, or why."""

    parameters: np.ndarray | None
    said: str


def row_weights(residual: np.ndarray, joints: int) -> np.ndarray:
    """Return the square roots of FIGAROH's weights (`wls`): one for each joint."""
    variance = np.mean(residual.reshape(joints, -1) ** 2, axis=1)
    return np.repeat(1.0 / np.sqrt(variance + 1e-12), residual.size // joints)


def fitted(
    W: np.ndarray,
    tau: np.ndarray,
    joints: Sequence[str],
    reference: np.ndarray,
    *,
    weights: np.ndarray | None = None,
    masses: tuple[float, float] | None = None,
    prior: float = 1e-6,
) -> Found:
    """Return what `physical_fit` finds.

    Parameters
    ----------
    reference : ndarray
        Parameters of the nominal robot, and zeros of the drives.
    masses : (float, float), optional
        Least and greatest ratio of each mass to the nominal one.
    """
    from figaroh.identification import physical_fit as direct

    policy = direct.PhysicalPolicy(mass_ratio_bounds=masses, prior_weight=prior)
    names = names_of(joints, W.shape[1])
    problem: Any = direct.build_problem(
        W, tau, names, joints, prior=reference, policy=policy, row_weight=weights
    )
    said = []
    for solver in SOLVERS:
        record = direct.solve_direct_effort_fit(problem, solver=solver)
        if record.accepted:
            failed = ", ".join(SOLVERS[: SOLVERS.index(solver)])
            return Found(record.theta, f"{failed} failed, by {solver}" * bool(failed))
        if record.solver_status == "optimal":
            bad = [link for link, seen in record.feasibility.items() if not seen["ok"]]
            said.append(f"{solver}: not consistent, {', '.join(bad)}")
            break
        reason = record.exception or record.solver_status
        said.append(f"{solver}: {reason}")
    return Found(None, "; ".join(said))

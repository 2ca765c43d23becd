"""What to believe of parameters that the data leave open."""

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from consistent_id._arrays import Array, Matrix, Vector
from consistent_id.errors import ProblemError
from consistent_id.inertia import PSEUDO_INERTIA_BASIS, pseudo_inertia
from consistent_id.regressor import TorqueModel
from consistent_id.scaling import link_scales, reference_bodies

Distance = Literal["pullback", "euclidean"]


@dataclass(frozen=True, slots=True)
class PointToSet:
    """Among all estimates that fit nearly best, take the one nearest to the nominal.

    Parameters
    ----------
    slack : float, optional
        Relative increase of the weighted misfit norm that counts as "nearly best".  By
        default the increase that noise itself brings: ``sqrt(1 + b / (N - b)) - 1``
        for ``b`` base parameters and ``N`` rows.
    distance : {"pullback", "euclidean"}
        ``sum_k ||J0^-1/2 (J - J0) J0^-1/2||_F^2``, scale-free, the second-order form of
        the log-det divergence at the nominal body [Lee2020]_; or the sum of squares of
        parameters divided by each link's typical mass and length.

    Notes
    -----
    Where a link has no nominal body, a ball of its typical mass and length stands in
    (`reference_bodies`); friction and drive terms are drawn to zero.
    """

    slack: float | None = None
    distance: Distance = "pullback"

    def __post_init__(self) -> None:
        if self.slack is not None and not 0.0 < self.slack < 1.0:
            raise ProblemError(f"slack is {self.slack}, expected between 0 and 1")
        if self.distance not in get_args(Distance):
            known = ", ".join(get_args(Distance))
            raise ProblemError(
                f"distance is {self.distance!r}, expected one of {known}"
            )

    def relative_slack(self, base: int, rows: int) -> float:
        """Return the slack for these counts of base parameters and rows."""
        if self.slack is not None:
            return self.slack
        return min(float(np.sqrt(1.0 + base / max(rows - base, 1)) - 1.0), 1.0)


def distance_to_nominal(
    model: TorqueModel, distance: Distance, drive_units: Vector
) -> tuple[Matrix, Vector]:
    """Return ``G, g`` with ``||G x - g||`` the distance of parameters `x`.

    `drive_units` are the typical sizes of drive terms.
    """
    robot, layout = model.robot, model.layout
    bodies = reference_bodies(robot)
    if distance == "pullback":
        rows = [_pullback_rows(body) for body in bodies]
    else:
        units = link_scales(robot).units.reshape(-1, 10)
        rows = [np.diag(1.0 / unit) for unit in units]
    size = sum(len(block) for block in rows)
    G = np.zeros((size + len(drive_units), len(layout)))
    g = np.zeros(len(G))
    start = 0
    for k, block in enumerate(rows):
        stop = start + len(block)
        G[start:stop, layout.link_slice(k)] = block
        g[start:stop] = block @ bodies[k]
        start = stop
    G[start:, layout.inertial_size :] = np.diag(1.0 / drive_units)
    return G, g


def pullback_distance(x: Vector, reference: Array) -> float:
    """Return ``||J0^-1/2 (J(x) - J0) J0^-1/2||_F`` of one link's ten parameters."""
    return float(np.linalg.norm(_pullback_rows(reference) @ (x - reference)))


def _pullback_rows(body: Vector) -> Matrix:
    """Linear map whose norm is the pullback norm at a body, shape (10, 10)."""
    values, vectors = np.linalg.eigh(pseudo_inertia(body))
    root = (vectors / np.sqrt(values)) @ vectors.T
    white = root @ PSEUDO_INERTIA_BASIS @ root
    upper = np.triu_indices(4)
    # Off-diagonal entries stand twice in the Frobenius norm.
    weight = np.where(upper[0] == upper[1], 1.0, np.sqrt(2.0))
    return np.asarray((white[:, *upper] * weight).T)

"""Robots' parts on disk, so that memory does not hold those of a whole fleet."""

from pathlib import Path

import numpy as np

from consistent_id.problems.fleet.fleet_model import FleetModel
from consistent_id.problems.fleet.robot_share import RobotShare
from consistent_id.regression.correlated_noise import CorrelatedNoise
from consistent_id.regression.regression import Regression


def write_share(path: Path, share: RobotShare) -> None:
    """Write the regression of a robot's part."""
    regression, noise = share.shared, share.shared.noise
    arrays = {f"factor{j}": F for j, F in enumerate(regression.factors)}
    if noise is not None:
        arrays |= {f"scores{j}": N for j, N in enumerate(noise.scores)}
        arrays["effective"] = noise.effective
    np.savez(
        path,
        counts=np.array(regression.counts),
        sigma=regression.sigma,
        peaks=regression.peaks,
        **arrays,  # type: ignore[arg-type]
    )


def read_share(path: Path, fleet: FleetModel) -> Regression:
    """Read what `write_share` wrote."""
    joints = fleet.shared.torque_joints
    with np.load(path) as file:
        noise = None
        if "effective" in file:
            scores = tuple(file[f"scores{j}"] for j in range(len(joints)))
            noise = CorrelatedNoise(file["effective"], scores)
        return Regression(
            layout=fleet.shared.layout,
            joints=joints,
            factors=tuple(file[f"factor{j}"] for j in range(len(joints))),
            counts=tuple(file["counts"].tolist()),
            sigma=file["sigma"],
            fingerprint=fleet.shared.fingerprint,
            noise=noise,
            peaks=file["peaks"],
        )

"""Made-up fits and errors of three joints, without a fault but for what is changed."""

import numpy as np

from consistent_id.estimation.fit import Fit
from consistent_id.estimation.judgement import Evidence
from consistent_id.estimation.torque_error import TorqueError

JOINTS = ("a", "b", "c")


def fit(joints=JOINTS, **changes):
    """A fit that gives no reason to doubt; a number is that of all joints."""
    plain = {
        "misfit": 0.06,
        "floor": 0.06,
        "excess": 1.0,
        "drive_share": 0.3,
        "friction_share": 0.3,
        "correlation": 1.0,
        "spare": 100.0,
        "guessed": 0.0,
    }
    of_joints = {
        "torque": 10.0,
        "misfits": 0.06,
        "shares": 1.0,
        "slopes": 1.0,
        "explained": 1.0,
        "expected": 0.5,
        "efforts": 0.5,
        "moving": 0.9,
        "holding": 1.0,
        "prior_errors": np.nan,
    }
    arrays = {
        name: np.broadcast_to(changes.get(name, value), (len(joints),))
        for name, value in of_joints.items()
    }
    alone = {name: changes.get(name, value) for name, value in plain.items()}
    assert changes.keys() <= plain.keys() | of_joints.keys()
    return Fit(joints=joints, **alone, **arrays)


def held_out(stacked=0.05, *, of_joints=0.05, torque=10.0, beyond=None):
    """The error of all joints on another recording, and of each beyond rests."""
    torques = np.broadcast_to(torque, (3,)).astype(float)
    shares = np.broadcast_to(of_joints, (3,))
    return TorqueError(
        "other.csv",
        shares * torques,
        shares,
        torques,
        stacked,
        shares * torques,
        stacked if beyond is None else beyond,
    )


def evidence(**changes):
    """Evidence on which an estimate is used, but for what is changed."""
    own = {"fit": fit(), "least_mass_eigenvalue": 1.0, **changes}
    return Evidence(
        "made up", own.pop("optimum", "certified"), "", own.pop("links", ()), **own
    )

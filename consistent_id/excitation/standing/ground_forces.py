"""Forces of the ground that carry a motion, and the joints' torques with them.

Feet press, they do not pull, and slip beyond the friction cone.  Forces that balance
the base's six rows are many; here the nearest to an equal share of the weight is taken,
deviations along the ground counting by the friction coefficient.  That it keeps all
limits shows that forces exist which do.
"""

from typing import NamedTuple

import numpy as np

from consistent_id._support.arrays import Array, Matrix, Vector
from consistent_id.excitation.standing.stance import JointMotion, Stance
from consistent_id.recordings.base_motion import BaseMotion
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.rows.generalised_forces import contact_jacobian


class GroundForces(NamedTuple):
    """What carries a motion.

    Attributes
    ----------
    forces : ndarray, shape (samples, points, 3), [N]
        On the robot, in the world's axes, z upwards, at each point of each foot.
    torque : ndarray, shape (samples, joints), [N m or N]
    share : float, [N]
        Of the robot's weight, for each point.
    """

    forces: Array
    torque: Matrix
    share: float


def ground_forces(
    stance: Stance,
    model: TorqueModel,
    parameters: Vector,
    moved: JointMotion,
    base: BaseMotion,
    friction: float,
) -> GroundForces:
    """Return forces and torques of a motion.

    Parameters
    ----------
    model : TorqueModel
        Of all rows.
    parameters : ndarray, shape (parameters,)
    base : BaseMotion
        With its rotation.
    friction : float
        Coefficient of friction between feet and ground.
    """
    robot, n = stance.robot, len(moved.q)
    needed = model.predict(parameters, moved.q, moved.dq, moved.ddq, base=base)
    upright = np.asarray(base.rotation)
    pushes = np.concatenate(
        [
            np.swapaxes(
                contact_jacobian(robot, moved.q, frame=foot.frame, point=point)[:, :3],
                1,
                2,
            )
            @ np.swapaxes(upright, 1, 2)
            for foot in stance.feet
            for point in foot.points
        ],
        axis=2,
    )
    points = pushes.shape[2] // 3
    share = _weight(stance, parameters) / points
    usual = np.tile([0.0, 0.0, share], points)
    freedom = np.tile([friction**2, friction**2, 1.0], points)
    G = pushes[:, :6]
    square = (G * freedom) @ np.swapaxes(G, 1, 2)
    lacking = needed[:, :6] - G @ usual
    more = np.linalg.solve(square, lacking[..., None])
    forces = usual + freedom * (np.swapaxes(G, 1, 2) @ more)[..., 0]
    torque = needed[:, 6:] - (pushes[:, 6:] @ forces[..., None])[..., 0]
    return GroundForces(forces.reshape(n, points, 3), torque, share)


def _weight(stance: Stance, parameters: Vector) -> float:
    """Return the robot's weight [N]."""
    masses = parameters[: 10 * len(stance.robot.links) : 10]
    return float(masses.sum() * np.linalg.norm(stance.robot.gravity))

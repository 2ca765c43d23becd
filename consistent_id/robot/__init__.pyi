from consistent_id.robot.chains import chain, free_bodies, held
from consistent_id.robot.inertia import InertialParameters
from consistent_id.robot.kinematics import frame_places
from consistent_id.robot.loaders import (
    DHRow,
    Finding,
    from_classical_dh,
    from_modified_dh,
    lint_urdf,
    load_mjcf,
    load_robot,
    load_urdf,
)
from consistent_id.robot.log_cholesky import (
    body_from_log_cholesky,
    log_cholesky_from_body,
    log_cholesky_jacobian,
)
from consistent_id.robot.model import (
    Datasheet,
    FixedFrame,
    Joint,
    JointLimits,
    Link,
    Mimic,
    RobotModel,
)

__all__ = [
    "DHRow",
    "Datasheet",
    "Finding",
    "FixedFrame",
    "InertialParameters",
    "Joint",
    "JointLimits",
    "Link",
    "Mimic",
    "RobotModel",
    "body_from_log_cholesky",
    "chain",
    "frame_places",
    "free_bodies",
    "from_classical_dh",
    "from_modified_dh",
    "held",
    "lint_urdf",
    "load_mjcf",
    "load_robot",
    "load_urdf",
    "log_cholesky_from_body",
    "log_cholesky_jacobian",
]

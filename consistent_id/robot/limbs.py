"""Whether a robot whose base is taken for fixed looks like one that stands on legs."""

from consistent_id.robot.model import RobotModel

_LIMBS = 2  # an arm is one limb; what stands, walks or flies has several
_JOINTS = 3  # of a limb: fingers and wheels have fewer


def base_question(robot: RobotModel) -> tuple[str, ...]:
    """Return a question to the user if a fixed base seems odd, else nothing.

    That is where several chains of three joints or more hang on the fixed root: legs
    of a robot that walks, or arms of one that stands on a pillar.
    """
    if robot.floating:
        return ()
    length = [1] * len(robot.joints)
    for k in range(len(robot.joints) - 1, -1, -1):
        parent = robot.joints[k].parent
        if parent >= 0:
            length[parent] = max(length[parent], length[k] + 1)
    limbs = [
        joint.name
        for joint, joints in zip(robot.joints, length, strict=True)
        if joint.parent < 0 and joints >= _JOINTS
    ]
    if len(limbs) < _LIMBS:
        return ()
    return (
        f"the base is taken for fixed, though {len(limbs)} limbs hang on it (from "
        f"{', '.join(limbs)} on); if it moves, or stands on them, say base = "
        "'floating'",
    )

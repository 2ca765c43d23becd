"""Values of a wrong type, such as a path in place of what was read from it."""

from collections.abc import Sequence
from pathlib import Path

from consistent_id.errors import ProblemError

_CALLS = {
    "RobotModel": "load_robot({}) reads one from a URDF or MJCF file",
    "TorqueModel": "TorqueModel(robot) makes one, with the robot of load_robot({})",
    "Recording": "read_recording({}) reads one from a log",
    "Estimate": "open_results(FOLDER).recommended reads one from results",
    "Constraint": "PhysicalConsistency() is one",
    "BaseParameters": "base_parameters(model) finds them",
    "PDGains": "PDGains(kp, kd) makes them",
    "JointPath": "read_trajectory({}) reads one from a file, and design_trajectory("
    "robot).trajectory is one",
    "FourierTrajectory": "design_trajectory(robot).trajectory is one, and "
    "read_trajectory({}) reads one from a file",
    "MotionLimits": "motion_limits(robot) makes them",
    "MotionState": "MotionState.at_rest(joints, positions) makes one",
    "Body": "Body(name, shape, frame) makes one",
    "Workspace": "Workspace(link, low, high) makes one",
    "OrientationCone": "OrientationCone(link, angle) makes one",
    "Scene": "build_scene(robot, bodies) makes one",
    "ExcitationDesign": "design_trajectory(robot) makes one",
    "ReplayModel": "replay_model(estimate, joints, gains) makes one",
    "Rollout": "rollout_of(study).rollout is one",
    "ServoLog": "read_servo_logs([{}], joints) reads them from files",
    "ServoFit": "identify_servos(robot, logs) makes one",
    "Regression": "build_regression(model, recordings) makes one",
    "ControlModel": "control_model(estimate) makes one",
    "Study": "run_study(problem) makes one",
    "Problem": "load_problem({}) reads one, and draft_problem(ROBOT, LOGS).problem() "
    "makes one",
}
"""The calls that make values of a type; a path stands between the braces."""


def require_type(value: object, expected: type, what: str, hint: str = "") -> None:
    """Refuse a value of another type.

    Parameters
    ----------
    value : object
    expected : type
    what : str
        The function or its argument, at the beginning of the message.
    hint : str
        What to do, in place of the call that makes such a value.

    Raises
    ------
    ProblemError
        With the call that makes such a value.

    Examples
    --------
    >>> from consistent_id import RobotModel
    >>> require_type("arm.urdf", RobotModel, "robot")
    Traceback (most recent call last):
    consistent_id.errors.ProblemError: robot: a str, expected a RobotModel; ...
    """
    if isinstance(value, expected):
        return
    name = expected.__name__
    path = repr(str(value)) if isinstance(value, str | Path) else "PATH"
    hint = hint or _CALLS[name].format(path)
    raise ProblemError(f"{what}: {_kind_of(value)}, expected {_a(name)}; {hint}")


def require_types(values: object, expected: type, what: str) -> None:
    """Refuse what is not a sequence of values of one type; see `require_type`.

    Examples
    --------
    >>> from consistent_id import RobotModel
    >>> require_types(3.0, RobotModel, "robots")
    Traceback (most recent call last):
    consistent_id.errors.ProblemError: robots: a float, expected a list of RobotModel...
    """
    if isinstance(values, str) or not isinstance(values, Sequence):
        raise ProblemError(
            f"{what}: {_kind_of(values)}, expected a list of {expected.__name__} values"
        )
    for value in values:
        require_type(value, expected, what)


def _kind_of(value: object) -> str:
    return _a(type(value).__name__)


def _a(noun: str) -> str:
    return f"{'an' if noun[0] in 'AEIOUaeiou' else 'a'} {noun}"

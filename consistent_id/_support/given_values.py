"""Values of a wrong type, such as a path in place of what was read from it."""

from pathlib import Path

from consistent_id.errors import ProblemError

_CALLS = {
    "RobotModel": "load_robot({}) reads one from a URDF or MJCF file",
    "TorqueModel": "TorqueModel(load_robot({})) makes one of a URDF or MJCF file",
    "Recording": "read_recording({}) reads one from a log",
    "Estimate": "open_results(FOLDER).recommended reads one from results",
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
    article = "an" if name[0] in "AEIOU" else "a"
    raise ProblemError(
        f"{what}: a {type(value).__name__}, expected {article} {name}; {hint}"
    )

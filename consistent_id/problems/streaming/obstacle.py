"""What of a problem file takes a whole recording at once, or all of them together."""

from consistent_id.errors import RecordingError
from consistent_id.problems.file import PreparationTable, RecordingTable
from consistent_id.problems.log_entries import columns_of
from consistent_id.problems.problem import Problem
from consistent_id.problems.sensor_drift_preparation import drift_of
from consistent_id.recordings.log_formats import LOG_FORMATS, log_format
from consistent_id.recordings.readers.recording_file import does_not_fit

_METHODS = ("smoother", "fourier")


def obstacle(problem: Problem) -> str:
    """Return why recordings cannot be read one after another; empty if they can."""
    data = problem.table.data
    if data is None:
        return f"problem {problem.name!r} has no recordings"
    if data.preparation.least_joint_speed == "estimated":
        return (
            "[data.preparation]: a least_joint_speed that is estimated takes all "
            "recordings at once; give the speed that a part of the log shows "
            "(rest_speed)"
        )
    if data.preparation.contact_radius == "estimated":
        return (
            "[data.preparation]: a contact_radius that is estimated takes all "
            "recordings at once; state the radius of each contact"
        )
    if drift_of(problem.table) != "none":
        return "[wrist_sensor]: drift takes all recordings at once"
    gains = data.gains
    for key in ("delay", "scale", "encoder_bias", "stiffness"):
        if gains is not None and getattr(gains, key) == "estimated":
            return (
                f"[data.gains]: a {key} that is estimated takes all recordings at "
                "once; give the value that a part of the log shows (consistent-id "
                "identify of a file with that part)"
            )
    return ""


def reason_for_whole(problem: Problem, entry: RecordingTable) -> str:
    """Return why a log is read as a whole; empty if it is read piece by piece."""
    data = problem.table.data
    if data is not None and data.gains is not None:
        return "[data.gains]: torque is made of the commands of a whole recording"
    if problem.arm is not None or problem.model.robot.floating:
        return "the motion of a base, or of a wrench sensor, is found from all of it"
    if entry.tracks:
        return "tracks are joined with whole recordings"
    path = problem.log_file(entry.file)
    known = log_format(path)
    if known.holds == "joint states":
        if data is not None and columns_of(data, path).beside.names:
            return "topics beside the joint states are read as a whole"
        if entry.omit:
            return "omit counts rows, which messages do not have"
    elif not known.in_pieces(path):
        names = ", ".join(known.name for known in LOG_FORMATS if known.streams)
        return f"piece by piece are read {names} (of version 7.3) and bags"
    return "" if data is None else _of_preparation(data.preparation)


def _of_preparation(table: PreparationTable) -> str:
    where = "[data.preparation]"
    if table.method in _METHODS:
        return (
            f'{where}: method = "{table.method}" looks at a whole recording at once; '
            '"butterworth" and "savitzky-golay" do not'
        )
    if table.least_joint_speed is not None:
        return (
            f"{where}: least_joint_speed looks at a whole recording at once; "
            "least_speed does not"
        )
    if "estimated" in table.delays.values():
        return f"{where}: a delay is estimated from a whole recording; seconds are not"
    return ""


def require_room(problem: Problem, entry: RecordingTable, reason: str) -> None:
    """Refuse to read a log as a whole that does not fit into memory.

    Raises
    ------
    RecordingError
        With the reason why it would have to be.
    """
    if lacking := does_not_fit(problem.log_file(entry.file)):
        raise RecordingError(
            f"{lacking}: {reason}. Convert it, or divide it into logs that fit; they "
            "are read one after another"
        )

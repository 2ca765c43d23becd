"""What of a problem file takes a whole recording at once."""

from consistent_id.problems.file import PreparationTable
from consistent_id.problems.problem import Problem
from consistent_id.recordings.log_formats import LOG_FORMATS, log_format


def obstacle(problem: Problem, role: str) -> str:
    """Return why the recordings of a role cannot be streamed; empty if they can."""
    data = problem.table.data
    if data is None:
        return f"problem {problem.name!r} has no recordings"
    if data.gains is not None:
        return "[data.gains]: torque is made of the commands of a whole recording"
    if found := _with_robot(problem, data.preparation):
        return found
    where, table = "[data.preparation]", data.preparation
    if table.method in ("smoother", "fourier"):
        return (
            f'{where}: method = "{table.method}" looks at a whole recording at once; '
            '"butterworth" and "savitzky-golay" do not'
        )
    if "estimated" in table.delays.values():
        return (
            f"{where}: a delay that is estimated takes a whole recording at once; give "
            "the seconds that a part of the log shows (consistent-id check)"
        )
    for entry in data.recordings:
        if entry.role != role:
            continue
        if entry.tracks:
            return (
                f"{entry.file}: tracks are joined with whole recordings; write all "
                "channels into one file"
            )
        path = problem.log_file(entry.file)
        if not log_format(path).in_pieces(path):
            known = ", ".join(known.name for known in LOG_FORMATS if known.streams)
            return (
                f"{path}: cannot be read piece by piece; that takes {known} (of "
                "version 7.3). Convert it"
            )
    return ""


def _with_robot(problem: Problem, table: PreparationTable) -> str:
    """Return which preparation takes the robot, and whole recordings."""
    if problem.arm is not None:
        return "[wrist_sensor]: what carries the sensor is looked at in memory"
    if table.most_slip is not None:
        return "[data.preparation] most_slip: feet that slip are found in memory"
    if table.least_joint_speed == "estimated":
        return (
            '[data.preparation] least_joint_speed = "estimated" is found in memory; '
            "give the speed that compare finds for a part of the log"
        )
    return ""

"""A problem's recordings, looked through for faults."""

from dataclasses import replace

from consistent_id.diagnosis import Diagnosis, diagnose
from consistent_id.problems.log_entries import drive_limits
from consistent_id.problems.problem import Problem
from consistent_id.recordings.recording import Recording

_OF_COMMANDS = (
    "the torque is made of commands: give their delay in [data.gains], in seconds or "
    'as delay = "estimated"'
)


def check_problem(problem: Problem) -> Diagnosis:
    """Look for faults in a problem's recordings."""
    roles = [problem.logs(role) for role in ("training", "validation")]
    names = [log.name for logs in roles for log in logs]
    training, validation = ([_distinct(log, names) for log in logs] for logs in roles)
    found = diagnose(
        problem.model,
        training,
        validation,
        prepare=problem.prepare,
        constraints=problem.constraints,
        limits=drive_limits(problem.gains, problem.recorded_joints),
    )
    if problem.gains is None:
        return found
    findings = (
        replace(f, advice=_OF_COMMANDS) if f.kind == "lag" else f
        for f in found.findings
    )
    return replace(found, findings=tuple(findings))


def _distinct(log: Recording, names: list[str]) -> Recording:
    """Add a log's times to its name if another part of its file has the same name."""
    if names.count(log.name) == 1:
        return log
    span = f"{log.time[0]:.4g} to {log.time[-1]:.4g} s"
    return replace(log, name=f"{log.name} ({span})")

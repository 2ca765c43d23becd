"""The check of a problem's recordings for faults."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import msgspec

from consistent_id.diagnosis import Diagnosis, LogFinding, diagnose
from consistent_id.diagnosis.joint_shifts import LONG
from consistent_id.problems.log_entries import drive_limits
from consistent_id.problems.problem import Problem
from consistent_id.recordings.recording import Recording, instant

# Seconds by which a lag may exceed the delay that is corrected.  Of torque that is 60
# or 100 ms late and nothing else, on seven arms, it does by 20 ms at most where the
# correction is right; of torque behind a filter of 1 Hz, by up to 28 ms.
_BEYOND = 0.025

_OF_DELAYS = (
    "log the torque unfiltered, or the motion through the same filter; if it is "
    "known to be only a delay, --accept lag"
)


_OF_SHORT_DELAYS = (
    "log the torque unfiltered, or the motion through the same filter; or, if it is "
    "known to be only a delay, state delays = { torque = SECONDS } in "
    "[data.preparation]: the delay that is corrected is another one"
)

# Findings about a drives' filter whose delay is corrected.
_EFFECTS = ("clock", "masses or gain", "offset zero", "gravity", "lag")


def check_problem(problem: Problem) -> Diagnosis:
    """Look for faults in a problem's recordings.

    A filter of the drives also causes a delay.  The preparation's correction of a delay
    hides it, so for a long delay the uncorrected recordings are checked, too.
    """
    found = _checked(problem, problem.prepare)
    sure = [f for f in found.faults if f.kind not in _EFFECTS]
    if not sure and abs(delay_of_torque(problem)) >= LONG:
        late = _checked(problem, _without_delay(problem).prepare)
        hidden = _hidden(problem, late)
        kept = _beside(found.findings, hidden)
        found = replace(found, findings=(*kept, *hidden))
    more = *_late_torque(problem), *_assumed_gains(problem)
    found = replace(found, findings=(*found.findings, *more))
    if problem.gains is None:
        return found
    delay = problem.delay_of_commands
    return replace(
        found, findings=tuple(_of_commands(f, delay) for f in found.findings)
    )


def _of_commands(finding: LogFinding, delay: float) -> LogFinding:
    """Return a finding; the advice on a lag of torque is on commands, which cause it.

    A longer delay of commands makes their torque later, never earlier.

    Parameters
    ----------
    finding : LogFinding
        A lag of velocities has no size.
    delay : float, [s]
        The delay of commands with which their torque was computed.
    """
    if finding.kind != "lag" or not finding.size:
        return finding
    now = f"their delay in [data.gains] is {1e3 * delay:.3g} ms"
    if float(finding.size) > 0.0:
        cause = f"{now}: it is too long, or they" if delay > 0.0 else "they"
        advice = f"{cause} were logged later than they acted: check their clock"
    elif delay > 0.0:
        advice = (
            f"{now} already: look for a filter of the drives, and for friction that "
            "the model lacks, before you state a longer one"
        )
    else:
        advice = (
            'state their delay in [data.gains], in seconds or as delay = "estimated"; '
            "if it was found to be zero, look for a filter of the drives"
        )
    return replace(finding, advice=f"the torque is made of commands; {advice}")


def _beside(
    found: Sequence[LogFinding], hidden: Sequence[LogFinding]
) -> tuple[LogFinding, ...]:
    """Return findings, with those that a correction of the delay hides.

    A filter that explains the log replaces the findings that it causes. Where the
    filter is uncertain, they are uncertain, too.
    """
    if any(f.severity == "fault" for f in hidden):
        return tuple(f for f in found if f.kind not in _EFFECTS)
    return tuple(
        replace(f, severity="warning")
        if hidden and f.kind in _EFFECTS and f.severity == "fault"
        else f
        for f in found
    )


def _late_torque(problem: Problem) -> tuple[LogFinding, ...]:
    """Return the delay of a floating robot's torque, if its interval excludes zero.

    This is a note and no warning: the fit corrects the delay, and the intervals contain
    its error.
    """
    data = problem.table.data
    if data is None or data.preparation.delays.get("torque") != "estimated":
        return ()
    delay = problem.found_in_training.delay
    if delay is None or not delay.significant:
        return ()
    is_now = "later" if delay.seconds > 0.0 else "earlier"
    cause = "" if delay.seconds > 0.0 else ", as if stamped before it acts"
    return (
        LogFinding(
            "lag",
            "note",
            "all joints",
            f"the torque is {1e3 * abs(delay.seconds):.2f} ms (+- "
            f"{1e3 * delay.half_width:.2f}, 95 %) {is_now} than the motion{cause}; the "
            "fit corrects it, and the intervals contain its error",
            "state delays = { torque = SECONDS } in [data.preparation] if it is known",
            abs(delay.seconds) / delay.half_width,
        ),
    )


def _assumed_gains(problem: Problem) -> tuple[LogFinding, ...]:
    """Warn where the model's bodies are the only source of the torque gains."""
    data = problem.table.data
    if data is None or data.gain_source == "drives":
        return ()
    return (
        LogFinding(
            "assumed gains",
            "warning",
            "all joints",
            "the gains of the torque were taken from the model's bodies, and no log "
            "shows whether these are right; if not, masses and inertias are as wrong. "
            "Torque in the log's own unit does not depend on it",
            "state the drives' gains without --gain-source model, or weigh a known "
            "load: consistent-id gains",
            1.0,
        ),
    )


def _checked(problem: Problem, prepare: Callable[[Recording], Recording]) -> Diagnosis:
    training, validation = named_logs(problem)
    return diagnose(
        problem.model,
        training,
        validation,
        prepare=prepare,
        constraints=problem.constraints,
        limits=drive_limits(problem.gains, problem.recorded_joints),
    )


def named_logs(problem: Problem) -> tuple[list[Recording], list[Recording]]:
    """Return training and validation logs, with their names in findings."""
    roles = [problem.logs(role) for role in ("training", "validation")]
    names = [log.name for logs in roles for log in logs]
    training, validation = ([_distinct(log, names) for log in logs] for logs in roles)
    return training, validation


def delay_of_torque(problem: Problem) -> float:
    """Return the stated delay of the torque that the preparation corrects, [s]."""
    data = problem.table.data
    stated = 0.0 if data is None else data.preparation.delays.get("torque", 0.0)
    return 0.0 if stated == "estimated" else float(stated)


def _without_delay(problem: Problem) -> Problem:
    """Return a problem with the torque as recorded."""
    data = problem.table.data
    if data is None:
        return problem
    delays = {k: d for k, d in data.preparation.delays.items() if k != "torque"}
    preparation = msgspec.structs.replace(data.preparation, delays=delays)
    data = msgspec.structs.replace(data, preparation=preparation)
    return replace(problem, table=msgspec.structs.replace(problem.table, data=data))


def _hidden(problem: Problem, late: Diagnosis) -> tuple[LogFinding, ...]:
    """Return the finding that causes a delay: a filter of the drives, or their lag."""
    if filters := late.of("drive filter"):
        return filters
    corrected = delay_of_torque(problem)
    undone = (
        f"; [data.preparation] corrects a delay of {1e3 * corrected:.3g} ms, but it "
        "cannot correct a filter"
    )
    found = []
    for lag in late.of("lag"):
        if lag.severity == "note" or not lag.size:  # a velocity's
            continue
        wrong = abs(float(lag.size) - corrected) > _BEYOND
        found.append(
            replace(
                lag,
                severity="fault" if wrong else "warning",
                statement=lag.statement + undone,
                advice=_OF_SHORT_DELAYS if wrong else _OF_DELAYS,
            )
        )
    return tuple(found)


def _distinct(log: Recording, names: list[str]) -> Recording:
    """Add a log's times to its name if another part of its file has the same name."""
    if names.count(log.name) == 1:
        return log
    first, last = (instant(end, log.time) for end in log.time[[0, -1]])
    return replace(log, name=f"{log.name} ({first} to {last} s)")

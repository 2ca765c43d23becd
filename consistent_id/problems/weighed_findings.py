"""Warnings about a log, weighed by their effect on the estimate.

A warning may concern a few outliers, rests, a joint with coarse torque, or an odd part
of the validation data.  The estimate is computed again without these rows, without that
joint's torque, or with that part.  If it changes by less than a standard error, the
warning becomes a note.  Several warnings without effect are also tested together.
Rests in validation data change no estimate: they are a note up to half of the samples.

Faults are not weighed, because a log with a fault is not searched for others.  Findings
about the whole robot, such as a clock or a gain, are not weighed either.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import reduce

import numpy as np

from consistent_id.diagnosis.coverage import standing_share
from consistent_id.diagnosis.signal_faults import (
    position_steps,
    spike_findings,
    torque_spikes,
)
from consistent_id.errors import RecordingError
from consistent_id.estimation.estimate import Estimate
from consistent_id.estimation.influence import (
    Influence,
    influence,
    least_squares_on,
    without,
)
from consistent_id.problems.log_check import delay_of_torque, named_logs
from consistent_id.problems.preparation import rest_reach
from consistent_id.problems.problem import Problem
from consistent_id.problems.robot_preparation import drift_of, not_too_fast
from consistent_id.recordings.recording import LogFinding, Recording
from consistent_id.recordings.signals.filtered_rows import altered
from consistent_id.recordings.signals.masks import mask_onto, without_standstill

_ROLES = ("training", "validation")
_OF_JOINTS = ("noise", "torque resolution")
# Findings in validation data that concern a joint's torque, or samples.
_OF_A_PART = (*_OF_JOINTS, "outliers", "encoder resolution", "speed limit")
# Findings in training data that concern samples of all joints.
_OF_SAMPLES = ("encoder resolution", "standstill")
# In a part that is too short, the absence of a change proves nothing.
_OF_EXTENT = ("short", "small motion", "slow motion")
# Most of held-out samples at rest: errors in motion are at most 1.4 times larger.
_RESTS = 0.5
_AROUND = 3.0  # samples about an outlier that are left out with it
_SEED = 0  # of the rounding errors that are added to a coarse position

_Cut = Callable[[Recording], Recording]


@dataclass(frozen=True, slots=True, eq=False)
class _DataPart:
    """A part of the training data.

    Parameters
    ----------
    words : str
    joints : tuple of str
        Joints whose whole torque is the part.
    cut : callable, optional
        Function that marks the torque of the part's rows as unknown in a recording.
    """

    words: str
    joints: tuple[str, ...] = ()
    cut: _Cut | None = None


def weighed_findings(
    problem: Problem,
    findings: Sequence[LogFinding],
    candidate: Callable[[], Estimate],
    training: Sequence[Recording],
    validation: Sequence[Recording],
) -> tuple[LogFinding, ...]:
    """Return findings, with notes in place of warnings without effect.

    Parameters
    ----------
    problem : Problem
    findings : sequence of LogFinding
        Findings of the diagnosis.
    candidate : callable
        Returns the constrained estimate from the training recordings; it is called if
        a finding can be weighed.
    training, validation : sequence of Recording
        Prepared recordings.
    """
    if drift_of(problem.table) != "none":
        return tuple(findings)
    warnings = [
        f for f in findings if f.severity == "warning" and f.kind not in _OF_EXTENT
    ]
    held_out = {log.name for log in named_logs(problem)[1]}
    notes: dict[int, LogFinding] = {}
    parts: dict[int, _DataPart] = {}
    for finding in warnings:
        unseen, part = finding.recording in held_out, None
        if unseen and finding.kind not in (*_OF_A_PART, "standstill"):
            continue
        if not unseen and finding.kind not in _OF_SAMPLES:
            part = _part(problem, finding, training)
            if part is None:
                continue
        estimate = candidate()
        if estimate.fitted_under is None:
            return tuple(findings)
        if unseen and finding.kind == "standstill":
            notes |= _rests_held_out(problem, finding)
            continue
        if unseen:
            change = _of_more(problem, finding, estimate, training, validation)
            words = "with this recording"
        elif finding.kind == "encoder resolution":
            change = _of_rounding(problem, finding, estimate)
            words = "with other rounding errors"
        elif finding.kind == "standstill":
            change = _of_rests(problem, finding, estimate, training)
            words = "without these samples"
        elif part is not None:
            change = _of_part(estimate, training, [part])
            words = part.words
            parts[id(finding)] = part
        if change is not None and change.small:
            notes[id(finding)] = _noted(finding, words, change)
    together = [part for key, part in parts.items() if key in notes]
    if len(together) > 1:
        change = _of_part(candidate(), training, together)
        if change is None or not change.small:
            notes = {key: note for key, note in notes.items() if key not in parts}
    return tuple(notes.get(id(f), f) for f in findings)


def _noted(finding: LogFinding, words: str, change: Influence) -> LogFinding:
    said = (
        f"{finding.statement}; {words} the estimate changes by "
        f"{change.largest:.2g} standard errors"
    )
    return replace(finding, severity="note", statement=said)


def _part(
    problem: Problem, finding: LogFinding, training: Sequence[Recording]
) -> _DataPart | None:
    """Return the part of the training data that a finding concerns, if it is one."""
    robot, reach = problem.moving, _reach(problem)
    if finding.kind == "speed limit":
        return _DataPart(
            "without these samples",
            cut=lambda log: not_too_fast(robot, log, "model", reach),
        )
    joints = tuple(finding.where.split(", "))
    if not set(joints) <= set(problem.model.torque_joints):
        return None
    if finding.kind == "outliers" and len(joints) == 1:
        if finding.recording not in {_logged_as(problem, r) for r in training}:
            return None  # nothing would be removed
        cut = _outliers(problem, finding)
        return cut and _DataPart("without these samples", cut=cut)
    if finding.kind in _OF_JOINTS:
        return _DataPart("without the torque of this joint", joints)
    return None


def _of_rests(
    problem: Problem,
    finding: LogFinding,
    estimate: Estimate,
    training: Sequence[Recording],
) -> Influence | None:
    """Return the effect of the rests of a recording, in standard errors.

    Without its rests a log has all its motion, so standard errors tell enough.  None if
    it is not certain which recording it is: nothing would be removed.
    """
    if finding.recording not in {_logged_as(problem, r) for r in training}:
        return None

    def cut(log: Recording) -> Recording:
        own = _logged_as(problem, log) == finding.recording
        return without_standstill(log, reach=_reach(problem)) if own else log

    found = _of_part(estimate, training, [_DataPart("", cut=cut)])
    return found and replace(found, elsewhere=0.0)


def _rests_held_out(problem: Problem, finding: LogFinding) -> dict[int, LogFinding]:
    """Return the note on rests of a held-out recording, unless they are most of it."""
    _, held_out = named_logs(problem)
    (log, *others) = (one for one in held_out if one.name == finding.recording)
    if others or (share := standing_share(log)) > _RESTS:
        return {}
    times = 1.0 / np.sqrt(1.0 - share)
    said = (
        f"{finding.statement}; in motion, errors are at most {times:.1f} times larger"
    )
    return {id(finding): replace(finding, severity="note", statement=said)}


def _outliers(problem: Problem, finding: LogFinding) -> _Cut | None:
    """Return a function that marks the outliers of a finding as unknown.

    The result is None if they are not found again.
    """
    training, _ = named_logs(problem)
    joint, at = finding.where, None
    for own in (log for log in training if log.name == finding.recording):
        part = own.of((joint,))
        for others in (training, ()):
            said = [f.statement for f in spike_findings(part, others)]
            if at is None and finding.statement in said:
                at = own, torque_spikes(part, joint, others)
    if at is None:
        return None
    log, mask = at
    step = float(np.median(np.diff(log.time)))
    reach = abs(delay_of_torque(problem)) + _AROUND * step

    def change(whole: Recording) -> Recording:
        known = np.ones(whole.position.shape, dtype=np.bool_)
        if whole.torque_known is not None:
            known &= whole.torque_known
        k = whole.joints.index(joint)
        column, part = whole.of((joint,)), log.of((joint,))
        known[:, k] &= ~mask_onto(part, mask[:, None], column, reach=reach)[:, 0]
        return replace(whole, torque_known=known)

    def cut(prepared: Recording) -> Recording:
        own = _logged_as(problem, prepared) == finding.recording
        return altered(prepared, change) if own else prepared

    return cut


def _logged_as(problem: Problem, prepared: Recording) -> str | None:
    """Return the name of a prepared recording's log in findings.

    None if it is not certain: names of parts begin with those of their log, and their
    times are within it.
    """
    found = []
    for role, named in zip(_ROLES, named_logs(problem), strict=True):
        for raw, log in zip(problem.logs(role), named, strict=True):
            step = float(np.median(np.diff(raw.time)))
            first, last = prepared.time[[0, -1]]
            within = raw.time[0] - step <= first and last <= raw.time[-1] + step
            part = prepared.name.startswith((f"{raw.name} ", f"{raw.name},"))
            if within and (part or prepared.name == raw.name):
                found.append(log.name)
    return found[0] if len(found) == 1 else None


def _reach(problem: Problem) -> float:
    data = problem.table.data
    return 0.0 if data is None else rest_reach(data.preparation)


def _of_part(
    estimate: Estimate, training: Sequence[Recording], parts: Sequence[_DataPart]
) -> Influence | None:
    """Return the effect of leaving out parts of the training data together."""
    joints = {joint for part in parts for joint in part.joints}
    cuts = [part.cut for part in parts if part.cut is not None]
    try:
        logs = [reduce(lambda r, cut: cut(r), cuts, log) for log in training]
    except RecordingError:
        return None
    refit = without(estimate, logs, joints=tuple(joints))
    whole = least_squares_on(estimate, training)
    if refit is None or whole is None:
        return None
    change = estimate.parameters - refit.parameters
    return influence(estimate, change, refit.free, whole)


def _of_more(
    problem: Problem,
    finding: LogFinding,
    estimate: Estimate,
    training: Sequence[Recording],
    validation: Sequence[Recording],
) -> Influence | None:
    """Return the effect of adding a finding's recording to the fit."""
    own = [r for r in validation if _logged_as(problem, r) == finding.recording]
    return _of_part(estimate, (*training, *own), ()) if own else None


def _of_rounding(
    problem: Problem, finding: LogFinding, estimate: Estimate
) -> Influence | None:
    """Return the effect of other rounding errors in one joint's positions."""
    rng, logs = np.random.default_rng(_SEED), problem.logs("training")
    if finding.where not in logs[0].joints:
        return None
    rounded = []
    for log in logs:
        column = np.array(log.joints) == finding.where
        error = rng.uniform(-0.5, 0.5, len(log))[:, None] * position_steps(log)
        rounded.append(replace(log, position=log.position + error * column))
    refits = [
        without(estimate, [problem.prepare(log) for log in each])
        for each in (logs, rounded)
    ]
    if refits[0] is None or refits[1] is None:
        return None
    change = refits[1].parameters - refits[0].parameters
    return influence(estimate, change, refits[0].free)

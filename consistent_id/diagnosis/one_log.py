"""Faults of one recording: of single signals first, then of all signals together."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from consistent_id.constraints import Constraint
from consistent_id.diagnosis.alternatives import alternatives, leaning_findings
from consistent_id.diagnosis.clock import clock_findings, velocity_findings
from consistent_id.diagnosis.corrections import corrections
from consistent_id.diagnosis.coverage import (
    extent_findings,
    in_motion,
    motion_noise_findings,
    of_samples,
    rank_findings,
    saturation_findings,
    standstill_findings,
)
from consistent_id.diagnosis.explain import (
    SAMPLES,
    Candidate,
    Explanations,
    FittedLog,
    corrected,
    explained_by_friction,
    explanation_finding,
    explanations,
    fitted_log,
    masses_known,
    thinned,
    unexplained_findings,
)
from consistent_id.diagnosis.factor_logs import FactorLogs
from consistent_id.diagnosis.findings import LogFinding
from consistent_id.diagnosis.frozen_channels import (
    frozen_findings,
    named_as_constant,
    standing_findings,
)
from consistent_id.diagnosis.signal_faults import (
    hold_findings,
    jump_findings,
    noise_findings,
    noise_share,
    position_steps,
    resolution_findings,
    spike_findings,
)
from consistent_id.diagnosis.torque_channel import channel_findings, nothing_findings
from consistent_id.diagnosis.torque_parts import torque_parts
from consistent_id.diagnosis.whole_robot import doubted_gain
from consistent_id.diagnosis.wrong_units import (
    effort_findings,
    speed_findings,
    travel_findings,
)
from consistent_id.errors import InfeasibleError, NotExcitedError, SolverError
from consistent_id.recordings.recording import Recording
from consistent_id.regression.base import BaseParameters, base_parameters
from consistent_id.regression.regressor import TorqueModel
from consistent_id.robot.scaling import placeholders

Prepare = Callable[[Recording], Recording]

_LITTLE = (
    "standstill",
    "small motion",
    "slow motion",
)  # with these, no other finding is certain

# Causes that slopes on the nominal model suggest.  Other causes can have the same
# slopes, so these are named only if nothing else explains the log.
_GUESSED = ("torque gain", "clock")


@dataclass(frozen=True, slots=True, eq=False)
class OpenLog:
    """A log in which no fault was found so far.

    Parameters
    ----------
    signals : tuple of LogFinding
        Findings about single channels.
    odd : tuple of LogFinding
        Findings that a wrong zero offset, gain or lag may explain.
    """

    as_is: FittedLog
    signals: tuple[LogFinding, ...]
    odd: tuple[LogFinding, ...]


def findings_of(
    model: TorqueModel,
    log: Recording,
    constraints: Sequence[Constraint],
    base: BaseParameters,
    prepare: Prepare,
    limits: Mapping[str, float] | None,
    besides: Sequence[Recording] = (),
) -> list[LogFinding] | OpenLog:
    """Return the findings about one recording, or the log if it has no fault so far.

    Parameters
    ----------
    besides : sequence of Recording
        Other recordings of the same channels, which show how large their torque is.
    """
    found = signal_findings(model, log)
    if any(f.severity == "fault" for f in found):
        return found
    rows = prepare(log).of(model.robot.joint_names)
    prepared = thinned(rows, SAMPLES)
    whole = of_samples(rows)
    motion = thinned(whole, SAMPLES)
    found += [] if found else extent_findings(motion)
    try:
        ranks = rank_findings(model, prepared, base, position_steps(log))
    except NotExcitedError as cause:
        return [*found, _without_rows(cause)]
    found += ranks
    if any(f.severity == "fault" or f.kind in _LITTLE for f in found):
        return found
    if not ranks:  # otherwise some columns are only noise, as that finding says
        found += motion_noise_findings(
            model, log, lambda raw: of_samples(prepare(raw)), base, prepared=whole
        )
    moving = in_motion(model, motion)
    if moving.torque_joints != model.torque_joints:
        model, base = moving, base_parameters(moving)
    torque = log.of(model.torque_joints)
    found += spike_findings(torque, besides) + noise_findings(torque, besides)
    found += effort_findings(model.robot, torque)
    found += speed_findings(model.robot, whole)
    coarse = resolution_findings(log, torque)
    stepped = {f.where for f in coarse}
    found += coarse + hold_findings(torque)
    pinned = saturation_findings(torque, limits)
    found += (f for f in pinned if f.where not in stepped)
    if any(f.severity == "fault" for f in found):
        return found
    noise = float(np.sqrt(np.mean(noise_share(np.asarray(torque.torque)) ** 2)))
    short = any(f.kind == "short" for f in found)
    more = _dynamic(model, prepared, constraints, base, noise, short)
    if isinstance(more, list):
        return found + more
    return replace(more, signals=tuple(found))


def _without_rows(cause: NotExcitedError) -> LogFinding:
    """Say that a joint has no rows, so that torque and motion are not examined."""
    return LogFinding(
        "rank",
        "warning",
        "all joints",
        f"torque and motion are not examined: {cause}",
        "record a longer or faster motion of that joint, or leave out fewer rows "
        "(least_joint_speed in [data.preparation])",
        1.0,
    )


def signal_findings(model: TorqueModel, log: Recording) -> list[LogFinding]:
    """Return faults of clock, positions and velocities, which need no drive model.

    Parameters
    ----------
    log : Recording
        As it was logged, with the robot's joints.
    """
    clock = clock_findings(log)
    if clock:
        return clock + travel_findings(model.robot, log)  # of which time says nothing
    signals = [*frozen_findings(_with_torque_of(log, model)), *jump_findings(log)]
    signals = signals or standing_findings(log)
    signals = signals or velocity_findings(log) or travel_findings(model.robot, log)
    return standstill_findings(log) + signals


def _with_torque_of(log: Recording, model: TorqueModel) -> Recording:
    """Return a log in which torques that the model does not use are never constant."""
    if len(model.torque_joints) == len(log.joints):
        return log
    used = np.isin(log.joints, model.torque_joints)
    torque = np.where(used, np.asarray(log.torque), np.asarray(log.position))
    return replace(log, torque=torque)


def _dynamic(
    model: TorqueModel,
    prepared: Recording,
    constraints: Sequence[Constraint],
    base: BaseParameters,
    noise: float,
    short: bool,
) -> list[LogFinding] | OpenLog:
    """Return faults that show in torque and motion together.

    In a log that ends before joints turn back, friction looks like an offset, so that
    the gain alone is uncertain and no fault.
    """
    known = model.robot.nominal is not None and not placeholders(model.robot)
    parts = torque_parts(model, prepared) if known else None
    channel = [] if parts is None else channel_findings(parts)
    if short:
        channel = [
            replace(f, severity="warning") if f.kind == "torque gain" else f
            for f in channel
        ]
    if any(_of_all_gains(f) for f in channel):
        stated = masses_known(constraints)
        beside = FactorLogs.of(model, [prepared], masses_known=stated)
        channel = [doubted_gain(f, beside) if _of_all_gains(f) else f for f in channel]
    guessed = [f for f in channel if f.severity == "fault" and f.kind in _GUESSED]
    if guessed and parts and (leaning := leaning_findings(model, prepared, parts)):
        return leaning
    if not guessed and any(f.severity == "fault" for f in channel):
        return channel
    try:
        as_is = fitted_log(model, prepared, constraints, base)
    except (InfeasibleError, SolverError) as failure:
        statement = f"no robot with the datasheet's values explains the log: {failure}"
        advice = "check masses and bounds; see the certificate of each method"
        return [LogFinding("datasheet", "fault", prepared.name, statement, advice)]
    candidates: list[Candidate] = []
    if not explained_by_friction(as_is, noise):
        candidates += corrected(as_is, corrections(model.robot, model.torque_joints))
        candidates += alternatives(as_is)
    found = explanations(as_is, candidates, noise)
    best = found.best
    if best is not None and not best.cause.excuse:
        return [named_as_constant(explanation_finding(best), prepared)]
    if guessed:
        rivals = any(e.cause.excuse == 0 for e in found.explained)
        return [_undecided(f, found) for f in guessed] if rivals else guessed
    missing = unexplained_findings(as_is, found)
    if missing and parts is not None and (nothing := nothing_findings(parts)):
        return nothing
    excuse = [] if best is None else [explanation_finding(best)]
    return OpenLog(as_is, (), tuple(excuse or [*missing, *channel]))


def _of_all_gains(finding: LogFinding) -> bool:
    return finding.kind == "torque gain" and finding.where == "all joints"


def _undecided(finding: LogFinding, found: Explanations) -> LogFinding:
    """Return a guessed cause together with the other causes that explain the log."""
    others = "; ".join(
        f"{e.cause.statement} the misfit would be {e.misfit:.1%}"
        for e in found.explained[:3]
    )
    return replace(
        finding,
        kind="model does not explain",
        statement=f"{finding.statement}; but {others}, so the cause is not known",
    )

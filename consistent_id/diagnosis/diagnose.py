"""All detectors, one after another."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from consistent_id._support.arrays import Vector
from consistent_id._support.threads import single_threaded
from consistent_id.constraints import Constraint
from consistent_id.constraints.distances import nominal_distance
from consistent_id.diagnosis.alternatives import alternatives
from consistent_id.diagnosis.beyond_limits import effort_findings, travel_findings
from consistent_id.diagnosis.clock import clock_findings, velocity_findings
from consistent_id.diagnosis.corrections import corrections
from consistent_id.diagnosis.coverage import (
    extent_findings,
    in_motion,
    rank_findings,
    saturation_findings,
    standstill_findings,
)
from consistent_id.diagnosis.explain import (
    SAMPLES,
    Explanations,
    FittedLog,
    corrected,
    datasheet_constraints,
    explanation_finding,
    explanations,
    fitted_log,
    thinned,
    unexplained_findings,
)
from consistent_id.diagnosis.findings import Diagnosis, Finding
from consistent_id.diagnosis.linearise import Linearised, linearised
from consistent_id.diagnosis.model_faults import model_findings, placeholders
from consistent_id.diagnosis.motion_noise import motion_noise_findings
from consistent_id.diagnosis.other_gravity import leaning_findings
from consistent_id.diagnosis.repeats import leak_findings
from consistent_id.diagnosis.shift_findings import (
    hidden_zeros,
    lag_findings,
    shift_findings,
)
from consistent_id.diagnosis.signal_faults import (
    frozen_findings,
    hold_findings,
    jump_findings,
    noise_findings,
    noise_share,
    position_steps,
    resolution_findings,
    spike_findings,
)
from consistent_id.diagnosis.small_shifts import moved_channels
from consistent_id.diagnosis.torque_channel import channel_findings, nothing_findings
from consistent_id.diagnosis.torque_parts import torque_parts
from consistent_id.errors import InfeasibleError, SolverError
from consistent_id.estimation.penalised import penalised_fit
from consistent_id.recordings.recording import Recording
from consistent_id.regression.base import BaseParameters, base_parameters
from consistent_id.regression.regressor import TorqueModel
from consistent_id.robot.model import RobotModel

Prepare = Callable[[Recording], Recording]

_LITTLE = ("standstill", "small motion", "slow motion")  # nothing more can be told
# Of the torque, that zeros and gains have to explain: friction that no model knows
# leaves 0.3 to 2 %, of which a zero may take 0.6 % where little else shows it.
_WORTH = 0.008
_LARGE = 2.0  # times a gain that is worth report, or what is sure of it
# Causes that slopes on the nominal model suggest, and other causes may as well: they
# are named if nothing else explains the log.
_GUESSED = ("torque gain", "clock")
_PULL = 1e-4  # squared misfit that a typical distance to the nominal robot weighs


@single_threaded
def diagnose(
    model: TorqueModel,
    training: Recording | Sequence[Recording],
    validation: Sequence[Recording] = (),
    *,
    prepare: Prepare | None = None,
    constraints: Sequence[Constraint] | None = None,
    base: BaseParameters | None = None,
    limits: Mapping[str, float] | None = None,
) -> Diagnosis:
    """Look for what is wrong with recordings of a robot.

    Parameters
    ----------
    model : TorqueModel
    training, validation : sequence of Recording
        As they were logged, with torque; all are looked at, and whether validation
        repeats training.  Of validation without torque only that is asked.
    prepare : callable, optional
        From a recording as logged to one with velocity and acceleration, such as
        filtering and differentiating; by default they are taken as prepared.  It is
        called twice for each recording, as it is and with one reading changed, so it
        has to treat all joints alike and to keep constants: corrections are applied to
        what it returns.
    constraints : sequence of Constraint, optional
        What is known of the robot; by default physical consistency, friction that
        dissipates, and the datasheet's masses where they are known.
    base : BaseParameters, optional
    limits : mapping of str to float, optional, [N m or N]
        Of joints whose torque was made of commands and clipped where drives clip it.

    Returns
    -------
    Diagnosis
        Faults of the clock and of the kinematics are reported alone: what they do to
        the torque is their consequence.  Torque is looked at of the model's
        `torque_joints` only.  Of a robot whose base floats, channels are looked at by
        themselves.
    """
    training = [training] if isinstance(training, Recording) else list(training)
    base = base_parameters(model) if base is None else base
    constraints = datasheet_constraints(model) if constraints is None else constraints
    ready: Prepare = (lambda recording: recording) if prepare is None else prepare
    found = [*leak_findings(training, validation), *model_findings(model.robot)]
    if any(f.kind == "units" for f in found):
        return Diagnosis(tuple(found), tuple(log.name for log in training))
    looked_at = [*training, *(v for v in validation if v.torque is not None)]
    if model.robot.floating:
        return _of_signals(model.robot, found, [*training, *validation])
    open_: list[_Open] = []
    for recording in looked_at:
        log = recording.of(model.robot.joint_names)
        of_one = _of_one(model, log, constraints, base, ready, limits)
        if isinstance(of_one, _Open):
            open_.append(of_one)
        else:
            found += [replace(f, recording=log.name) for f in of_one]
    found += _of_all(open_) if open_ else []
    return Diagnosis(tuple(found), tuple(log.name for log in looked_at))


def _of_signals(
    robot: RobotModel, found: Sequence[Finding], logs: Sequence[Recording]
) -> Diagnosis:
    """Return what channels show by themselves, of a robot whose base moves.

    What is told from torque and motion together is of robots on a fixed base.
    """
    found = list(found)
    for recording in logs:
        of_one = clock_findings(recording)
        if not of_one:
            of_one = [*jump_findings(recording), *velocity_findings(recording)]
            if len(robot):
                of_one += travel_findings(robot, recording.of(robot.joint_names))
            if recording.torque is not None:
                of_one += frozen_findings(recording) + spike_findings(recording)
                of_one += noise_findings(recording) + saturation_findings(recording)
        found += [replace(f, recording=recording.name) for f in of_one]
    names = tuple(log.name for log in logs)
    return Diagnosis(tuple(found), names, by_themselves=True)


@dataclass(frozen=True, slots=True, eq=False)
class _Open:
    """A log without a fault so far.

    Parameters
    ----------
    signals : tuple of Finding
        Of its channels by themselves.
    odd : tuple of Finding
        What a zero, a gain or a lag may be the cause of.
    """

    as_is: FittedLog
    signals: tuple[Finding, ...]
    odd: tuple[Finding, ...]


def _of_all(open_: Sequence[_Open]) -> list[Finding]:
    """Return what is found in the logs without a fault, taken together.

    What explains a log stands before what is odd about it; about a log that no robot
    explains, a small lag means nothing.
    """
    alike: dict[tuple[str, ...], list[FittedLog]] = {}
    for one in open_:
        alike.setdefault(one.as_is.factors.model.torque_joints, []).append(one.as_is)
    shifts = [finding for logs in alike.values() for finding in _shifts(logs)]
    shown = any(f.severity == "fault" for f in shifts)
    lost = not shown and any(f.severity == "fault" for o in open_ for f in o.odd)
    found = [f for f in shifts if not (lost and f.severity == "warning")]
    for one in open_:
        odd = () if shown else one.odd
        name = one.as_is.recording.name
        found += [replace(f, recording=name) for f in (*one.signals, *odd)]
    return found


def _of_one(
    model: TorqueModel,
    log: Recording,
    constraints: Sequence[Constraint],
    base: BaseParameters,
    prepare: Prepare,
    limits: Mapping[str, float] | None,
) -> list[Finding] | _Open:
    """Return what is found in one recording: of signals first, of their sense last."""
    found = signal_findings(model, log)
    if any(f.severity == "fault" for f in found):
        return found
    whole = prepare(log).of(model.robot.joint_names)
    prepared = thinned(whole, SAMPLES)
    found += [] if found else extent_findings(prepared)
    ranks = rank_findings(model, prepared, base, position_steps(log))
    found += ranks
    if any(f.severity == "fault" or f.kind in _LITTLE for f in found):
        return found
    if not ranks:  # else some columns are noise alone, as that finding says
        found += motion_noise_findings(model, log, prepare, base, prepared=whole)
    moving = in_motion(model, prepared)
    if moving.torque_joints != model.torque_joints:
        model, base = moving, base_parameters(moving)
    torque = log.of(model.torque_joints)
    found += spike_findings(torque) + noise_findings(torque)
    found += effort_findings(model.robot, torque)
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


def signal_findings(model: TorqueModel, log: Recording) -> list[Finding]:
    """Return what clock, positions and velocities show, whatever the drives' model is.

    Parameters
    ----------
    log : Recording
        Of the robot's joints, as it was logged.
    """
    clock = clock_findings(log)
    if clock:
        return clock
    signals = [*frozen_findings(_with_torque_of(log, model)), *jump_findings(log)]
    signals = signals or velocity_findings(log) or travel_findings(model.robot, log)
    return standstill_findings(log) + signals


def _with_torque_of(log: Recording, model: TorqueModel) -> Recording:
    """Return a log in which torques that the model does without are never still."""
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
) -> list[Finding] | _Open:
    """Return what only torque and motion together show.

    In a log that is over before joints turn back, friction is an offset that grows with
    speed, as gravity is one that grows with position: a gain alone is no fault.
    """
    known = model.robot.nominal is not None and not placeholders(model.robot)
    parts = torque_parts(model, prepared) if known else None
    channel = [] if parts is None else channel_findings(parts)
    if short:
        channel = [
            replace(f, severity="warning") if f.kind == "torque gain" else f
            for f in channel
        ]
    guessed = [f for f in channel if f.severity == "fault" and f.kind in _GUESSED]
    if guessed and parts and (leaning := leaning_findings(model, prepared, parts)):
        return leaning
    if not guessed and any(f.severity == "fault" for f in channel):
        return channel
    try:
        as_is = fitted_log(model, prepared, constraints, base)
    except (InfeasibleError, SolverError) as failure:
        statement = f"no robot of the datasheet explains the log: {failure}"
        advice = "check masses and bounds; see the certificate of each method"
        return [Finding("datasheet", "fault", prepared.name, statement, advice)]
    candidates = corrected(as_is, corrections(model.robot, model.torque_joints))
    candidates += alternatives(as_is)
    found = explanations(as_is, candidates, noise)
    best = found.best
    if best is not None and not best.cause.excuse:
        return [explanation_finding(best)]
    if guessed:
        rivals = any(e.cause.excuse == 0 for e in found.explained)
        return [_undecided(f, found) for f in guessed] if rivals else guessed
    missing = unexplained_findings(as_is, found)
    if missing and parts is not None and (nothing := nothing_findings(parts)):
        return nothing
    excuse = [] if best is None else [explanation_finding(best)]
    return _Open(as_is, (), tuple(excuse or [*missing, *channel]))


def _undecided(finding: Finding, found: Explanations) -> Finding:
    """Return what is guessed beside other causes that explain the log."""
    others = "; ".join(
        f"{e.cause.statement} {e.misfit:.1%} would be left" for e in found.explained[:3]
    )
    return replace(
        finding,
        kind="model does not explain",
        statement=f"{finding.statement}; but {others}, so that no cause is known",
    )


def _shifts(logs: Sequence[FittedLog]) -> list[Finding]:
    """Return zeros and gains that are off in all logs together, and each log's lag.

    The same joints move in all of them.
    """
    model = logs[0].factors.model
    try:
        moved = moved_channels(
            model, lambda sizes: [_linearised(_moved(log, sizes)) for log in logs]
        )
    except (InfeasibleError, SolverError):
        return []  # a correction that no robot explains is none
    lags = [
        replace(f, recording=log.recording.name)
        for log, system in zip(logs, moved.systems, strict=True)
        for f in lag_findings(system)
    ]
    if any(f.severity == "fault" for f in lags):
        return lags  # beyond which linearisation tells little
    found = shift_findings(model, moved)
    if found and _explained(logs, moved.sizes) < _WORTH:
        found = [_unsure(f) for f in found]
    return [*found, *hidden_zeros(model, moved), *lags]


def _explained(logs: Sequence[FittedLog], sizes: Vector) -> float:
    """Return the part of the torque that shifts explain, relative to it."""
    left = [_moved(log, sizes).misfit for log in logs]
    gain = [log.misfit**2 - rest**2 for log, rest in zip(logs, left, strict=True)]
    return float(max(sum(gain) / len(gain), 0.0) ** 0.5)


def _unsure(finding: Finding) -> Finding:
    """Return what explains little: a note, or a warning if it is a large gain.

    Free masses take a gain over, and predict its torque: little is left to explain.
    """
    large = finding.kind == "torque gain" and finding.score >= _LARGE
    return replace(
        finding,
        severity="warning" if large else "note",
        statement=f"{finding.statement}, if nothing else is missing in the model",
    )


def _moved(log: FittedLog, sizes: Vector) -> FittedLog:
    """Return a log with its zeros and gains moved, fitted anew."""
    if not sizes.any():
        return log
    model, recording = log.factors.model, log.recording
    count = len(model.robot)
    factor = np.ones(count)
    places = [model.robot.joint_names.index(name) for name in model.torque_joints]
    factor[places] += sizes[count:]
    moved = replace(
        recording,
        position=recording.position + sizes[:count],
        torque=np.asarray(recording.torque) / factor,
    )
    return fitted_log(model, moved, log.constraints, log.factors.base)


def _linearised(log: FittedLog) -> Linearised:
    """Linearise about the best robot; what the data do not determine is nominal."""
    model, scaled = log.factors.model, log.fit.scaled
    distance = nominal_distance(model, "pullback", scaled.unit)
    x = penalised_fit(scaled, distance, _PULL).solution.u * scaled.unit
    return linearised(model, x, log.recording, log.factors.base)

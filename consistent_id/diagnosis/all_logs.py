"""Faults in the recordings of a robot, each by itself and all together.

Validation is also compared with training (`leak_findings`).

Zeros and gains of several joints, or a clock, explain a part of a log with a wrong
scale of one position, as of an encoder at the motor.  If one such scale explains more
than all of them, it has fewer numbers, too, and stands in their place.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace

from consistent_id._support.executors import (
    beside,
    in_halves,
    single_threaded,
)
from consistent_id._support.given_values import require_type, require_types
from consistent_id.constraints import Constraint
from consistent_id.diagnosis.another_robot import of_usual_size, other_robot
from consistent_id.diagnosis.changes import change_findings
from consistent_id.diagnosis.clock import clock_findings, velocity_findings
from consistent_id.diagnosis.clock_speeds import SEVERAL
from consistent_id.diagnosis.corrections import LOOKS_ALIKE, Cause, corrections
from consistent_id.diagnosis.coverage import saturation_findings
from consistent_id.diagnosis.explain import (
    RUBS,
    SAMPLES,
    Explanation,
    FittedLog,
    bodies_known,
    corrected,
    datasheet_constraints,
    explanation_finding,
    masses_known,
    thinned,
)
from consistent_id.diagnosis.factor_logs import FactorLogs
from consistent_id.diagnosis.findings import Diagnosis, LogFinding, Severity
from consistent_id.diagnosis.free_clock import (
    SureClock,
    clock_instead,
    free_clock_findings,
)
from consistent_id.diagnosis.frozen_channels import frozen_findings
from consistent_id.diagnosis.joint_shifts import (
    SHIFT_KINDS,
    CommonShifts,
    all_faults_are,
    joint_shifts,
    together,
)
from consistent_id.diagnosis.leaks import leak_findings
from consistent_id.diagnosis.one_log import (
    OpenLog,
    Prepare,
    findings_of,
    signal_findings,
)
from consistent_id.diagnosis.signal_faults import (
    jump_findings,
    noise_findings,
    spike_findings,
)
from consistent_id.diagnosis.whole_robot import weighed_gain, whole_robot_findings
from consistent_id.diagnosis.wrong_units import (
    model_findings,
    travel_findings,
)
from consistent_id.errors import InfeasibleError, SolverError
from consistent_id.estimation.best_fit import best_fit
from consistent_id.recordings.recording import Recording, several
from consistent_id.regression.base import BaseParameters, base_parameters
from consistent_id.regression.regressor import TorqueModel
from consistent_id.robot.model import RobotModel

# Findings that matter only where a log is fitted.
_OF_FITS = ("rank", "motion noise", "encoder resolution")
# Faults that the log of another robot shows.
_OF_OTHER_ROBOTS = {
    "clock",
    "torque gain",
    "masses or gain",
    "gravity",
    "load",
    "offset zero",
    "model does not explain",
}
_OF_UNITS = ("torque unit", "torque gain")  # with them, torque has no known size
_GRAVEST: tuple[Severity, ...] = ("fault", "warning", "note")
_LATE = ("lag", "drive filter")
_MASSES = "masses or gain"
# Parts of the robot, and how it is mounted: the same in all logs, so that what
# validation alone shows is less.
_OF_THE_ROBOT: Mapping[str, Severity] = {"coupling": "note", "gravity": "warning"}

STAND_INS = (*SHIFT_KINDS, "clock")
"""Kinds of faults that a wrong scale of a position looks like."""


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
    """Find faults in the recordings of a robot.

    Parameters
    ----------
    model : TorqueModel
    training, validation : sequence of Recording
        As they were logged, with torque.  Each is examined, and validation is compared
        with training.  Validation without torque is only compared.
    prepare : callable, optional
        Turns a recording as logged into one with velocity and acceleration, for example
        by filtering and differentiating.  By default recordings are taken as prepared.
        It is called twice for each recording: with the recording, and with one reading
        changed.  It must treat all joints alike and keep constants, because corrections
        are applied to its result.
    constraints : sequence of Constraint, optional
        By default physical consistency, friction that dissipates, and the datasheet's
        masses where they are known.
    base : BaseParameters, optional
    limits : mapping of str to float, optional, [N m or N]
        Torque at which the drives clip, for joints whose torque was computed from
        commands.

    Returns
    -------
    Diagnosis
        Faults of the clock and of the kinematics are reported alone, because faults of
        the torque follow from them.  Only the torque of the model's `torque_joints` is
        examined.  For a robot with a floating base each channel is examined by itself.

    Examples
    --------
    >>> import dataclasses
    >>> import consistent_id as ci
    >>> arm = ci.from_modified_dh("arm", [ci.DHRow(-np.pi / 2, 0.0)])
    >>> model = ci.TorqueModel(arm, ci.DriveTerms(viscous=True))
    >>> t = np.arange(2000)[:, None] / 100
    >>> q, dq, ddq = 2 * np.sin(3 * t), 6 * np.cos(3 * t), -18 * np.sin(3 * t)
    >>> motion = ci.Recording(("joint1",), t[:, 0], q, dq, ddq)
    >>> body = [2.0, 0.6, 0, 0, 0.05, 0, 0.3, 0, 0, 0.3]  # kg, kg m, kg m^2
    >>> log = ci.simulate_torque(model, [*body, 0.4], motion)
    >>> spike = log.torque + 1e3 * (t == 5.0)
    >>> wrong = dataclasses.replace(log, torque=spike)
    >>> "outliers" in [found.kind for found in ci.diagnose(model, wrong).findings]
    True
    """
    require_type(model, TorqueModel, "model")
    training = several(training)
    require_types(validation, Recording, "validation")
    constraints = datasheet_constraints(model) if constraints is None else constraints

    def rows(recording: Recording) -> Recording:
        return recording if prepare is None else prepare(recording)

    found = [*leak_findings(training, validation), *model_findings(model.robot)]
    if any(f.kind == "units" for f in found):
        return Diagnosis(tuple(found), tuple(log.name for log in training))
    looked_at = [*training, *(v for v in validation if v.torque is not None)]
    if model.robot.floating:
        return _of_signals(model.robot, found, [*training, *validation])
    base = base_parameters(model) if base is None else base

    def alone(log: Recording) -> list[LogFinding] | OpenLog:
        own = log.of(model.robot.joint_names)
        return findings_of(model, own, constraints, base, rows, limits, training)

    open_: list[OpenLog] = []
    each = in_halves(alone, looked_at, samples=sum(map(len, looked_at)))
    for k, (log, of_one) in enumerate(zip(looked_at, each, strict=True)):
        if k >= len(training):
            of_one = _of_validation(of_one)
        if isinstance(of_one, OpenLog):
            open_.append(of_one)
        else:
            found += [replace(f, recording=log.name) for f in of_one]
    found += _of_all(open_) if open_ else []
    found = _of_the_robot(found, {log.name for log in training})
    units = [f for f in found if f.kind in _OF_UNITS and f.where == "all joints"]
    signs = [f for f in found if f.severity != "note" and f.kind in _OF_OTHER_ROBOTS]
    if (signs := [*signs, *units]) and not any(map(_explains, found)):
        joints = model.robot.joint_names
        own = [log.of(joints) for log in training]
        # A recording with a wrong clock or channel cannot be prepared.
        logs = [
            rows(log) for log in own if not _has_faults(signal_findings(model, log))
        ]
        sized = _without_wrong_gains(model, found)
        others = _of_another_robot(sized, logs, constraints, unit_known=not units)
        # It comes before its effects, and is not graver than they are.
        first = max(f.score for f in found)
        severity = min((f.severity for f in signs), key=_GRAVEST.index)
        found += [replace(f, severity=severity, score=first + f.score) for f in others]
    names = {log.name for log in looked_at[len(training) :]}
    found = _of_short_validation(found, names - {log.name for log in training})
    return Diagnosis(tuple(found), tuple(log.name for log in looked_at))


def _without_wrong_gains(
    model: TorqueModel, found: Sequence[LogFinding]
) -> TorqueModel:
    """Return a model without the torque of joints that have a wrong gain.

    Such a torque says nothing about bodies.  Another robot's bodies differ in the
    torque of the other joints, too.  Most gains are wrong together because of one
    cause, which may be another robot: all torques are kept then.
    """
    faults = [f for f in found if f.severity == "fault" and f.kind == "torque gain"]
    wrong = {f.where for f in faults if f.recording}
    kept = tuple(name for name in model.torque_joints if name not in wrong)
    most = 2 * len(kept) >= len(model.torque_joints)
    return replace(model, torque_joints=kept) if most else model


def _explains(finding: LogFinding) -> bool:
    """Return whether a fault explains a log as well as right logs are explained.

    It is then no other robot: no zero, and no direction of gravity, makes its lengths
    and axes those of the model.  Faults of nominal bodies, which have no log of their
    own, explain less.
    """
    fault = finding.severity == "fault" and finding.recording
    return bool(fault and finding.kind in ("offset zero", "gravity"))


def _has_faults(found: Sequence[LogFinding]) -> bool:
    return any(finding.severity == "fault" for finding in found)


def _of_the_robot(
    found: Sequence[LogFinding], training: Collection[str]
) -> list[LogFinding]:
    """Weigh what is the robot's, and the same in all logs, less if validation shows it.

    Neither a gear coupling nor the way in which a robot is mounted changes between
    recordings, unless somebody mounts it anew.
    """
    seen = {(f.kind, f.where) for f in found if f.recording in training}
    return [
        replace(
            f,
            severity=_OF_THE_ROBOT[f.kind],
            statement=f"{f.statement}; no training recording shows it",
        )
        if f.kind in _OF_THE_ROBOT
        and f.severity != "note"
        and f.recording
        and f.recording not in training
        and (f.kind, f.where) not in seen
        else f
        for f in found
    ]


def _of_short_validation(
    found: Sequence[LogFinding], names: Collection[str]
) -> list[LogFinding]:
    """Judge short validation recordings by their use: they are not fitted.

    Beside a longer one they are notes.  If all are short, the held-out error is tested
    on little motion.
    """
    short = {f.recording for f in found if f.kind == "short"} & set(names)
    left = set(names) - short

    def of_validation(finding: LogFinding) -> LogFinding:
        if finding.kind != "short" or finding.recording not in short:
            return finding
        seen, _, _ = finding.statement.partition(";")
        return replace(
            finding,
            severity="note" if left else finding.severity,
            statement=f"{seen} of validation; so short a recording hardly tests the "
            "estimate, and its held-out error may be wrong for other motion",
            advice="validate with a longer recording",
        )

    return [of_validation(f) for f in found]


def _of_validation(of_one: list[LogFinding] | OpenLog) -> list[LogFinding] | OpenLog:
    """Turn findings that matter only to a fit into notes: validation is not fitted."""
    if isinstance(of_one, OpenLog):
        return replace(of_one, signals=tuple(_noted(f) for f in of_one.signals))
    return [_noted(f) for f in of_one]


def _noted(finding: LogFinding) -> LogFinding:
    return replace(finding, severity="note") if finding.kind in _OF_FITS else finding


def _of_signals(
    robot: RobotModel, found: Sequence[LogFinding], logs: Sequence[Recording]
) -> Diagnosis:
    """Examine each channel by itself, for a robot whose base moves.

    Faults that show in torque and motion together are only known for a fixed base.
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


def _of_all(open_: Sequence[OpenLog]) -> list[LogFinding]:
    """Return the findings of all logs together that have no fault by themselves.

    A fault that explains the logs replaces other oddities.  If no robot explains a log,
    a small lag means nothing.
    """
    alike: dict[tuple[str, ...], list[FittedLog]] = {}
    for one in open_:
        alike.setdefault(one.as_is.factors.model.torque_joints, []).append(one.as_is)
    open_ = [_gains_weighed(one, alike) for one in open_]
    corrected = [CommonShifts(logs) for logs in alike.values()]
    shifts = [finding for one in corrected for finding in joint_shifts(one)]
    # Logs with a fault, or that no body explains, need no other cause: but for other
    # masses, which stand in for any cause that a log by itself does not show.
    faults = {f.kind for one in open_ for f in one.odd if f.severity == "fault"}
    if faults <= {_MASSES} and not any(f.severity == "fault" for f in shifts):
        more = [f for logs in alike.values() for f in _of_whole_robot(logs)]
        if faults:
            more = [f for f in more if f.severity == "fault" and f.kind != _MASSES]
        # Where joints never turn back, friction looks like weight.
        short = any(f.kind == "short" for one in open_ for f in one.signals)
        # What also explains a log, such as a lag, may be the cause instead.  A torque
        # that is held is late by half the time for which it is.
        late = any(f.kind in _LATE for one in open_ for f in one.odd)
        late |= any(_is_held(f) for one in open_ for f in one.signals)
        shifts += [
            replace(f, severity="warning")
            if late or (short and f.kind == _MASSES)
            else f
            for f in more
        ]
    if len(corrected) == 1:
        (own,) = corrected
        clock = SureClock(own.logs)
        shifts = scale_instead(clock, own, clock_instead(clock, own, shifts))
    shown = any(f.severity == "fault" for f in shifts)
    lost = not shown and any(f.severity == "fault" for o in open_ for f in o.odd)
    found = [f for f in shifts if not (lost and f.severity == "warning")]
    for one in open_:
        odd = () if shown else one.odd
        name = one.as_is.recording.name
        found += [replace(f, recording=name) for f in (*one.signals, *odd)]
    return found


def _is_held(finding: LogFinding) -> bool:
    """Return whether a torque is updated too seldom; coarse steps have no such time."""
    return finding.kind == "torque resolution" and bool(finding.size)


def _gains_weighed(
    one: OpenLog, alike: Mapping[tuple[str, ...], Sequence[FittedLog]]
) -> OpenLog:
    """Weigh the gains of single joints that one log suggests, by all logs like it."""
    suggested = [f for f in one.odd if _of_one_gain(f)]
    if not suggested:
        return one
    model = one.as_is.factors.model
    logs = alike[model.torque_joints]
    recordings, stated = [log.recording for log in logs], logs[0].constraints
    as_is = FactorLogs.of(model, recordings, masses_known=masses_known(stated))
    odd = (weighed_gain(f, as_is) if f in suggested else f for f in one.odd)
    return replace(one, odd=tuple(odd))


def _of_one_gain(finding: LogFinding) -> bool:
    one = finding.kind == "torque gain" and finding.where != "all joints"
    return one and finding.severity == "warning"


def _of_whole_robot(logs: Sequence[FittedLog]) -> list[LogFinding]:
    """Test clock, gain, zeros and base beside nominal bodies, if these are known.

    The clock is tested with free bodies, too.  Logs that are nearly all friction do not
    take part.
    """
    model, logs = logs[0].factors.model, [log for log in logs if log.friction < RUBS]
    if not logs or len(model.torque_joints) < SEVERAL:
        return []
    recordings, stated = [log.recording for log in logs], logs[0].constraints
    as_is = FactorLogs.of(model, recordings, masses_known=masses_known(stated))
    if not bodies_known(model):
        return free_clock_findings(as_is)
    changed = change_findings(as_is)
    if any(f.severity == "fault" for f in changed):
        return changed  # no factor is the same in all samples
    with beside(free_clock_findings, as_is, copied=True) as clock:
        found = whole_robot_findings(as_is)
        return [*_with_free_clock(clock, found), *changed]


def _with_free_clock(
    free_clock: Callable[[], list[LogFinding]], found: Sequence[LogFinding]
) -> Sequence[LogFinding]:
    """Add a clock that free bodies show; as a fault it takes the place of warnings."""
    if any(f.severity == "fault" for f in found):
        return found
    clock = free_clock()
    if any(f.severity == "fault" for f in clock):
        return [*clock, *(f for f in found if f.severity == "note")]
    return [*clock, *(f for f in found if not clock or f.kind != "clock")]


def _of_another_robot(
    model: TorqueModel,
    logs: Sequence[Recording],
    constraints: Sequence[Constraint],
    *,
    unit_known: bool,
) -> list[LogFinding]:
    """Report that logs may be another robot's, before faults that follow from it."""
    if not logs or not bodies_known(model):
        return []
    few = [thinned(log, SAMPLES) for log in logs]
    as_is = FactorLogs.of(model, few, masses_known=masses_known(constraints))
    return other_robot(as_is if unit_known else of_usual_size(as_is))


def scale_instead(
    clock: SureClock, shifts: CommonShifts, found: Sequence[LogFinding]
) -> list[LogFinding]:
    """Replace faults of zeros, gains and the clock by a scale that explains more.

    Parameters
    ----------
    clock, shifts
        Of the same logs.
    found : sequence of LogFinding
        Findings of all these logs together.
    """
    if not all_faults_are(STAND_INS, found):
        return list(found)
    best = _best_scale(shifts.logs)
    if best is None or best.score < 1.0:
        return list(found)
    if best.misfit >= min(shifts.misfit, clock.misfit):
        return list(found)
    return [_scale_finding(best), *(f for f in found if f.kind not in STAND_INS)]


def _best_scale(logs: Sequence[FittedLog]) -> Explanation | None:
    """Return the scale with the least misfit in all logs, if all allow one."""
    as_is = together([log.misfit for log in logs])
    each = [_scale_misfits(log) for log in logs]
    shared = [
        Explanation(cause, together([one[cause] for one in each]), as_is)
        for cause in each[0]
        if all(cause in one for one in each)
    ]
    return min(shared, key=lambda scale: scale.misfit, default=None)


def _scale_misfits(log: FittedLog) -> dict[Cause, float]:
    """Return the misfits with scales that a few samples do not exclude."""
    model = log.factors.model
    every = corrections(model.robot, model.torque_joints)
    near = [c for c in every if c.cause.excuse == LOOKS_ALIKE]
    found = {}
    for candidate in corrected(log, near):
        factors = candidate.factors
        try:
            fit = best_fit(
                model, factors.regression(), candidate.constraints, base=factors.base
            )
        except (InfeasibleError, SolverError):
            continue  # no robot explains the log with this scale
        found[candidate.cause] = factors.relative(fit.misfit)
    return found


def _scale_finding(scale: Explanation) -> LogFinding:
    finding = explanation_finding(scale)
    return replace(
        finding,
        statement=f"{finding.statement}; zeros, gains and the clock explain less; a "
        "link that is longer or shorter than the model's looks the same",
        advice=f"{finding.advice}; check the lengths of the model",
    )

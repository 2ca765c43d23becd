"""All detectors, one after another."""

from collections.abc import Callable, Sequence
from dataclasses import replace

from consistent_id._support.arrays import Vector
from consistent_id._support.threads import single_threaded
from consistent_id.constraints import Constraint
from consistent_id.constraints.distances import nominal_distance
from consistent_id.diagnosis.clock import clock_findings, velocity_findings
from consistent_id.diagnosis.corrections import corrections
from consistent_id.diagnosis.coverage import (
    dead_findings,
    rank_findings,
    saturation_findings,
    standstill_findings,
)
from consistent_id.diagnosis.explain import (
    SAMPLES,
    FittedLog,
    best_explanation,
    datasheet_constraints,
    explanation_finding,
    fitted_log,
    thinned,
)
from consistent_id.diagnosis.findings import Diagnosis, Finding
from consistent_id.diagnosis.linearise import Linearised, linearised
from consistent_id.diagnosis.motion_noise import motion_noise_findings
from consistent_id.diagnosis.repeats import leak_findings
from consistent_id.diagnosis.small_shifts import (
    hidden_zeros,
    moved_zeros,
    shift_findings,
)
from consistent_id.errors import InfeasibleError, SolverError
from consistent_id.estimation.penalised import penalised_fit
from consistent_id.recordings.recording import Recording
from consistent_id.regression.base import BaseParameters, base_parameters
from consistent_id.regression.regressor import TorqueModel

Prepare = Callable[[Recording], Recording]

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

    Returns
    -------
    Diagnosis
        Faults of the clock and of the kinematics are reported alone: what they do to
        the torque is their consequence.  Torque is looked at of the model's
        `torque_joints` only.
    """
    training = [training] if isinstance(training, Recording) else list(training)
    base = base_parameters(model) if base is None else base
    constraints = datasheet_constraints(model) if constraints is None else constraints
    ready: Prepare = (lambda recording: recording) if prepare is None else prepare
    found = list(leak_findings(training, validation))
    looked_at = [*training, *(v for v in validation if v.torque is not None)]
    for recording in looked_at:
        log = recording.of(model.robot.joint_names)
        of_one = _of_one(model, log, constraints, base, ready)
        found += [replace(f, recording=log.name) for f in of_one]
    return Diagnosis(tuple(found), tuple(log.name for log in looked_at))


def _of_one(
    model: TorqueModel,
    log: Recording,
    constraints: Sequence[Constraint],
    base: BaseParameters,
    prepare: Prepare,
) -> list[Finding]:
    """Return what is found in one recording."""
    torque = log.of(model.torque_joints)
    kinematic = clock_findings(log) or velocity_findings(log)
    dead = dead_findings(torque)
    found = [*kinematic, *standstill_findings(log)]
    found += dead or saturation_findings(torque)
    if kinematic or dead:
        return found
    return found + _dynamic(model, log, constraints, base, prepare)


def _dynamic(
    model: TorqueModel,
    log: Recording,
    constraints: Sequence[Constraint],
    base: BaseParameters,
    prepare: Prepare,
) -> list[Finding]:
    """Return what only torque and motion together show."""
    whole = prepare(log).of(model.robot.joint_names)
    prepared = thinned(whole, SAMPLES)
    found = rank_findings(model, prepared, base)
    if not found:  # else some columns are noise alone, as that finding says
        found += motion_noise_findings(model, log, prepare, base, prepared=whole)
    try:
        as_is = fitted_log(model, prepared, constraints, base)
        best = best_explanation(as_is, corrections(model.robot, model.torque_joints))
        if best is not None and best.correction.fault.channels == "torque":
            return [*found, explanation_finding(best)]
        zeros = moved_zeros(model, lambda offsets: _linearised(_moved(as_is, offsets)))
        # Exchanging channels that hardly matter can also take up a small zero offset;
        # the offset is the fault if correcting it leaves less unexplained.
        if best is None or _moved(as_is, zeros.offsets).misfit < best.misfit:
            return found + shift_findings(model, zeros) + hidden_zeros(model, zeros)
        return [*found, explanation_finding(best)]
    except (InfeasibleError, SolverError) as failure:
        statement = f"no robot of the datasheet explains the log: {failure}"
        advice = "check masses and bounds; see the certificate of each method"
        return [*found, Finding("datasheet", "fault", log.name, statement, advice)]


def _moved(log: FittedLog, offsets: Vector) -> FittedLog:
    """Return a log with its joint zeros moved, fitted anew."""
    if not offsets.any():
        return log
    recording = log.recording
    moved = replace(recording, position=recording.position + offsets)
    return fitted_log(log.factors.model, moved, log.constraints, log.factors.base)


def _linearised(log: FittedLog) -> Linearised:
    """Linearise about the best robot; what the data do not determine is nominal."""
    model, scaled = log.factors.model, log.fit.scaled
    distance = nominal_distance(model, "pullback", scaled.unit)
    x = penalised_fit(scaled, distance, _PULL).solution.u * scaled.unit
    return linearised(model, x, log.recording, log.factors.base)

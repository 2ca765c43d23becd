"""All detectors, one after another."""

from collections.abc import Sequence

from consistent_id._threads import single_threaded
from consistent_id.base import BaseParameters, base_parameters
from consistent_id.constraints import Constraint
from consistent_id.diagnosis.clock import clock_findings, velocity_findings
from consistent_id.diagnosis.corrections import motion_corrections, torque_corrections
from consistent_id.diagnosis.coverage import (
    leak_findings,
    rank_findings,
    saturation_findings,
    standstill_findings,
)
from consistent_id.diagnosis.explain import (
    Prepare,
    datasheet_constraints,
    explanation_findings,
)
from consistent_id.diagnosis.findings import Diagnosis, Finding
from consistent_id.diagnosis.small_shifts import estimate_shifts, shift_findings
from consistent_id.errors import ConsistentIdError
from consistent_id.estimators.constrained import constrained_least_squares
from consistent_id.recording import Recording
from consistent_id.regression import build_regression
from consistent_id.regressor import TorqueModel


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
        As they were logged, with torque.
    prepare : callable, optional
        From a recording as logged to one with velocity and acceleration, such as
        filtering and differentiating; by default they are taken as prepared.
    constraints : sequence of Constraint, optional
        What is known of the robot; by default bodies, friction that dissipates, and
        the datasheet's masses where all are known.
    base : BaseParameters, optional

    Returns
    -------
    Diagnosis
        Faults of the clock and of the kinematics are reported alone: what they do to
        the torque is their consequence.
    """
    training = [training] if isinstance(training, Recording) else list(training)
    base = base_parameters(model) if base is None else base
    constraints = datasheet_constraints(model) if constraints is None else constraints
    ready: Prepare = (lambda recording: recording) if prepare is None else prepare
    found: list[Finding] = list(leak_findings(training, validation))
    for recording in training:
        log = recording.of(model.robot.joint_names)
        kinematic = clock_findings(log) or velocity_findings(log)
        found += kinematic
        found += standstill_findings(log)
        found += saturation_findings(log)
        if not kinematic:
            found += _dynamic(model, log, constraints, base, ready)
    return Diagnosis(tuple(found))


def _dynamic(
    model: TorqueModel,
    log: Recording,
    constraints: Sequence[Constraint],
    base: BaseParameters,
    prepare: Prepare,
) -> list[Finding]:
    """Return what only the torque tells."""
    corrections = [
        *torque_corrections(model.robot.joint_names),
        *motion_corrections(model.robot),
    ]
    found = explanation_findings(model, log, corrections, constraints, base, prepare)
    prepared = prepare(log)
    regression = build_regression(model, prepared)
    found += rank_findings(regression, base)
    if any(f.severity == "fault" for f in found):
        return found
    weighted = regression.weighted(regression.torque_rms)
    try:
        estimate = constrained_least_squares(
            model, weighted, constraints=constraints, base=base
        )
    except ConsistentIdError as failure:
        statement = f"no robot of the datasheet explains the log: {failure}"
        advice = "check masses and bounds; see the certificate of each method"
        return [*found, Finding("datasheet", "fault", log.name, statement, advice)]
    shifts = estimate_shifts(model, estimate.parameters, prepared, base)
    return found + shift_findings(model, shifts)

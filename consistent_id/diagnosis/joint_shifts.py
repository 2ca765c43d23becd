"""Zeros and gains that all logs of a robot show together, and the lag of each.

The linearisation of each log (`small_shifts`) is repeated at its own best fit, with the
zeros and gains found so far taken out.  Nominal bodies may contradict the result.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from consistent_id._support.arrays import Vector
from consistent_id.constraints.priors import nominal_distance
from consistent_id.diagnosis.explain import (
    FittedLog,
    bodies_known,
    fitted_log,
    masses_known,
)
from consistent_id.diagnosis.factor_findings import doubted
from consistent_id.diagnosis.factor_logs import FactorLogs
from consistent_id.diagnosis.factor_rows import FactorRows
from consistent_id.diagnosis.findings import LogFinding
from consistent_id.diagnosis.linearise import Linearised, linearised
from consistent_id.diagnosis.small_shifts import (
    Moved,
    hidden_zeros,
    lag_findings,
    moved_channels,
    shift_findings,
)
from consistent_id.diagnosis.whole_robot import contradicted
from consistent_id.errors import InfeasibleError, SolverError
from consistent_id.estimation.penalised import penalised_fit
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals.filtered_rows import altered

SHIFT_KINDS = ("offset zero", "torque gain")
"""Kinds of faults that the zeros and gains of joints are."""

# Share of the torque that zero offsets and gains have to explain.  Friction that no
# model has leaves 0.3 to 2 %; a zero offset may take up 0.6 % of that by chance.
_WORTH = 0.008
_LARGE = 2.0  # a gain with this score or more is large
_PULL = 1e-4  # weight of the squared distance to the nominal robot


@dataclass(frozen=True, eq=False)
class CommonShifts:
    """The zeros and gains that all logs show, found when first needed, and once.

    Parameters
    ----------
    logs : sequence of FittedLog
        Logs in which the same joints have a torque and move.
    """

    logs: Sequence[FittedLog]

    @cached_property
    def moved(self) -> Moved | None:
        """The zeros and gains; None if no robot explains the corrected logs."""
        try:
            return moved_channels(
                self.logs[0].factors.model,
                lambda sizes: [
                    _linearised(corrected_shifts(log, sizes)) for log in self.logs
                ],
            )
        except (InfeasibleError, SolverError):
            return None

    @cached_property
    def misfit(self) -> float:
        """The misfit of the corrected logs.

        It is zero if no robot explains them, so that nothing explains more.
        """
        if self.moved is None:
            return 0.0
        sizes = self.moved.sizes
        return together([corrected_shifts(log, sizes).misfit for log in self.logs])


def joint_shifts(shifts: CommonShifts) -> list[LogFinding]:
    """Find wrong zero offsets and gains in all logs together, and the lag of each."""
    logs, moved = shifts.logs, shifts.moved
    if moved is None:
        return []  # there is no correction
    model = logs[0].factors.model
    lags = [
        replace(f, recording=log.recording.name)
        for log, system in zip(logs, moved.systems, strict=True)
        for f in lag_findings(system)
    ]
    if any(f.severity == "fault" for f in lags):
        return lags  # with a large lag the linearisation is not valid
    found = shift_findings(model, moved)
    if found and _explained(logs, moved.sizes) < _WORTH:
        found = [_unsure(f) for f in found]
    elif found and _contradicted_shifts(logs, moved.sizes):
        found = [doubted(f) for f in found]
    return [*found, *hidden_zeros(model, moved), *lags]


def all_faults_are(kinds: Collection[str], found: Sequence[LogFinding]) -> bool:
    """Return whether there are faults, and all are of kinds that others look like."""
    faults = {f.kind for f in found if f.severity == "fault"}
    return bool(faults) and faults <= {*kinds}


def together(misfits: Sequence[float]) -> float:
    """Return the root of the mean square of logs' misfits."""
    return float(np.sqrt(np.mean(np.square(misfits))))


def _contradicted_shifts(logs: Sequence[FittedLog], sizes: Vector) -> bool:
    """Return whether nominal bodies contradict shifts; no, if they are not known."""
    model, known = logs[0].factors.model, masses_known(logs[0].constraints)
    if not bodies_known(model):
        return False
    as_is = FactorLogs.of(model, [log.recording for log in logs], masses_known=known)
    moved = [corrected_shifts(log, sizes).recording for log in logs]
    return contradicted(as_is, replace(as_is, rows=FactorRows(model, moved)))


def _explained(logs: Sequence[FittedLog], sizes: Vector) -> float:
    """Return the torque that shifts explain, relative to all torque."""
    left = [corrected_shifts(log, sizes).misfit for log in logs]
    gain = [log.misfit**2 - rest**2 for log, rest in zip(logs, left, strict=True)]
    return float(max(sum(gain) / len(gain), 0.0) ** 0.5)


def _unsure(finding: LogFinding) -> LogFinding:
    """Lower a finding that explains little to a note, or a large gain to a warning.

    Free masses can stand in for a gain, so that a wrong gain explains little more.
    """
    large = finding.kind == "torque gain" and finding.score >= _LARGE
    return replace(
        finding,
        severity="warning" if large else "note",
        statement=f"{finding.statement}, if nothing else is missing in the model",
    )


def corrected_shifts(log: FittedLog, sizes: Vector) -> FittedLog:
    """Return a log with corrected zero offsets and gains, fitted again."""
    if not sizes.any():
        return log
    model, recording = log.factors.model, log.recording
    count = len(model.robot)
    factor = np.ones(count)
    places = [model.robot.joint_names.index(name) for name in model.torque_joints]
    factor[places] += sizes[count:]

    def corrected(raw: Recording) -> Recording:
        position = raw.position + sizes[:count]
        return replace(raw, position=position, torque=np.asarray(raw.torque) / factor)

    moved = altered(recording, corrected)
    return fitted_log(model, moved, log.constraints, log.factors.base)


def _linearised(log: FittedLog) -> Linearised:
    """Linearise about the best fit; undetermined parameters take nominal values."""
    model, scaled = log.factors.model, log.fit.scaled
    distance = nominal_distance(model, "pullback", scaled.unit)
    x = penalised_fit(scaled, distance, _PULL).solution.u * scaled.unit
    return linearised(model, x, log.recording, log.factors.base)

"""The estimate that is delivered: judged on data not seen, then fitted to all data."""

from collections.abc import Sequence
from dataclasses import replace

from consistent_id.constraints.priors import Prior
from consistent_id.estimation.constrained import constrained_least_squares
from consistent_id.estimation.estimate import Estimate
from consistent_id.estimation.method import Method
from consistent_id.problems.problem import Problem
from consistent_id.problems.sensor_drift_preparation import regression_of
from consistent_id.recordings.recording import Recording
from consistent_id.regression.noise import joint_noise


def refitted(
    problem: Problem, judged: Estimate, recordings: Sequence[Recording], prior: Prior
) -> Estimate:
    """Fit a constrained estimate again, to more data than it was judged with.

    The verdict stays that of the estimate that was judged, which had not seen the data
    that judged it; the fit, the certificate and all errors are the new one's.

    Parameters
    ----------
    problem : Problem
    judged : Estimate
        By a constrained method, with its verdict.
    recordings : sequence of Recording
        All of them: training and validation.
    prior : PointToSet or Penalty
        As of the estimate that was judged.
    """
    model, base = problem.model, judged.base
    regression = regression_of(problem.table, model, recordings)
    if judged.method == Method.WEIGHTED_CONSTRAINED:
        regression = regression.weighted(joint_noise(model, regression, base=base))
    estimate = constrained_least_squares(
        model,
        regression,
        constraints=problem.constraints,
        prior=prior,
        base=base,
        method=judged.method,
    )
    names = ", ".join(recording.name for recording in recordings)
    note = (
        f"fitted again, after it was judged, to all recordings ({names}); verdict and "
        "held-out error are those of the estimate from the training data alone"
    )
    return replace(
        estimate,
        notes=(note, *estimate.notes),
        accepted=judged.accepted,
        judged=judged.verdict,
    )

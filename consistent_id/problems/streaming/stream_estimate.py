"""The estimate from recordings of any size, judged on held-out ones."""

from dataclasses import replace

import numpy as np

from consistent_id._support.executors import Executor
from consistent_id._support.threads import single_threaded
from consistent_id.estimation.constrained import constrained_least_squares
from consistent_id.estimation.estimate import Estimate
from consistent_id.estimation.evidence import evidence_of
from consistent_id.estimation.judge import judge
from consistent_id.estimation.method import Method
from consistent_id.estimation.torque_error import TorqueError, stacked_of_kinds
from consistent_id.problems.problem import Problem
from consistent_id.problems.streaming.stream import stream_regression
from consistent_id.regression.base import base_parameters
from consistent_id.regression.noise import joint_noise
from consistent_id.regression.regression import Regression


@single_threaded
def stream_estimate(
    problem: Problem, *, executor: str | Executor = "serial", progress: bool = False
) -> Estimate:
    """Estimate all parameters under a problem's constraints, window by window.

    The estimate is the weighted constrained one of the training recordings.  It is
    judged by its own fit and by the validation recordings, which are streamed too.
    What needs recordings as a whole is not done: faults of the log are not looked for,
    and no other method is compared with.

    Parameters
    ----------
    problem : Problem
        See `stream_regression`.
    executor : str or Executor
        Where windows are compressed.
    progress : bool
        Say on the standard error how far it is.

    Returns
    -------
    Estimate
        With its verdict; the first note has the error on held-out torque.

    Raises
    ------
    ProblemError, RecordingError
        See `stream_regression`.
    InfeasibleError, NotExcitedError, SolverError
        See `constrained_least_squares`.
    """
    model = problem.model
    regression = stream_regression(problem, executor=executor, progress=progress)
    base = base_parameters(model)
    estimate = constrained_least_squares(
        model,
        regression.weighted(joint_noise(model, regression, base=base)),
        constraints=problem.constraints,
        prior=problem.prior,
        base=base,
        method=Method.WEIGHTED_CONSTRAINED,
    )
    data, errors = problem.table.data, []
    if data is not None and any(e.role == "validation" for e in data.recordings):
        unseen = stream_regression(
            problem, role="validation", executor=executor, progress=progress
        )
        errors.append(_error(estimate, unseen))
    evidence = replace(evidence_of(estimate), held_out=tuple(errors))
    seen = ", ".join(f"{error.stacked:.2%} of the torque" for error in errors)
    note = f"error on held-out recordings: {seen or 'unknown, there are none'}"
    notes = (f"{note}; the log itself was not checked for faults", *estimate.notes)
    return replace(estimate, notes=notes, judged=judge(evidence))


def _error(estimate: Estimate, regression: Regression) -> TorqueError:
    """Return the prediction error on what a regression was made of."""
    counts, size = np.array(regression.counts), regression.torque_rms
    rms = regression.residual_rms(estimate.parameters)
    stacked = stacked_of_kinds(estimate.model, counts * rms**2, counts * size**2)
    relative = rms / np.where(size > 0.0, size, np.nan)
    # What friction can hold at rest is not known sample by sample: it counts as error.
    return TorqueError("held-out", rms, relative, size, stacked, rms, stacked)

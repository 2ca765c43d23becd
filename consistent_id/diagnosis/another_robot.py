"""Whether logs are another robot's: no factor makes their bodies nominal."""

from dataclasses import replace

import numpy as np

from consistent_id._support.singular import lstsq
from consistent_id.diagnosis.factor_findings import FARTHEST
from consistent_id.diagnosis.factor_logs import (
    FactorLogs,
    factor_system,
    factors_of,
    least_costs,
    least_misfit,
    solution_of,
)
from consistent_id.diagnosis.findings import LogFinding
from consistent_id.diagnosis.whole_robot import body_parameters, converged, estimated
from consistent_id.robot.chains import last_links
from consistent_id.robot.scaling import reference_bodies

# Cost of nominal bodies for each base parameter, and residual of least squares over the
# torque; one alone is enough.  In right logs of five real arms they are up to 6.1 and
# 0.12; in 36 simulated logs of other arms, 2 to 310 and 0.03 to 0.34.
_OTHER, _UNEXPLAINED = 10.0, 0.2
_PULLS = 3.0  # standard errors that the farthest factor is away from none
_USUAL = 1.0  # bodies as near as this once a factor is free are those of the model
_AS_RIGHT = 0.12  # the largest of these right logs


def other_robot(as_is: FactorLogs) -> list[LogFinding]:
    """Report that logs may be another robot's: no factor makes their bodies nominal.

    Two signs count together.  With all factors free, the nominal bodies still cost far
    more than in a right robot's log.  And least squares leaves much of the torque
    unexplained, whatever the bodies: then lengths or axes are not the model's.  If it
    leaves as little as in a right log, a load alone may be the cause.
    """
    unexplained, distance = least_misfit(as_is), _distance(as_is)
    score = max(distance, 0.0) / _OTHER + unexplained / _UNEXPLAINED
    if score > 1.0 and unexplained <= _AS_RIGHT:
        # A load on a last link changes no length and no axis.
        distance = min(distance, _distance_of_loaded(as_is))
        score = max(distance, 0.0) / _OTHER + unexplained / _UNEXPLAINED
    if score <= 1.0 or distance < _USUAL:
        return []
    return [
        LogFinding(
            "another robot",
            "fault",
            "model",
            "the log does not look like this robot's: with clock, gain, zeros and base "
            "free, bodies are "
            f"{np.sqrt(max(distance, 0.0)):.2g} times as far from the nominal ones as "
            f"usual, and bodies of any kind leave {unexplained:.1%} of each joint's "
            "torque unexplained",
            "check that model and log belong together, and the order of columns",
            score,
        )
    ]


def _distance(as_is: FactorLogs) -> float:
    """Return the cost of nominal bodies for each base parameter, with free factors.

    It is the squared distance in units of the widths: the smaller of that with all
    factors, linearised, and that with the best factor, converged.  Factors of a size
    that no fault of a right robot's log has do not count: the best one is at most
    `FARTHEST`, and together they are pulled to none by a third of that.
    """
    factors = factors_of(as_is.model)
    pull = np.diag([_PULLS / FARTHEST[f.kind] for f in factors])
    costs = []
    for nominal in (True, False):
        system = factor_system(as_is, factors, nominal=nominal, scatter=False)
        columns = np.vstack([system.whole[:, : len(factors)], pull])
        values = np.append(system.whole[:, -1], np.zeros(len(factors)))
        sizes = lstsq(columns, values)
        costs.append(float(np.sum((columns @ sizes - values) ** 2)))
    linear = costs[0] - costs[1]
    first = [f for f in estimated(as_is, factors) if np.isfinite(f.error)]
    best = max(first, key=lambda f: f.explained, default=None)
    if best is not None:
        most = FARTHEST[best.factor.kind]
        size = float(np.clip(converged(as_is, best).size, -most, most))
        left, of_drives = least_costs(as_is.without(best.factor, size))
        settled = left - of_drives
        linear = min(linear, settled)
    return linear / body_parameters(as_is.model)


def of_usual_size(as_is: FactorLogs) -> FactorLogs:
    """Return logs with the torque in a unit in which it is as large as the model's."""
    drawn = as_is.rows.torque_of(reference_bodies(as_is.model.robot).ravel())
    squares = np.array(
        [np.mean(values**2, axis=1) for values in (as_is.rows.torque, drawn)]
    )
    measured, model = np.maximum(np.sqrt(squares), 1e-300)
    gain = next(f for f in factors_of(as_is.model) if f.where == "all joints")
    return as_is.without(gain, float(np.median(np.log(measured / model))))


def _distance_of_loaded(as_is: FactorLogs) -> float:
    """Return the same with free loads on the last links, and without factors.

    Bodies of all last links and all factors together would explain too much.  A last
    link with less mass than none carries no load: infinite.
    """
    loaded, robot = replace(as_is, loaded=True), as_is.model.robot
    masses = solution_of(loaded)[: 10 * len(robot.links) : 10]
    last = {link.name for link in last_links(robot)}
    ends = np.array([link.name in last for link in robot.links])
    if masses[ends].min() < 0.0:
        return float("inf")
    left, of_drives = least_costs(loaded)
    return (left - of_drives) / body_parameters(as_is.model)

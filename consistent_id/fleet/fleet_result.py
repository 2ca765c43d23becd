"""The result of a fleet: the bodies, each robot, and robots with other bodies.

Those are found by the misfit that sharing costs.  With the squared misfits of robot
``i`` alone, of all others, and of all together, each row divided by its noise,

``T_i = S_all - S_i - S_others``

has a ``chi^2`` distribution if robot ``i`` has the bodies of the others, with as many
degrees of freedom as there are parameters that both determine [Chow1960]_.  No model is
exact, and robots of one type are not quite the same.  So the scale comes from the
fleet: the median of ``T_i`` over its degrees of freedom is the factor by which a
typical robot exceeds noise, and the ratio of a high quantile to the median, determines
the degrees of freedom of the scatter about it.  A robot's ratio to the median has an F
distribution with these.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import accumulate
from typing import Any

import numpy as np

from consistent_id._support.arrays import BoolArray, Matrix, Vector, freeze_arrays
from consistent_id._support.tables import Table, brief
from consistent_id.errors import ProblemError
from consistent_id.estimation.estimate import Estimate
from consistent_id.fleet.payloads import FoundPayload
from consistent_id.regression.linear import DATA_RANK_TOLERANCE
from consistent_id.regression.regression import triangle
from consistent_id.regression.regressor import TorqueModel
from consistent_id.robot.parameters import did_you_mean

LEVEL = 0.001
"""Nominal chance that a fleet without outliers has one named.  Measured it is 0 where
robots differ by noise alone, and some hundredths where they differ more, along a few
directions: ``benchmarks/fleet_outliers.py``."""

FEWEST = 5
"""Least number of robots for naming outliers: with fewer, the scatter is not known."""

_HIGH = 0.9  # quantile that shows how widely robots scatter; of fewer than _MANY, one
_HIGH_OF_FEW, _MANY = 0.75, 20  # that a single outlier does not move
_OF_MEDIAN = 2.0 / np.pi  # efficiency of a median beside a mean
_TINY = 1e-300
_NEAR = 0.5  # of the largest excess, from which outliers are named in one round
FORMAT = "consistent_id fleet 1"
_SHOWN = 30  # robots in a table: those with the largest excess; a file has all


@brief
@dataclass(frozen=True, eq=False)
class Outliers:
    """The cost of sharing for each robot.

    Parameters
    ----------
    statistic : ndarray, shape (robots,)
        ``T_i``, against the robots that are no outliers.
    freedom : ndarray, shape (robots,)
        Its degrees of freedom.
    spread : float
        By which a typical robot's exceeds that of equal robots with known noise.
    p_values : ndarray, shape (robots,)
        Chance of so much among robots that scatter as this fleet does.
    named : ndarray of bool, shape (robots,)
    """

    statistic: Vector
    freedom: Vector
    spread: float
    p_values: Vector
    named: BoolArray


def find_outliers(factors: Sequence[Matrix]) -> Outliers:
    """Name the robots that do not share the bodies of the others.

    The largest outliers are set aside first, as they hide others; the cost grows with
    the number of robots times the number of rounds that takes.

    Parameters
    ----------
    factors : sequence of ndarray, each shape (rows, parameters + 1)
        Factors of the shared base parameters and torque, rows divided by the noise.
    """
    robots = len(factors)
    named = np.zeros(robots, dtype=np.bool_)
    while True:
        found = _tested(factors, named)
        p = found.p_values
        new = (p < LEVEL / robots) & ~named
        if not new.any() or robots < FEWEST or named.sum() + 1 > (robots - 1) // 2:
            return found
        excess = np.where(new, found.statistic / found.freedom, 0.0)
        largest = np.argsort(-excess)[: (robots - 1) // 2 - int(named.sum())]
        named = named.copy()
        named[[i for i in largest if excess[i] >= _NEAR * excess.max()]] = True


def _tested(factors: Sequence[Matrix], named: BoolArray) -> Outliers:
    from scipy.special import chdtri, fdtrc

    others = list(_without_each(factors, named))
    statistic, freedom = np.zeros(len(factors)), np.ones(len(factors))
    for i, (own, rest) in enumerate(zip(factors, others, strict=True)):
        together = triangle(np.asfortranarray(np.vstack([own, rest])))
        parts = [_least(R) for R in (together, own, rest)]
        (all_misfit, all_rank), (misfit, rank), (rest_misfit, rest_rank) = parts
        statistic[i] = max(all_misfit - misfit - rest_misfit, 0.0)
        freedom[i] = max(rank + rest_rank - all_rank, 1)
    alike = ~named
    ratio = np.maximum(statistic / freedom, _TINY)
    expected = np.median(chdtri(freedom[alike], 0.5) / freedom[alike])
    spread = max(1.0, float(np.median(ratio[alike]) / expected))
    effective = np.minimum(freedom, _freedom_of_scatter(ratio[alike]))
    behind = effective * _OF_MEDIAN * max(int(alike.sum()) - 1, 1)
    p_values = fdtrc(effective, behind, ratio / spread)
    return Outliers(statistic, freedom, spread, p_values, named)


def _freedom_of_scatter(ratio: Vector) -> float:
    """Return of which ``chi^2`` a high quantile and the median have the same ratio."""
    from scipy.special import chdtri

    high = _HIGH if len(ratio) >= _MANY else _HIGH_OF_FEW
    seen = np.quantile(ratio, high) / np.median(ratio)
    d = np.geomspace(0.1, 1e4, 200)
    known = chdtri(d, 1.0 - high) / chdtri(d, 0.5)
    return float(np.interp(-seen, -known, d))


def _without_each(factors: Sequence[Matrix], named: BoolArray) -> Iterator[Matrix]:
    """Yield, for each robot, the factor of all others that are not named."""
    none = np.zeros((0, factors[0].shape[1]))
    kept = [none if out else R for R, out in zip(factors, named, strict=True)]
    before = accumulate(kept[:-1], _joined, initial=none)
    after = list(accumulate(reversed(kept[1:]), _joined, initial=none))[::-1]
    for first, second in zip(before, after, strict=True):
        yield _joined(first, second)


def _joined(first: Matrix, second: Matrix) -> Matrix:
    return triangle(np.asfortranarray(np.vstack([first, second])))


def _least(R: Matrix) -> tuple[float, int]:
    """Return the least squared misfit of a factor, and its rank."""
    A, b = R[:, :-1], R[:, -1]
    norms = np.linalg.norm(A, axis=0)
    unit = A / np.where(norms > 0.0, norms, 1.0)
    x, _, rank, _ = np.linalg.lstsq(unit, b, rcond=DATA_RANK_TOLERANCE)
    return float(np.sum((unit @ x - b) ** 2)), int(rank)


@brief
@dataclass(frozen=True, slots=True, eq=False)
class FleetRobot:
    """One robot of a fleet.

    Parameters
    ----------
    name : str
    samples : int
    parameters : array_like, shape (parameters,)
        The shared bodies, its payload in the link that carries it, its own friction.
    misfit : float
        RMS residual over RMS torque, all joints stacked, with the fleet's bodies.
    alone : float
        The same of least squares of this robot alone.
    statistic : float
        Rise of the squared misfit by sharing bodies with the others, in its own noise.
    freedom : int
        Its mean for a robot like the others with white noise.
    p_value : float
        Probability of such a value among robots that scatter as this fleet does.
    outlier : bool
        Whether it was left out of the shared estimate.
    payload : FoundPayload, optional
        Its payload, if one was stated.
    """

    name: str
    samples: int
    parameters: Vector
    misfit: float
    alone: float
    statistic: float
    freedom: int
    p_value: float
    outlier: bool
    payload: FoundPayload | None = None

    def __post_init__(self) -> None:
        freeze_arrays(self, {"parameters": (None,)}, self.name)


@brief
@dataclass(frozen=True, slots=True, eq=False)
class Fleet:
    """Robots of one type.

    Parameters
    ----------
    model : TorqueModel
        Model of one robot.
    bodies : Estimate
        The shared estimate, without outliers; a model without friction.
    robots : tuple of FleetRobot
    spread : float
        Ratio of a typical robot's statistic to that of equal robots.
    settled : bool
        Whether the bounds of own parameters converged.
    seconds : float
        Wall time.
    """

    model: TorqueModel
    bodies: Estimate
    robots: tuple[FleetRobot, ...]
    spread: float
    settled: bool
    seconds: float

    def __getitem__(self, name: str) -> FleetRobot:
        for robot in self.robots:
            if robot.name == name:
                return robot
        near = did_you_mean(name, [robot.name for robot in self.robots])
        raise ProblemError(f"fleet: no robot {name!r}; {near}")

    def __repr__(self) -> str:
        return (
            f"Fleet({len(self.robots)} robots, outliers: "
            f"{', '.join(self.outliers) or 'none'})"
        )

    @property
    def outliers(self) -> tuple[str, ...]:
        """Names of the robots with other bodies."""
        return tuple(robot.name for robot in self.robots if robot.outlier)

    def headline(self) -> Table:
        """Return the verdict on the bodies, and its main reason."""
        verdict = self.bodies.verdict
        share = (
            "shares of torque in this verdict are of the torque that friction and "
            "offsets, each robot's own, do not explain",
        )
        notes = verdict.brief
        notes = notes if verdict.word == "use" else (*notes[:1], *share, *notes[1:])
        return Table(f"Shared bodies: {verdict.word}", (), (), notes)

    def table(self) -> Table:
        """Return the robots, those that differ most first."""
        order = sorted(self.robots, key=lambda r: (not r.outlier, -r.statistic))
        notes = [
            "error: RMS residual over RMS torque, with the fleet's bodies, and of "
            "least squares of the robot alone",
            f"chi^2: rise of the squared misfit by sharing; a typical robot's is "
            f"{self.spread:.3g} times that of equal robots; p is for such robots",
            f"outliers: {', '.join(self.outliers) or 'none'} (nominal probability of "
            f"a false one: {LEVEL:g})",
        ]
        if len(self.robots) < FEWEST:
            notes[-1] = f"outliers are named only among {FEWEST} robots or more"
        if len(order) > _SHOWN:
            notes.append(f"the first {_SHOWN} of {len(order)} robots")
        if not self.settled:
            notes.append("bounds of friction still changed in the last round")
        return Table(
            f"Fleet of {len(self.robots)} robots {self.model.robot.name}",
            ("robot", "samples", "error", "alone", "chi^2", "expected", "p", "bodies"),
            tuple(
                (
                    robot.name,
                    str(robot.samples),
                    f"{robot.misfit:.2%}",
                    f"{robot.alone:.2%}",
                    f"{robot.statistic:.0f}",
                    str(robot.freedom),
                    f"{robot.p_value:.2g}",
                    "others" if robot.outlier else "shared",
                )
                for robot in order[:_SHOWN]
            ),
            tuple(notes),
        )

    def own_table(self) -> Table:
        """Return the friction and offsets of the fleet: median, spread, extremes."""
        names, units = self.model.layout.names, self.model.layout.units
        shared = set(self.bodies.model.layout.names)
        values = np.array([robot.parameters for robot in self.robots])
        rows = []
        for i, name in enumerate(names):
            if name in shared:
                continue
            column = values[:, i]
            median = float(np.median(column))
            least, most = (int(k) for k in (column.argmin(), column.argmax()))
            rows.append(
                (
                    name,
                    units[i],
                    f"{median:.4g}",
                    f"{np.median(abs(column - median)):.2g}",
                    f"{column[least]:.4g} ({self.robots[least].name})",
                    f"{column[most]:.4g} ({self.robots[most].name})",
                )
            )
        return Table(
            "Friction and offsets of the robots",
            ("parameter", "unit", "median", "median deviation", "least", "most"),
            tuple(rows),
        )

    def payload_table(self) -> Table | None:
        """Return robots' payloads: masses and centres; None if there are none."""
        rows = []
        for robot in self.robots:
            found = robot.payload
            if found is None:
                continue
            body = found.body
            half = found.quantiles[0] * found.standard_errors[0]
            rows.append(
                (
                    robot.name,
                    found.link,
                    f"{body.mass:.4g}",
                    f"{half:.2g}" if np.isfinite(half) else "open",
                    " ".join(f"{c:.3f}" for c in body.com) if body.mass > 0.0 else "-",
                    found.estimate.certificate.verdict,
                )
            )
        if not rows:
            return None
        return Table(
            "Payloads of the robots",
            ("robot", "on", "mass [kg]", "+- [kg]", "centre [m]", "optimum"),
            tuple(rows),
            (
                "+-: 95 %, by noise and by the errors of the shared bodies; open: "
                "the data do not separate it from its link",
            ),
        )

    def to_dict(self) -> dict[str, Any]:
        """Return plain numbers and text, ready for JSON."""
        names = self.model.layout.names
        return {
            "format": FORMAT,
            "bodies": self.bodies.to_dict(),
            "outliers": list(self.outliers),
            "spread": self.spread,
            "settled": self.settled,
            "seconds": self.seconds,
            "robots": {
                robot.name: {
                    "samples": robot.samples,
                    "error": robot.misfit,
                    "error_alone": robot.alone,
                    "chi2": robot.statistic,
                    "freedom": robot.freedom,
                    "p_value": robot.p_value,
                    "outlier": robot.outlier,
                    "parameters": dict(
                        zip(names, robot.parameters.tolist(), strict=True)
                    ),
                    **({} if robot.payload is None else robot.payload.to_dict()),
                }
                for robot in self.robots
            },
        }

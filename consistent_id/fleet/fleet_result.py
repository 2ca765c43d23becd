"""The result of a fleet: the bodies, and each robot."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from consistent_id._support.arrays import Vector, freeze_arrays
from consistent_id._support.tables import Table, brief
from consistent_id.errors import ProblemError
from consistent_id.estimation.estimate import Estimate
from consistent_id.fleet.outliers import FEWEST, LEVEL
from consistent_id.fleet.payloads import FoundPayload
from consistent_id.regression.regressor import TorqueModel
from consistent_id.robot.parameters import did_you_mean

FORMAT = "consistent_id fleet 1"
_SHOWN = 30  # robots in a table: those with the largest excess; a file has all


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

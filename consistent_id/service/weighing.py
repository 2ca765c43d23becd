"""A load weighed from logs of a robot with it and without: estimate and verdict."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from consistent_id._support.tables import Table, brief
from consistent_id.errors import ModelError, ProblemError
from consistent_id.estimation.gains import DriveGains, identify_gains
from consistent_id.estimation.judgement import MISFIT_CARE, MISFIT_REFUSED
from consistent_id.estimation.payload import Payload, identify_payload
from consistent_id.estimation.verdict import Reason, Verdict, percent, weighed
from consistent_id.problems.problem import Problem, require_problem
from consistent_id.recordings.column_words import is_current
from consistent_id.regression.torque_along import measured_torque
from consistent_id.robot.model import Datasheet, FixedFrame, Link
from consistent_id.service.controller_formats import ControllerLoad, require_load_name
from consistent_id.service.gain_check import (
    factors_table,
    gains_off,
    reasons_of_gains,
)
from consistent_id.service.load_quantities import (
    LoadQuantities,
    inertia_is_open,
    load_quantities,
    reasons_of_centre,
    reasons_of_inertia,
    reasons_of_mass,
)
from consistent_id.service.loaded_runs import (
    LoadedRuns,
    Recordings,
    flange_of,
    loaded_files,
    require_arm,
    tool_of,
)

FORMAT = "consistent_id payload 1"
"""Key ``format`` of the JSON record."""

METHOD = "payload"

MISPLACED = 0.001
"""Chance at most that a load is said to be on another link, although it is on its own.

For a misfit that is as correlated as the residuals.
"""

_VANISHING = 1e-6  # least misfit of a joint, over its torque

NEVER_SENT = (
    "mass not identifiable",
    "no load is seen",
    "centre of mass not identifiable",
)
"""Kinds of reasons with which a controller gets nothing, accepted or not."""


@brief
@dataclass(frozen=True, slots=True, eq=False)
class WeighedLoad:
    """A load, its frames, and whether its estimate may be sent to a controller.

    Parameters
    ----------
    payload : Payload
        The estimate, in the frame of the moving link that carries the load.
    flange, tool : FixedFrame
        Places of these frames in that link.
    residual : float
        Error of the predicted torque of the loaded logs over the torque, all joints.
    verdict : Verdict
    gains : DriveGains, optional
        Factors of the stated gains, from the mass that was stated; see `weigh_load`.
    corrected : bool
        Whether the load was estimated with torques times these factors.
    """

    payload: Payload
    flange: FixedFrame
    tool: FixedFrame
    residual: float
    verdict: Verdict
    gains: DriveGains | None = None
    corrected: bool = False

    def __repr__(self) -> str:
        mass = self.payload.body.mass
        return (
            f"WeighedLoad({self.payload.robot.load!r}, {mass:.4g} kg, {self.verdict})"
        )

    def __str__(self) -> str:
        return "\n\n".join(table.text() for table in self.tables())

    def _repr_html_(self) -> str:
        return "".join(table.html() for table in self.tables())

    @property
    def inertia_open(self) -> bool:
        """Whether the data leave the inertia about the centre of mass open."""
        return inertia_is_open(self.payload)

    @property
    def in_flange(self) -> LoadQuantities:
        """Mass, centre of mass and inertia in the frame of the flange."""
        return load_quantities(self.payload, self.flange)

    @property
    def in_tool(self) -> LoadQuantities:
        """Mass, centre of mass and inertia in the frame of the tool."""
        return load_quantities(self.payload, self.tool)

    @property
    def sendable(self) -> bool:
        """Whether controllers may get the load; see `NEVER_SENT`."""
        kinds = {reason.kind for reason in self.verdict.reasons}
        return self.verdict.usable and kinds.isdisjoint(NEVER_SENT)

    @property
    def for_controller(self) -> ControllerLoad:
        """The load as `controller_text` takes it.

        Raises
        ------
        ProblemError
            If the load is not to be used, or if its mass or centre of mass is not
            known: accepting that does not help.
        """
        if not self.sendable:
            reasons = self.verdict.reasons
            unknown = [reason for reason in reasons if reason.kind in NEVER_SENT]
            ground = (unknown or self.verdict.grounds)[0]
            raise ProblemError(
                f"do not use: {ground.kind}: {ground.statement}. {ground.advice}"
            )
        robot = self.payload.robot
        turned = self.flange.rotation.T
        tool = FixedFrame(
            self.tool.name,
            turned @ self.tool.rotation,
            turned @ (self.tool.translation - self.flange.translation),
        )
        return ControllerLoad(
            robot.load,
            self.in_flange.body,
            self.flange,
            self._link,
            tool,
            self.inertia_open,
            self._evidence,
        )

    @property
    def _link(self) -> str:
        """Name of the moving link that carries the load, or of a wrist sensor."""
        robot = self.payload.robot
        if robot.bare.robot.floating:
            return self.flange.name
        return robot.bare.robot.link_names[robot.carrier]

    @property
    def _evidence(self) -> str:
        """Verdict, accepted kinds and the mass with its interval, in one line."""
        verdict, flange = self.verdict, self.in_flange
        accepted = ", ".join(verdict.accepted) or "nothing"
        return (
            f"{verdict.word} (accepted: {accepted}); mass {flange.body.mass:.4g} kg, "
            f"95 % {flange.low[0]:.4g} to {flange.high[0]:.4g} kg"
        )

    def tables(self) -> list[Table]:
        """Return verdict, quantities in each frame, and gains if they were tested."""
        verdict = self.verdict
        never = [r.kind for r in verdict.reasons if r.kind in NEVER_SENT]
        notes = [f"controllers get nothing: {', '.join(never)}"] if never else []
        notes += [*verdict.brief, self.payload.condition]
        head = Table(verdict.sentence, (), (), tuple(notes))
        tables = [head, self.in_flange.table()]
        if self.tool.name != self.flange.name:
            tables.append(self.in_tool.table())
        if self.gains is not None:
            tables.append(factors_table(self.gains))
        return tables

    def to_dict(self) -> dict[str, Any]:
        """Return verdict, quantities with intervals, frames and gains."""
        gains = None
        if self.gains is not None:
            factors = zip(
                self.gains.joints,
                self.gains.gains.tolist(),
                self.gains.standard_errors.tolist(),
                strict=True,
            )
            gains = {
                joint: {"factor": f, "standard_error": e if np.isfinite(e) else None}
                for joint, f, e in factors
            }
        payload = self.payload
        return {
            "format": FORMAT,
            "load": payload.robot.load,
            **self.verdict.to_dict(),
            "link": self._link,
            "frames": {
                quantities.frame: quantities.to_dict()
                for quantities in (self.in_flange, self.in_tool)
            },
            "consistent": payload.body.is_consistent(1e-9),
            "inertia_open": self.inertia_open,
            "not_identifiable": list(payload.open),
            "residual": self.residual,
            "correlation": payload.correlation,
            "condition": payload.condition,
            "gain_factors": gains,
            "corrected": self.corrected,
        }


def weigh_load(
    problem: Problem,
    loaded: str | Path | Sequence[str | Path],
    *,
    rows: Sequence[int] | None = None,
    omit: Sequence[int] = (),
    link: str | None = None,
    tool: str | Sequence[float] | None = None,
    name: str = "payload",
    known_mass: float | None = None,
    gain_errors: ArrayLike = 0.0,
    accepted: Sequence[str] = (),
) -> WeighedLoad:
    """Estimate what a robot carries, from a log with the load and those without.

    Logs with the load are read and prepared as the problem's own recordings, which are
    without it: the same columns, units, filters and delays.  Torques, currents or the
    forces of a wrist sensor show the load.

    Parameters
    ----------
    problem : Problem
        The robot without the load: of `load_problem`, `draft_problem` or
        ``open_results(folder).problem``.
    loaded : str, Path or sequence of them
        Logs with the load.
    rows : sequence of int, optional
        The first and the last row of these logs that count, from 1.
    omit : sequence of int
        Broken rows of these logs, from 1.
    link : str, optional
        Link or fixed frame that carries the load, such as the flange; controllers get
        the load in its frame.  By default the problem's ``payload.link``, or the last
        link of a chain.
    tool : str or sequence of float, optional
        The tool's frame: a fixed frame of the same link, or ``x, y, z`` [m] and
        optionally ``roll, pitch, yaw`` [rad] in the frame of `link`.
    name : str
        Name of the load; none of the robot's links has it.
    known_mass : float, optional, [kg]
        If the load was weighed on a scale.  The load then has this mass, and the mass
        that the torques show is compared with it.  The gains that convert currents to
        torque are tested, and corrected where they are identified and wrong.
    gain_errors : float or array_like
        Relative standard errors of these gains, or their covariance; see
        `identify_payload`.
    accepted : sequence of str
        Kinds of reasons for the verdict that are overlooked.

    Raises
    ------
    ProblemError
        If the problem has no recordings or a base that floats, if a frame is on another
        link, or if `rows` or `known_mass` make no sense.
    ModelError
        If there is no such link or frame, or the load has a link's name.
    RecordingError, InfeasibleError, NotExcitedError, SolverError
        See `identify_payload`.
    """
    require_problem(problem, "weigh_load")
    require_load_name(name)
    require_arm(problem, known_mass)
    robot = problem.model.robot
    if name in robot.link_names:
        raise ModelError(
            f"name of the load is {name!r}, which is a link of {robot.name!r}; choose "
            "another name"
        )
    flange = flange_of(problem, link)
    placed = tool_of(robot, flange, tool)
    runs = LoadedRuns(problem, loaded_files(loaded, rows), rows, tuple(omit))
    carrier = robot.link_names[flange.carrier]
    load = Link(name, datasheet=Datasheet())
    found = _estimated(runs, load, carrier, known_mass, gain_errors)
    reasons = (
        *_of_assumed_gains(problem, found, gain_errors),
        *_reasons(found, flange.frame, known_mass),
    )
    return WeighedLoad(
        found.payload,
        flange.frame,
        placed,
        found.residual,
        weighed(METHOD, reasons, tuple(accepted), None, ()),
        found.gains,
        found.corrected,
    )


class _Estimated(NamedTuple):
    """A load and its logs; factors of gains if a mass was stated, and of which joints.

    Logs are those with the load, and those without it.
    """

    payload: Payload
    logs: tuple[Recordings, Recordings]
    gains: DriveGains | None = None
    applied: tuple[str, ...] = ()

    @property
    def corrected(self) -> bool:
        return bool(self.applied)

    @property
    def residual(self) -> float:
        """Error of the torques of the loaded logs over the torques, all joints."""
        error, size = 0.0, 0.0
        for log in self.logs[0]:
            torque = measured_torque(self.payload.robot.bare, log)
            error += float(np.sum((self.payload.predict(log) - torque) ** 2))
            size += float(np.sum(torque**2))
        return float(np.sqrt(error / size)) if size > 0.0 else np.inf


def _estimated(
    runs: LoadedRuns,
    load: Link,
    carrier: str,
    known_mass: float | None,
    gain_errors: ArrayLike,
) -> _Estimated:
    """Return the load; with corrected gains if its known mass shows them to be off."""
    problem, logs = runs.problem, runs.read({})
    model, constraints = runs.model, problem.constraints

    def of(
        logs: tuple[Recordings, Recordings],
        load: Link,
        errors: ArrayLike,
    ) -> _Estimated:
        payload = identify_payload(
            model,
            *logs,
            load=load,
            carrier=carrier,
            constraints=constraints,
            gain_errors=errors,
        )
        return _Estimated(payload, logs)

    if known_mass is None:
        return of(logs, load, gain_errors)
    of_scale = replace(load, datasheet=Datasheet(mass=known_mass))
    if problem.arm is not None:  # forces are measured, without gains
        return of(logs, of_scale, gain_errors)
    known = {f"{load.name}.m": known_mass}
    gains = identify_gains(model, *logs, known=known, load=load, carrier=carrier)
    stated = problem.table.data is not None and problem.table.data.gains is not None
    change = gains_off(gains) & np.array(gains.identified)
    if gains.scale_open or stated or not change.any():
        return of(logs, of_scale, gain_errors)._replace(gains=gains)
    factors = np.where(change, gains.gains, 1.0)
    errors = np.diag(np.broadcast_to(gain_errors, change.shape) ** 2)
    errors[np.ix_(change, change)] = gains.covariance[np.ix_(change, change)]
    changed = dict(zip(gains.joints, factors.tolist(), strict=True))
    better = of(runs.read(changed), of_scale, errors)
    applied = tuple(j for j, one in zip(gains.joints, change, strict=True) if one)
    return better._replace(gains=gains, applied=applied)


def _reasons(
    found: _Estimated, flange: FixedFrame, known_mass: float | None
) -> Iterator[Reason]:
    payload = found.payload
    yield from reasons_of_mass(payload, known_mass)
    if payload.free.mass > 0.0:
        yield from reasons_of_centre(load_quantities(payload, flange))
    yield from _of_place(payload, *found.logs)
    yield from _of_residual(found.residual)
    if found.gains is not None:
        yield from reasons_of_gains(found.gains, found.applied)
    if payload.estimate.certificate.verdict != "certified":
        yield Reason(
            "optimum not proven",
            "use with care",
            payload.estimate.certificate.reason,
        )
    yield from reasons_of_inertia(payload)


def _of_assumed_gains(
    problem: Problem, found: _Estimated, gain_errors: ArrayLike
) -> Iterator[Reason]:
    """Doubt gains that nobody measured, unless a known mass tested them."""
    data = problem.table.data
    if data is None or found.gains is not None:
        return
    torque = None if data.columns is None else data.columns.torque
    if data.gain_source == "drives":
        if is_current(torque or "") and np.all(np.equal(data.torque_gain, 1.0)):
            yield Reason(
                "assumed gains",
                "use with care",
                f"torque is read from {torque}, whose name denotes a current, with the "
                "gain 1: the load is right only if these columns are torques in N m",
                "if they are amperes, find the gains by a load of known mass first: "
                "consistent-id gains",
            )
        return
    ignored = "" if np.any(gain_errors) else ", and the intervals ignore their errors"
    errors = "" if np.any(gain_errors) else "state their errors (--gain-errors 5), or "
    yield Reason(
        "assumed gains",
        "use with care",
        f"the gains of the torque were taken from the model's bodies{ignored}",
        f"{errors}weigh a load of known mass first: consistent-id gains",
    )


def _of_place(
    payload: Payload, loaded: Recordings, unloaded: Recordings
) -> Iterator[Reason]:
    """Yield a reason if a load on another link explains the torques better."""
    from scipy.special import chdtri

    robot = payload.robot
    links = robot.bare.robot.link_names
    if len(links) < 2:
        return
    residuals = robot.residuals(payload.least_squares.parameters, unloaded, loaded)
    torque = np.vstack([measured_torque(robot.bare, log) for log in loaded])
    floor = _VANISHING * np.sqrt(np.mean(torque**2, axis=0))
    sigma = np.maximum(np.sqrt(np.mean(residuals**2, axis=1)), floor)
    misfits = robot.misfits(unloaded, loaded, sigma)
    best, own = int(np.argmin(misfits)), misfits[robot.carrier]
    independent = residuals.size / payload.correlation
    # Twice the logarithm of the ratio of likelihoods, for ten parameters on either side
    gain = independent * np.log(own / misfits[best])
    if gain > chdtri(10, MISPLACED / len(links)):
        yield Reason(
            "not attached to this link",
            "do not use",
            f"with the load on {links[best]} instead of {links[robot.carrier]}, the "
            f"misfit of robot and load is {percent(np.sqrt(misfits[best] / own))} of "
            "this one",
            f"name the link that carries it, such as --link {links[best]}; check that "
            "the logs differ by this load alone",
        )


def _of_residual(residual: float) -> Iterator[Reason]:
    if residual <= MISFIT_CARE:
        return
    yield Reason(
        "misfit",
        "do not use" if residual > MISFIT_REFUSED else "use with care",
        f"robot and load miss {percent(residual)} of the torque of the loaded logs",
        "check the logs with consistent-id check, and that the load is fixed to this "
        "link",
    )

"""Gains between currents and torque, by a load of known mass or the file's bodies."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import NormalDist
from typing import Any

import numpy as np

from consistent_id._support.arrays import BoolArray, Vector, freeze_arrays
from consistent_id._support.tables import Table, brief
from consistent_id.errors import ProblemError
from consistent_id.estimation.gains import DriveGains, identify_gains
from consistent_id.estimation.verdict import Reason, Verdict, percent, weighed
from consistent_id.problems.nominal_gains import NominalGains, implied_gains
from consistent_id.problems.problem import Problem, require_problem
from consistent_id.regression.residual_noise import NORMAL
from consistent_id.robot.model import Link
from consistent_id.service.loaded_runs import (
    LoadedRuns,
    flange_of,
    loaded_files,
    require_arm,
)

FORMAT = "consistent_id gains 1"
"""Key ``format`` of the JSON record."""

METHOD = "gains"

LEAST_OFF = 0.02
"""Least relative error of a gain that is called off."""

_OF_ITS_UNIT = 2.0  # most factor between a torque channel of N m and the torque


@brief
@dataclass(frozen=True, slots=True, eq=False)
class GainCheck:
    """Gains that a load of known mass implies, beside those that a problem states.

    Parameters
    ----------
    factors : DriveGains
        From the torques with the stated gains: one where these are right.
    stated : array_like, shape (torque joints,), [N m/A or N/A]
        One each if the problem states none.
    verdict : Verdict
        Whether the gains may be used.
    """

    factors: DriveGains
    stated: Vector
    verdict: Verdict

    def __post_init__(self) -> None:
        freeze_arrays(self, {"stated": (len(self.factors.joints),)})

    def __str__(self) -> str:
        return self.table().text()

    def _repr_html_(self) -> str:
        return self.table().html()

    @property
    def gains(self) -> Vector:
        """The gains, shape (torque joints,), [N m/A or N/A]."""
        return np.asarray(self.stated * self.factors.gains)

    @property
    def half_intervals(self) -> Vector:
        """Half of the gains' 95 % intervals; infinite where not identifiable."""
        return np.asarray(NORMAL * self.stated * self.factors.standard_errors)

    @property
    def unstated(self) -> bool:
        """Whether the stated gains are no gains; see `gains_unstated`."""
        return gains_unstated(self.factors, self.stated)

    @property
    def off(self) -> BoolArray:
        """Whether each stated gain is off; see `gains_off`.  Not if none is stated."""
        return np.asarray(gains_off(self.factors) & (not self.unstated))

    @property
    def unknown(self) -> BoolArray:
        """Whether a gain's 95 % interval is as wide as the gain, or wider."""
        return np.asarray(~(NORMAL * self.factors.relative_errors < 1.0))

    def table(self) -> Table:
        """Return stated and identified gains, with 95 % intervals."""
        rows = []
        for place, joint in enumerate(self.factors.joints):
            stated, found = f"{self.stated[place]:.4g}", ("-",) * 4
            if not self.unknown[place]:
                found = (
                    f"{self.gains[place]:.4g}",
                    f"{self.half_intervals[place]:.2g}",
                    f"{100.0 * (self.factors.gains[place] - 1.0):+.1f}",
                    "off" if self.off[place] else "not off",
                )
            if self.unstated:
                stated, found = "-", (*found[:2], "-", "-")
            rows.append((joint, stated, *found))
        header = ("joint", "stated", "gain", "95 % +-", "change, %", "stated gain is")
        notes = self.verdict.brief
        if not self.unknown.any():
            listed = ", ".join(f"{gain:.5g}" for gain in self.gains)
            words = " ".join(f"{gain:.5g}" for gain in self.gains)
            errors = " ".join(
                f"{100.0 * error:.2g}" for error in self.factors.relative_errors
            )
            notes = (
                *notes,
                f"torque_gain = [{listed}]",
                f"in a shell: --torque-gain {words}",
                f"for payload also: --gain-errors {errors}",
            )
        return Table(self.verdict.sentence, header, tuple(rows), notes)

    def to_dict(self) -> dict[str, Any]:
        """Return verdict, and gains with their intervals; None where unknown."""
        return {
            "format": FORMAT,
            **self.verdict.to_dict(),
            "gains": {
                joint: {
                    "stated": stated,
                    "gain": None if unknown else gain,
                    "half_interval": None if unknown else half,
                    "off": off,
                }
                for joint, stated, gain, half, off, unknown in zip(
                    self.factors.joints,
                    self.stated.tolist(),
                    self.gains.tolist(),
                    self.half_intervals.tolist(),
                    self.off.tolist(),
                    self.unknown.tolist(),
                    strict=True,
                )
            },
            "current_noise": self.factors.current_noise.tolist(),
            "correlation": self.factors.correlation,
        }


def check_gains(
    problem: Problem,
    loaded: str | Path | Sequence[str | Path],
    *,
    known_mass: float,
    rows: Sequence[int] | None = None,
    omit: Sequence[int] = (),
    link: str | None = None,
    accuracy: float = 0.05,
    accepted: Sequence[str] = (),
) -> GainCheck:
    """Identify gains between currents and torque, from logs with a load and without.

    Parameters
    ----------
    problem : Problem
        The robot without the load; see `weigh_load`.
    loaded : str, Path or sequence of them
        Logs with the load.
    known_mass : float, [kg]
        Mass of the load, from a scale.
    rows, omit, link
        See `weigh_load`.
    accuracy : float
        Relative standard error up to which a gain counts as identified.
    accepted : sequence of str
        Kinds of reasons for the verdict that are overlooked.

    Raises
    ------
    ProblemError
        See `weigh_load`; also if the torques come from commands and PD gains, or
        there is a wrist sensor in place of torques.
    ModelError
        See `weigh_load`.
    NotExcitedError, RecordingError, SolverError
        See `identify_gains`.
    """
    require_problem(problem, "check_gains")
    require_arm(problem, known_mass)
    _require_currents(problem)
    flange = flange_of(problem, link)
    load = _unused(problem.model.robot.link_names)
    runs = LoadedRuns(problem, loaded_files(loaded, rows), rows, tuple(omit))
    factors = identify_gains(
        runs.model,
        *runs.read({}),
        known={f"{load}.m": known_mass},
        load=Link(load),
        carrier=problem.model.robot.link_names[flange.carrier],
        accuracy=accuracy,
    )
    stated = [runs.stated_gains[joint] for joint in factors.joints]
    reasons = _reasons(factors, np.array(stated))
    verdict = weighed(METHOD, reasons, tuple(accepted), None, ())
    return GainCheck(factors, np.array(stated), verdict)


def problem_gains(problem: Problem) -> NominalGains:
    """Return the gains that the bodies of the robot's file imply for a problem's logs.

    Stated gains are not used.

    Raises
    ------
    ProblemError
        If the base floats, or there are no logs of torque or current.
    RecordingError
        If a log cannot be read, or the bodies imply no gains.
    """
    require_problem(problem, "problem_gains")
    require_arm(problem, None)
    _require_currents(problem)
    robot, data = problem.model.robot, problem.table.data
    stated = np.asarray(1.0 if data is None else data.torque_gain)
    logs = [
        log if log.torque is None else replace(log, torque=log.torque / stated)
        for role in ("training", "validation")
        for log in problem.logs(role)
    ]
    return implied_gains(robot, logs, f"problem {problem.name!r}")


def _require_currents(problem: Problem) -> None:
    """Refuse wrist sensors, and torques that are computed from joints' commands."""
    if problem.arm is not None:
        raise ProblemError(
            f"problem {problem.name!r} is of a wrist sensor, which measures forces: "
            "there are no gains of currents"
        )
    data = problem.table.data
    if data is not None and data.gains is not None:
        raise ProblemError(
            f"problem {problem.name!r} computes torque from the joints' commands "
            "([data.gains]), so that torque_gain has no meaning; a known mass shows "
            "gains of logs of current or torque"
        )


def _unused(names: Sequence[str]) -> str:
    """Return a name for the load that no link has."""
    name = "load"
    while name in names:
        name += "_"
    return name


def gains_off(factors: DriveGains) -> BoolArray:
    """Return whether each factor differs from one, by at least `LEAST_OFF`.

    All joints are tested together at 95 %: the quantile is that of Sidak.
    """
    share = 0.95 ** (1.0 / len(factors.joints))
    half = NormalDist().inv_cdf(0.5 + 0.5 * share) * factors.standard_errors
    return np.asarray(abs(factors.gains - 1.0) > np.maximum(half, LEAST_OFF))


def gains_unstated(factors: DriveGains, stated: Vector) -> bool:
    """Return whether a log is in its drives' own unit, and no gains are stated.

    The stated gains are one then, and none that is identified is near it.
    """
    known = factors.gains[np.array(factors.identified)]
    far = abs(np.log(known)) > np.log(_OF_ITS_UNIT)
    return bool((stated == 1.0).all() and len(known) and far.all())


def _reasons(factors: DriveGains, stated: Vector) -> Iterator[Reason]:
    poor = [
        joint
        for joint, good in zip(factors.joints, factors.identified, strict=True)
        if not good
    ]
    if poor:
        every = len(poor) == len(factors.joints)
        yield Reason(
            "gains not identifiable",
            "do not use" if every else "use with care",
            f"gains of {', '.join(poor)} have standard errors above "
            f"{percent(factors.accuracy)}",
            "check that loaded logs have the load, and the others have not"
            if every
            else "use a heavier known load, or motions that change these torques",
        )
    wrong = int(gains_off(factors).sum())
    if wrong and not gains_unstated(factors, stated):
        yield Reason(
            "gains are off",
            "use",
            f"stated gains of {wrong} of {len(factors.joints)} joints are off by "
            f"{percent(LEAST_OFF)} or more (95 %, all joints together)",
        )


def reasons_of_gains(gains: DriveGains, applied: tuple[str, ...]) -> Iterator[Reason]:
    """Return the reasons for a load's verdict that its known mass gives.

    Parameters
    ----------
    applied : tuple of str
        Joints whose torques were multiplied by their factors.
    """
    if gains.scale_open:
        yield Reason("gains not tested", "use with care", gains.verdict)
        return
    known = zip(gains.joints, gains.identified, strict=True)
    if poor := [joint for joint, good in known if not good]:
        yield Reason(
            "gains not tested",
            "use with care",
            f"the known mass does not show the gains of {', '.join(poor)} to "
            f"{percent(gains.accuracy)}",
            "use a heavier load, or motions in which it changes these torques",
        )
    wrong = np.flatnonzero(gains_off(gains))
    if not len(wrong):
        return
    worst = wrong[np.argmax(abs(np.log(gains.gains[wrong])))]
    change, error = gains.gains[worst] - 1.0, NORMAL * gains.standard_errors[worst]
    done = f"; those of {', '.join(applied)} are changed here" if applied else ""
    every = {gains.joints[place] for place in wrong} <= set(applied)
    yield Reason(
        "gains are off",
        "use with care" if every else "do not use",
        f"by the mass, the torque of {gains.joints[worst]} differs by "
        f"{100.0 * change:+.0f} % (+- {100.0 * error:.0f} %), and the gains of "
        f"{len(wrong)} of {len(gains.joints)} joints are others{done}",
        "multiply torque_gain by the factors, and identify the robot again",
    )


def factors_table(gains: DriveGains) -> Table:
    """Return the factors that a known mass shows, with 95 % intervals."""
    rows = tuple(
        (joint, f"{factor:.4f}", f"{NORMAL * error:.4f}")
        for joint, factor, error in zip(
            gains.joints, gains.gains, gains.standard_errors, strict=True
        )
    )
    title = "Factors of the gains, by the mass that was stated"
    return Table(title, ("joint", "factor", "95 % +-"), rows)

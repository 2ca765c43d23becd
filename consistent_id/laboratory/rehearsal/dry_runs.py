"""The dry run of a problem: its design, and rivals, played by planted robots.

They play here or wherever an executor says.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from consistent_id._support.arrays import Matrix, Vector
from consistent_id._support.executors import Executor, single_threaded
from consistent_id._support.progress import counted
from consistent_id._support.run import note_stop
from consistent_id._support.tables import Table, brief
from consistent_id.errors import ModelError, ProblemError
from consistent_id.excitation.accuracy import (
    PredictedAccuracy,
    predicted_accuracy,
    with_default_noise,
)
from consistent_id.excitation.aims import Aim, PathForm
from consistent_id.excitation.basis import FourierBasis, limit_rows
from consistent_id.excitation.criteria import Objective
from consistent_id.excitation.design import design_trajectory
from consistent_id.excitation.designed import ExcitationDesign
from consistent_id.excitation.playable import validation_trajectory
from consistent_id.excitation.request import design_request
from consistent_id.excitation.search_problem import search_problem
from consistent_id.laboratory.rehearsal.planted import (
    PlantedRobot,
    Rehearsed,
    as_rehearsed,
    planted_robot,
)
from consistent_id.laboratory.rehearsal.rehearsal import (
    Rehearsal,
    rehearsal_table,
    rehearse,
)
from consistent_id.motion.limits import MotionLimits
from consistent_id.problems.problem import Problem
from consistent_id.recordings.joint_paths import FourierTrajectory, JointPath

DESIGN = "design"
_RANDOM = 3  # random paths among the rivals
_USED = 0.9  # share of the limits that sinusoids use
_LARGE = 0.25  # share of a torque limit from which ratios of peaks are of interest
_KEPT = 0.01  # share of a limit by which one is exceeded that still counts as kept


@dataclass(frozen=True, slots=True, eq=False)
class PredictedMotion:
    """A motion to play, and the predictions for it."""

    path: JointPath
    accuracy: PredictedAccuracy


@dataclass(frozen=True, slots=True, eq=False)
class RehearsalPlan:
    """The common settings of all rehearsed robots; see `rehearse`.

    Parameters
    ----------
    validation : JointPath
    limits : MotionLimits
    noise : ndarray, shape (joints,), [N m or N]
    highest : float, [Hz]
    rate : float, [Hz]
    seed : int
    """

    validation: JointPath
    limits: MotionLimits
    noise: Vector
    highest: float
    rate: float
    seed: int


@brief
@dataclass(frozen=True, slots=True, eq=False)
class DryRun:
    """A design and perhaps its rivals, played by several planted robots.

    Parameters
    ----------
    rehearsals : mapping of str to tuple of Rehearsal
        By motion; ``"design"`` is the design's, and ``"random paths"`` are several.
    conditions : mapping of str to float
        Condition number of each motion; the median of several.
    peaks : ndarray, shape (2, robots and joints)
        True peaks of the design's torque, and those that were proven, in shares of the
        limits; friction and control are in the true ones.  None where there is no
        limit.
    share : float
        Share of the limits, that the design was allowed to use.
    notes : tuple of str
        On what of the problem is not rehearsed.
    """

    design: ExcitationDesign
    rehearsals: Mapping[str, tuple[Rehearsal, ...]]
    conditions: Mapping[str, float]
    peaks: Matrix
    share: float = 1.0
    notes: tuple[str, ...] = ()

    @property
    def share_to_use(self) -> float:
        """Share of all limits to design with, so that tracking keeps them, too."""
        return min(self.share, self.share / max(self.beyond.values()))

    @property
    def beyond(self) -> dict[str, float]:
        """Largest true share of each limit that the design used, by quantity."""
        own = self.rehearsals[DESIGN]
        names = own[0].reached
        return {n: float(max(one.reached[n].max() for one in own)) for n in names}

    @property
    def came_true(self) -> bool:
        """Whether errors were as small as predicted, and limits and poses were kept."""
        own = self.rehearsals[DESIGN]
        errors = float(np.sqrt(np.mean([one.ratio**2 for one in own]))) <= 1.0
        limits = max(self.beyond.values()) <= 1.0 + _KEPT
        return errors and limits and all(o.holding.held == o.holding.poses for o in own)

    def tables(self) -> list[Table]:
        """Return the results of the design's predictions, as tables."""
        name = self.design.model.robot.name
        table = rehearsal_table(f"Rehearsal of {name} in MuJoCo", self.rehearsals)
        rows = tuple((*row, f"{self.conditions[row[0]]:.4g}") for row in table.rows)
        table = replace(table, header=(*table.header, "condition"), rows=rows)
        limits = Table(
            "Largest share of a limit, as the design was played",
            ("limit of", "share", "kept"),
            tuple(
                (quantity, f"{100.0 * share:.1f} %", _kept(share))
                for quantity, share in self.beyond.items()
            ),
            tuple(self._notes()),
        )
        return [table, limits]

    def _notes(self) -> Iterator[str]:
        yield from self.notes
        yield "the proof is for the wanted motion; a controller lags behind it"
        if self.share_to_use < self.share:
            share = np.floor(100.0 * self.share_to_use) / 100.0
            yield f"with --share {share:g} tracking like this keeps all limits"
        true, proven = self.peaks
        if len(true):
            more = 100.0 * (true - proven)
            yield (
                "friction and control took peaks of torque above the proven ones by "
                f"{np.median(more):.0f} % of the limit (median), {more.max():.0f} % "
                "(most)"
            )
        if (large := proven >= _LARGE).any():
            times = true[large] / proven[large]
            yield (
                f"to {np.median(times):.2f} times (median), {times.max():.2f} (most), "
                f"of joints that were to use {100.0 * _LARGE:.0f} % of it or more"
            )

    def to_dict(self) -> dict[str, object]:
        """Return the same for JSON."""
        return {
            "came_true": self.came_true,
            "largest_shares": self.beyond,
            "share_to_use": self.share_to_use,
            "peak_torque_shares": self.peaks[0].tolist(),
            "proven_torque_shares": self.peaks[1].tolist(),
            "motions": {
                name: {
                    "condition": self.conditions[name],
                    "robots": [
                        {
                            "mean_error": one.mean_error,
                            "held_out": one.held_out,
                            "errors_over_predicted": one.ratio,
                            "covered": one.covered,
                            "poses_held": one.holding.held,
                            "poses": one.holding.poses,
                            "tracking_error": one.tracking,
                        }
                        for one in some
                    ],
                }
                for name, some in self.rehearsals.items()
            },
        }


def _kept(share: float) -> str:
    return "yes" if share <= 1.0 + _KEPT else "no"


def _planted(
    rehearsed: Rehearsed,
    limits: MotionLimits,
    currents: float | None,
    robots: int,
    seed: int,
) -> list[PlantedRobot]:
    """Return so many robots near the nominal one."""
    known = None if rehearsed.parameters is None else rehearsed.parameters[0]
    robot = rehearsed.model.robot
    return [
        planted_robot(robot, limits, rng, currents, known)
        for rng in (np.random.default_rng((seed, k)) for k in range(robots))
    ]


def _rehearsed(problem: Problem, aim: Aim, parameters: ArrayLike | None) -> Rehearsed:
    """Return the model that is rehearsed; refuse what no motion alone identifies."""
    if aim.others == "known":
        raise ProblemError(
            "others = 'known' is of a load on a known robot, but a rehearsal "
            "identifies robots from the motion alone; leave it out"
        )
    given = None if parameters is None else np.atleast_2d(np.asarray(parameters, float))
    rehearsed = as_rehearsed(problem.model, tuple(aim.interest), given)
    robot = rehearsed.model.robot
    if robot.nominal is None:
        raise ModelError(
            f"robot {robot.name!r}: some links have no nominal inertia, so that no "
            "robot like it can be planted; give the file inertias, or an estimate"
        )
    return rehearsed


def dry_run(
    problem: Problem,
    *,
    parameters: ArrayLike | None = None,
    robots: int = 3,
    rivals: bool = False,
    currents: float | None = None,
    starts: int = 4,
    time_limit: float = 10.0,
    seed: int = 0,
    workers: int | None = None,
    executor: str | Executor | None = None,
    progress: bool = False,
) -> DryRun:
    """Design what a problem requests, and let planted robots play it.

    The robot is identified by rigid bodies, viscous and Coulomb friction and rotors,
    whatever the problem's ``[drive]`` says.

    Parameters
    ----------
    parameters : array_like, shape (parameters,) or (members, parameters), optional
        Parameters of estimates of the problem's torque model: the worst of them keeps
        the limits of torque, and robots are planted near the first.
    robots : int
        Planted at random, see `planted_robot`.
    rivals : bool
        Whether to play also a design for the least condition number, random paths and
        plain sinusoids.
    currents : float, optional
        If robots log motor currents, not torque: the share to which their torque
        constants are known.
    starts, time_limit, seed, workers, progress
        See `design_trajectory`.
    executor : str or Executor, optional
        Where the design is searched for, see `design_trajectory`, and where robots
        play; the result is the same.

    Raises
    ------
    ModelError
        If MuJoCo is not installed, or nominal inertias are missing.
    ProblemError
        If nothing of interest is rehearsed, the motion is for a load on a known robot,
        or no robot has an estimate's bodies.
    """
    if robots < 1:
        raise ProblemError(f"robots is {robots}, expected 1 or more")
    request, where = design_request(problem), Executor.chosen(executor)
    rehearsed = _rehearsed(problem, request.aim, parameters)
    model = rehearsed.model
    aim = _rehearsed_aim(request.aim, rehearsed, request.limits)

    def designed(aim: Aim, forms: tuple[PathForm, ...]) -> ExcitationDesign:
        return design_trajectory(
            model, forms, aim, limits=request.limits, scene=request.scene,
            parameters=rehearsed.parameters,
            friction_share=request.friction_share, stated=request.stated, starts=starts,
            time_limit=time_limit, seed=seed, workers=workers, executor=where,
            progress=progress,
        )  # fmt: skip

    design = designed(aim, request.forms)
    paths: dict[str, list[FourierTrajectory]] = {DESIGN: [design.trajectory]}
    if rivals:
        other: Objective = "D" if aim.objective == "condition" else "condition"
        rival = designed(replace(aim, objective=other), (design.form,))
        paths |= _stages(rival, other) | _simple_motions(design, aim, seed)
    motions = _predicted(design, paths)
    rehearsals = played_by_all(
        _plan(design, request.limits, seed),
        motions,
        _planted(rehearsed, request.limits, currents, robots, seed),
        executor=where,
        progress=progress,
    )
    return DryRun(
        design,
        rehearsals,
        conditions={name: _condition(motions[name]) for name in rehearsals},
        peaks=_peaks(design, request.limits, rehearsals[DESIGN]),
        share=problem.table.excitation.limits.share,
        notes=rehearsed.notes,
    )


def _predicted(
    design: ExcitationDesign, paths: Mapping[str, Sequence[FourierTrajectory]]
) -> dict[str, list[PredictedMotion]]:
    """Return the motions with the accuracy that the design's aim predicts for them."""
    model, base, aim = design.model, design.base, design.aim
    return {
        name: [
            PredictedMotion(path, predicted_accuracy(model, base, path, aim))
            for path in alike
        ]
        for name, alike in paths.items()
    }


def _plan(design: ExcitationDesign, limits: MotionLimits, seed: int) -> RehearsalPlan:
    """Return the settings with which all robots play; all have the same noise."""
    return RehearsalPlan(
        validation=validation_trajectory(design, seed=seed).trajectory,
        limits=limits,
        noise=design.aim.noise_of(design.model.torque_joints),
        highest=float(design.form.frequencies[-1]),
        rate=design.aim.rate,
        seed=seed,
    )


def _condition(motions: Sequence[PredictedMotion]) -> float:
    """Return the median condition number."""
    return float(np.median([one.accuracy.condition.value for one in motions]))


def _peaks(
    design: ExcitationDesign, limits: MotionLimits, played: Sequence[Rehearsal]
) -> Matrix:
    """Return true and proven peaks of torque, in shares of the limits."""
    margins = design.proof.margins.margins
    proven = {m.joint: m.bound for m in margins if m.quantity == "torque"}
    places = [k for k, joint in enumerate(limits.joints) if joint in proven]
    shares = np.array([proven[limits.joints[k]] / limits.effort[k] for k in places])
    reached = np.array([one.reached["torque"][places] for one in played])
    return np.array([reached, np.broadcast_to(shares, reached.shape)]).reshape(2, -1)


def _rehearsed_aim(aim: Aim, rehearsed: Rehearsed, limits: MotionLimits) -> Aim:
    """Return the aim with noise: as stated, half a percent of effort, or 1 N m."""
    aim, model = replace(aim, interest=rehearsed.interest), rehearsed.model
    assumed = with_default_noise(replace(aim, objective="D"), model, limits)
    noise: Vector = assumed.noise_of(model.torque_joints)
    if aim.noise is not None or aim.objective == "condition":
        return aim if aim.noise is not None else replace(aim, noise=noise)
    return replace(aim, noise=noise, assumed_noise=assumed.assumed_noise)


def _stages(
    rival: ExcitationDesign, objective: Objective
) -> dict[str, list[FourierTrajectory]]:
    """Return the result of each stage of a rival's search."""
    names = [f"{stage.objective} alone" for stage in rival.stages[:1]]
    names += [f"{objective} first, then {s.objective}" for s in rival.stages[1:]]
    return {
        name: [stage.trajectory]
        for name, stage in zip(names, rival.stages, strict=True)
    }


def _simple_motions(
    design: ExcitationDesign, aim: Aim, seed: int
) -> dict[str, list[FourierTrajectory]]:
    """Return random paths, and one sinusoid for each joint."""
    model, form, limits = design.model, design.form, design.limits
    problem = search_problem(model, design.base, form, aim, limits)
    problem = replace(problem, seed=seed)
    random = [problem.basis.trajectory(problem.random(k)) for k in range(_RANDOM)]
    sinusoids = _sinusoids(form, limits)
    return {"random paths": random, "sinusoids": [sinusoids]}


def _sinusoids(form: PathForm, limits: MotionLimits) -> FourierTrajectory:
    """Return one sinusoid for each joint, each of another harmonic, within limits."""
    frequencies = form.frequencies
    basis = FourierBasis(limits, frequencies, form.duration, False)
    terms, joints = len(frequencies), len(limits.joints)
    variables = np.zeros((basis.size, joints))
    for j in range(joints):
        variables[1 + terms + j % terms, j] = 1.0
    period = basis.trajectory(np.zeros_like(variables)).period
    variables *= _USED / limit_rows(basis, period).largest(variables)
    return basis.trajectory(variables)


def played_by_all(
    plan: RehearsalPlan,
    motions: Mapping[str, Sequence[PredictedMotion]],
    robots: Sequence[PlantedRobot],
    *,
    executor: Executor | None = None,
    progress: bool = False,
) -> dict[str, tuple[Rehearsal, ...]]:
    """Let every robot play every motion; each has the same noise in all of them.

    An interrupt leaves what has been played so far, if anything has.

    Parameters
    ----------
    plan : RehearsalPlan
    motions : mapping of str to sequence of PredictedMotion
        By name; several of one name are alike, such as random paths.
    robots : sequence of PlantedRobot
    executor : Executor, optional
        Where robots play; the result is the same.  By default here.
    progress : bool
        Show a bar.
    """
    names, tasks = [], []
    for name, alike in motions.items():
        for motion in alike:
            tasks += [(motion, robot, k) for k, robot in enumerate(robots)]
            names += [name] * len(robots)
    found: list[Rehearsal] = []
    results = (executor or Executor()).map(partial(_rehearsed_one, plan), tasks)
    with counted(len(tasks), "motions played", progress) as count:
        try:
            for one in results:
                found.append(one)
                count(len(found))
        except KeyboardInterrupt as cause:
            if not found:
                raise
            note_stop(cause)
    return {
        name: tuple(one for own, one in zip(names, found, strict=False) if own == name)
        for name in dict.fromkeys(names[: len(found)])
    }


@single_threaded
def _rehearsed_one(
    plan: RehearsalPlan, task: tuple[PredictedMotion, PlantedRobot, int]
) -> Rehearsal:
    motion, robot, number = task
    return rehearse(
        robot,
        motion.accuracy,
        motion.path,
        plan.validation,
        plan.limits,
        plan.noise,
        np.random.default_rng((plan.seed, number, 1)),
        highest=plan.highest,
        rate=plan.rate,
    )

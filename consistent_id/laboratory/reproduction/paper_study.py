"""A paper's study from end to end: what was printed, done again, and explained.

Exciting motions stand beside the paper's, equally long, in two ways that are fair.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from consistent_id._support.arrays import Array, Vector
from consistent_id._support.tables import brief
from consistent_id.errors import ProblemError
from consistent_id.estimation.method import Method
from consistent_id.excitation.design import design_trajectory
from consistent_id.excitation.designed import ExcitationDesign
from consistent_id.excitation.request import design_request
from consistent_id.laboratory.experiment import Laboratory
from consistent_id.laboratory.from_problem import (
    laboratory_of,
    laboratory_table,
    task_motion,
)
from consistent_id.laboratory.reproduction.budget import PrintedSpread, printed_spread
from consistent_id.laboratory.reproduction.error_analysis import (
    ErrorAnalysis,
    Verification,
    analyse_errors,
    mean_predictors,
    verification_motions,
    verify,
)
from consistent_id.laboratory.reproduction.experiments import (
    METHODS,
    InertiaTable,
    Reproduction,
    inertia_tables,
    perform_experiments,
)
from consistent_id.motion.limits import MotionLimits
from consistent_id.problems.problem import Problem
from consistent_id.problems.published import (
    PublishedReport,
    check_published,
    parametrisation_of,
    published_table,
)
from consistent_id.problems.task_tables import LaboratoryTable
from consistent_id.recordings.recording import Recording

_ENOUGH = 120.0  # s; searches end by themselves long before, and so are repeatable

TASKS = "the tasks"
WITHIN_USED = "exciting, within what the tasks used"
WITHIN_LIMITS = "exciting, within the robot's limits"
REPEATED = "one exciting motion, repeated"


@dataclass(frozen=True, slots=True, eq=False)
class ExcitingSet:
    """As many exciting motions as there were experiments.

    Parameters
    ----------
    designs : dict of str to ExcitationDesign
        By the experiment that each takes the place of.
    """

    name: str
    limits: MotionLimits
    designs: dict[str, ExcitationDesign]

    def motions(self, tasks: Mapping[str, Recording]) -> dict[str, Recording]:
        """Return the designs, sampled at the rates of the tasks they stand for."""
        return {
            name: design.trajectory.recording(tasks[name].rate, f"in place of {name}")
            for name, design in self.designs.items()
        }


@brief
@dataclass(frozen=True, slots=True)
class Extent:
    """The parts of a study that are done.

    Parameters
    ----------
    experiments : int, optional
        Number of the laboratory's experiments, the first ones; by default all.
    sets : tuple of str
        Sets of exciting motions.
    draws : int
        Number of draws of tasks, for the paper's assumptions.
    seeds : int
        Repetitions of the experiments with other noise.
    verification : int, optional
        Motions to verify with, the first ones; by default all.
    """

    experiments: int | None = None
    sets: tuple[str, ...] = (WITHIN_USED, WITHIN_LIMITS, REPEATED)
    draws: int = 12
    seeds: int = 3
    verification: int | None = None


FULL = Extent()
QUICK = Extent(2, sets=(WITHIN_LIMITS,), draws=1, seeds=0, verification=1)


@dataclass(frozen=True, slots=True, eq=False)
class ScatterPlaces:
    """Places of two parameters among those that the paper estimates.

    The paper's experiments scatter one most and the other least: an explanation must
    explain the first and must not contradict the second.
    """

    most_scattered: int
    least_scattered: int


@brief
@dataclass(frozen=True, slots=True, eq=False)
class PaperStudy:
    """A paper's study, reproduced.

    Parameters
    ----------
    inertial : ndarray, shape (10 links,)
        Inertial parameters of the laboratory's robot: physically consistent, nearest to
        the paper's mean.
    with_friction, without_friction : dict of str to Reproduction
        By what was moved along; without friction the tasks and the last set alone.
    other_noise : ndarray, shape (seeds, methods, combinations)
        Scatter along the tasks with other seeds.
    error_analysis : ErrorAnalysis
        Analysis of the errors along the tasks, with friction.
    inertia : tuple of InertiaTable
        Tables of the tasks, with friction.
    verification, verification_without_friction : Verification
        With and without friction.
    """

    problem: Problem
    extent: Extent
    report: PublishedReport
    inertial: Vector
    with_friction: dict[str, Reproduction]
    without_friction: dict[str, Reproduction]
    other_noise: Array
    sets: tuple[ExcitingSet, ...]
    error_analysis: ErrorAnalysis
    spread: PrintedSpread
    inertia: tuple[InertiaTable, ...]
    verification: Verification
    verification_without_friction: Verification
    place: ScatterPlaces

    @property
    def tasks(self) -> Reproduction:
        """The experiments along the paper's tasks, with friction."""
        return self.with_friction[TASKS]

    @property
    def certified(self) -> bool:
        """Whether every constrained estimate is."""
        return all(
            estimate.certificate.verdict == "certified"
            for reproductions in (self.with_friction, self.without_friction)
            for done in reproductions.values()
            for experiment in done.experiments
            for estimate in experiment.estimates
            if estimate.method in (Method.CONSTRAINED, Method.CONSTRAINED_WITH_FRICTION)
        )


def reproduce(
    problem: Problem,
    extent: Extent = FULL,
    *,
    seed: int = 0,
    progress: Callable[[str], None] = lambda step: None,
) -> PaperStudy:
    """Do a paper's study again.

    Parameters
    ----------
    problem : Problem
        With ``[published]``, ``[tasks]`` and ``[laboratory]``.
    extent : Extent
        `FULL`, `QUICK` or one of your own.
    seed : int
        Seed of designs and draws; the laboratory has its own.
    progress : callable
        Is called with each step's name before it begins.

    Raises
    ------
    ProblemError
        If one of these tables is missing or does not fit.
    """
    table = _require(problem, extent, seed)
    progress("the paper's tables")
    report, place = check_published(problem), place_of(problem)
    inertial = report.vectors[0].nearest.parameters
    motions = {
        name: task_motion(problem, name)
        for name in table.experiments[: extent.experiments]
    }
    progress("exciting motions")
    sets = exciting_sets(problem, motions, extent, seed=seed)
    along = {TASKS: motions} | {one.name: one.motions(motions) for one in sets}
    progress("experiments")
    with_friction = _performed(problem, inertial, along, along, friction=True)
    few = _without_friction(along)
    smooth = _performed(problem, inertial, along, few, friction=False)
    done = with_friction[TASKS]
    others = other_seeds(problem, inertial, motions, extent.seeds)
    progress("where errors come from")
    instead = {one.name: along[one.name] for one in sets if one.name != REPEATED}
    laboratory = laboratory_of(problem, inertial)
    error_analysis = analyse_errors(
        problem, laboratory, done, instead, draws=extent.draws, seed=seed
    )
    progress("verification")
    return PaperStudy(
        problem=problem,
        extent=extent,
        report=report,
        inertial=inertial,
        with_friction=with_friction,
        without_friction=smooth,
        other_noise=others,
        sets=sets,
        error_analysis=error_analysis,
        spread=printed_spread(problem, place.most_scattered),
        inertia=inertia_tables(problem, inertial, done),
        verification=_verified(problem, laboratory, with_friction, extent),
        verification_without_friction=_verified(
            problem, laboratory.without_friction(), smooth, extent
        ),
        place=place,
    )


def _without_friction(along: Iterable[str]) -> Iterable[str]:
    """Return the motions that are also done without friction: tasks, and the last."""
    *_, last = (name for name in along if name != REPEATED)
    return dict.fromkeys((TASKS, last))


def _performed(
    problem: Problem,
    inertial: Vector,
    along: Mapping[str, Mapping[str, Recording]],
    names: Iterable[str],
    *,
    friction: bool,
) -> dict[str, Reproduction]:
    """Perform experiments along some sets of motions."""
    return {
        name: perform_experiments(problem, inertial, along[name], friction=friction)
        for name in names
    }


def _require(problem: Problem, extent: Extent, seed: int) -> LaboratoryTable:
    """Refuse what cannot be done, before an hour's work for it."""
    table = laboratory_table(problem)
    if seed < 0:
        raise ProblemError(f"seed is {seed}, expected 0 or more")
    if len(table.experiments[: extent.experiments]) < 2:
        raise ProblemError("[laboratory] experiments: one has no scatter; name two")
    verification_motions(problem)
    return table


def _verified(
    problem: Problem,
    laboratory: Laboratory,
    reproductions: Mapping[str, Reproduction],
    extent: Extent,
) -> Verification:
    unseen = list(verification_motions(problem).items())[: extent.verification]
    return verify(
        problem,
        laboratory,
        dict(unseen),
        [
            p
            for name, done in reproductions.items()
            for p in mean_predictors(name, done)
        ],
        seed=laboratory_table(problem).seed + 1,
    )


def exciting_sets(
    problem: Problem,
    motions: Mapping[str, Recording],
    extent: Extent,
    *,
    seed: int = 0,
) -> tuple[ExcitingSet, ...]:
    """Return the sets of exciting motions of an extent."""
    limits = design_request(problem).limits
    sets = []
    if WITHIN_USED in extent.sets:
        used = used_by(limits, motions)
        sets.append(exciting_set(problem, WITHIN_USED, motions, used, seed=seed))
    if WITHIN_LIMITS in extent.sets or REPEATED in extent.sets:
        sets.append(exciting_set(problem, WITHIN_LIMITS, motions, limits, seed=seed))
    if REPEATED in extent.sets:
        first = next(iter(sets[-1].designs.values()))
        same = dict.fromkeys(sets[-1].designs, first)
        sets.append(replace(sets[-1], name=REPEATED, designs=same))
    return tuple(sets)


def other_seeds(
    problem: Problem,
    inertial: Array,
    motions: Mapping[str, Recording],
    count: int,
) -> Array:
    """Return the scatter of each method with other noise, (seeds, methods, names)."""
    seed = laboratory_table(problem).seed
    rows = []
    for k in range(1, count + 1):
        done = perform_experiments(problem, inertial, motions, seed=seed + 1000 * k)
        rows.append([done.scatter(table) for table in done.tables])
    shape = (count, METHODS, len(parametrisation_of(problem)))
    return np.array(rows).reshape(shape)


def place_of(problem: Problem) -> ScatterPlaces:
    """Return which parameters a paper's experiments scatter most and least."""
    published, mine = published_table(problem), parametrisation_of(problem)
    free = mine.others(published.fixed)
    scatter = np.array(published.experiments).std(axis=0, ddof=1)[free]
    return ScatterPlaces(free[int(scatter.argmax())], free[int(scatter.argmin())])


def used_by(limits: MotionLimits, motions: Mapping[str, Recording]) -> MotionLimits:
    """Return limits that contain the range, speed and acceleration of some motions."""
    own = [motion.of(limits.joints) for motion in motions.values()]
    return replace(
        limits,
        lower=np.stack([m.position.min(axis=0) for m in own]).min(axis=0),
        upper=np.stack([m.position.max(axis=0) for m in own]).max(axis=0),
        velocity=np.max([abs(_known(m.velocity)).max(axis=0) for m in own], axis=0),
        acceleration=np.max(
            [abs(_known(m.acceleration)).max(axis=0) for m in own], axis=0
        ),
    )


def exciting_set(
    problem: Problem,
    name: str,
    motions: Mapping[str, Recording],
    limits: MotionLimits | None = None,
    *,
    seed: int = 0,
) -> ExcitingSet:
    """Design a motion in place of each experiment, of the same duration.

    Each from a random start of its own; frequencies reach as high as the problem's
    ``[excitation]`` table asks, whatever the duration.

    Parameters
    ----------
    motions : mapping of str to Recording
        By experiment.
    limits : MotionLimits, optional
        By default those of the ``[excitation]`` table.
    seed : int
        Seed of the first one; the others count up.
    """
    request = design_request(problem)
    limits = request.limits if limits is None else limits
    designs = {}
    for k, (experiment, motion) in enumerate(motions.items()):
        duration = float(motion.time[-1] - motion.time[0])
        share = duration / request.form.duration
        form = replace(
            request.form,
            duration=duration,
            harmonics=int(np.ceil(round(request.form.harmonics * share, 6))),
        )
        design = design_trajectory(
            problem.model,
            form,
            request.aim,
            limits=limits,
            starts=1,
            workers=1,
            time_limit=_ENOUGH,
            seed=seed + k,
        )
        if design.interrupted:
            raise KeyboardInterrupt  # a study of paths that are not done says nothing
        designs[experiment] = design
    return ExcitingSet(name, limits, designs)


def _known(values: np.ndarray | None) -> np.ndarray:
    return np.zeros((1, 1)) if values is None else values

"""From a problem to motions that are ready to play, each proven as a whole.

A problem states the moving robot and its measurements: joint torque or a sensor's
wrench.  A validation motion has no frequency in common with the training motion: its
frequencies lie half-way between those of the design.  It is the best conditioned of
some random paths, and proven to keep all limits.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from consistent_id._support.arrays import Vector
from consistent_id._support.executors import Executor, single_threaded
from consistent_id._support.given_values import require_type
from consistent_id._support.tables import brief
from consistent_id.errors import InfeasibleError, ProblemError
from consistent_id.excitation.accuracy import predicted_accuracy
from consistent_id.excitation.aims import Aim
from consistent_id.excitation.basis import FourierBasis, limit_rows
from consistent_id.excitation.clear_poses import PathLimits, clear_start
from consistent_id.excitation.design import design_trajectory
from consistent_id.excitation.designed import ExcitationDesign
from consistent_id.excitation.proven_moves import Playing, ProvenMove, proven_move
from consistent_id.excitation.request import DesignRequest, design_request
from consistent_id.excitation.verification import Demands, PathProof
from consistent_id.excitation.work import Meter
from consistent_id.motion.moves import Move, move_along
from consistent_id.problems.problem import Problem
from consistent_id.problems.robot_preparation import drift_of, regression_of
from consistent_id.recordings.joint_paths import FourierTrajectory
from consistent_id.regression.base import base_parameters, require_same_model
from consistent_id.regression.regression import Regression
from consistent_id.regression.regressor import TorqueModel
from consistent_id.regression.residual_noise import joint_noise
from consistent_id.regression.rows.sensor_rows import SensorRows
from consistent_id.robot.inertia import InertialParameters
from consistent_id.robot.kinematics import frame_in_link
from consistent_id.robot.model import RobotModel

_REACH = 0.95  # share of the limits that a path may use
_SWINGS = (1.0, 0.85, 0.65, 0.4, 0.2)  # shares of its amplitude, tried in this order
_MOST_IN_SCENE = 6  # random paths to choose from in a scene: each takes long
_OF_ONE_SWING = 2  # proven paths; if none can be played, slower ones may
_MEASURED = 8  # times for each joint, at most, that a random path's guards are measured
_DRAWING = 90.0  # units of work, at most, for random paths; the first has no limit
_ENLARGING = 4.0  # of it, after which they are not enlarged any more
_POSES = 16  # poses of the design about which they may swing
_GRID = 8  # samples per period of the highest frequency, at which guards measure


@brief
@dataclass(frozen=True, slots=True, eq=False)
class ValidationPath:
    """A motion to validate estimates on.

    Parameters
    ----------
    trajectory : FourierTrajectory
    proof : PathProof
        Proof of the same limits as the design's.
    likeness : ndarray, shape (joints,)
        Correlation of each joint's velocity with the design's, over its duration.
    """

    trajectory: FourierTrajectory
    proof: PathProof
    likeness: Vector


@single_threaded
def validation_trajectory(
    design: ExcitationDesign, *, seed: int = 0, candidates: int = 24
) -> ValidationPath:
    """Return the best conditioned of some random paths that share no frequency.

    Parameters
    ----------
    design : ExcitationDesign
    seed : int
    candidates : int
        Random paths to choose from; in a scene at most six, and fewer of a robot
        with so many joints and pairs of bodies that each takes long.

    Raises
    ------
    InfeasibleError
        If none of them is proven to keep the limits, even at a fifth of them.
    """
    require_type(design, ExcitationDesign, "design")
    for found in _validation_paths(design, seed, candidates):
        return found
    raise _none_proven()


def _none_proven() -> InfeasibleError:
    return InfeasibleError(
        "no random path, even at a fifth of the limits, is proven to keep them all; "
        "widen the limits"
    )


def _validation_paths(
    design: ExcitationDesign, seed: int, candidates: int = 24
) -> Iterator[ValidationPath]:
    """Yield random paths that are proven, those that use most of the limits first."""
    form = replace(design.form, between=not design.form.between)
    basis = FourierBasis(
        design.limits, form.frequencies, form.duration, form.rest, form.smooth
    )
    shape = (basis.size, len(basis.unit))
    rows = limit_rows(basis, basis.trajectory(np.zeros(shape)).period)
    rng = np.random.default_rng(seed)
    drawn = [rng.normal(size=shape) for _ in range(candidates)]
    for variables in drawn:
        variables[0] = rng.uniform(-0.3, 0.3, shape[1])
    guards = design.demands.guards
    count = int(np.ceil(_GRID * form.frequencies[-1] * form.duration))
    time = np.linspace(0.0, form.duration, count + 1)
    if any(guard.keeps_apart for guard in guards):
        drawn = drawn[:_MOST_IN_SCENE]
    work = _MEASURED * shape[1] * len(time) * sum(guard.seconds for guard in guards)
    drawn = drawn[: max(int(_DRAWING / max(work, 1e-9)), 1)]
    known = design.trajectory  # keeps all limits: its poses are clear
    when = known.start + known.duration * rng.uniform(size=_POSES)
    limits = PathLimits(
        basis, rows, guards, time, poses=known.evaluate(when, derivatives=0)[0]
    )
    drawn = [
        clear_start(
            v * (_REACH / rows.largest(v)),
            replace(limits, meter=Meter(_ENLARGING / len(drawn))),
            rng,
        )
        for v in drawn
    ]
    for share in _SWINGS:
        paths = [basis.trajectory(np.vstack([v[:1], share * v[1:]])) for v in drawn]
        conditions = [
            predicted_accuracy(
                design.measured, design.base, path, design.aim
            ).condition.value
            for path in paths
        ]
        order = np.argsort(conditions, kind="stable")
        proofs = ((paths[i], design.demands.proof(paths[i])) for i in order)
        proven = ((path, proof) for path, proof in proofs if proof.holds)
        for path, proof in islice(proven, _OF_ONE_SWING):
            yield ValidationPath(path, proof, _likeness(path, design.trajectory))


def _likeness(one: FourierTrajectory, other: FourierTrajectory) -> Vector:
    duration = min(one.duration, other.duration)
    time = np.linspace(0.0, duration, 2001)
    a, b = (path.evaluate(path.start + time, 1)[1] for path in (one, other))
    return np.asarray(
        (a * b).sum(axis=0) / np.sqrt((a**2).sum(axis=0) * (b**2).sum(axis=0))
    )


TRAINING, VALIDATION = "trajectory", "validation"


@dataclass(frozen=True, slots=True, eq=False)
class PlayableDesign:
    """A design and a validation path, and the moves that play them.

    Parameters
    ----------
    design : ExcitationDesign
    validation : ValidationPath, optional
    moves : mapping of str to Move
        From rest to rest: ``"trajectory"``, ``"validation"``, or those of them that can
        be played within the limits; `refusals` give the reasons for missing ones.
    proofs : mapping of str to PathProof
        Proofs of each of the moves, over its whole duration.
    refusals : tuple of str
    notes : tuple of str
        Notes on the default scene, and on run-ins and run-outs that are not straight.
    """

    design: ExcitationDesign
    validation: ValidationPath | None
    moves: Mapping[str, Move]
    proofs: Mapping[str, PathProof]
    refusals: tuple[str, ...]
    notes: tuple[str, ...] = ()


class MeasuredBodies(NamedTuple):
    """The moving bodies, and the measured ones.

    Attributes
    ----------
    torque : TorqueModel
        Torque model of the joints.
    sensor : SensorRows, optional
        The sensor, if its tool is identified.
    parameters : array_like, optional
        Parameters to predict torque with; see `design_trajectory`.
    notes : tuple of str
    """

    torque: TorqueModel
    sensor: SensorRows | None
    parameters: ArrayLike | None
    notes: tuple[str, ...]


def playable_design(
    problem: Problem,
    *,
    parameters: ArrayLike | None = None,
    starts: int = 4,
    time_limit: float = 10.0,
    seed: int = 0,
    workers: int | None = None,
    executor: str | Executor | None = None,
    sequential: bool = False,
    earlier: Sequence[Regression] = (),
    progress: bool = False,
) -> PlayableDesign:
    """Design the motions that a problem's ``[excitation]`` table requests.

    Parameters
    ----------
    problem : Problem
    parameters, starts, time_limit, seed, workers, executor, progress
        See `design_trajectory`.
    sequential : bool
        Include the information of the problem's training recordings; if the table gives
        no noise, theirs is used.
    earlier : sequence of Regression
        Regressions of other recordings, such as those of `save_regression`, included in
        the same way.

    Raises
    ------
    ProblemError, InfeasibleError
        As `design_trajectory`.  Failures after the search, such as a run-in that cannot
        keep the limits, do not discard the design: they are among the refusals.
    """
    request, moved = design_request(problem), what_moves(problem, parameters)
    known = [*earlier, *([_training(problem)] if sequential else [])]
    aim = _with_recordings(problem, request.aim, known) if known else request.aim
    design = design_trajectory(
        moved.torque,
        request.forms,
        aim,
        limits=request.limits,
        parameters=moved.parameters,
        scene=request.scene,
        sensor=moved.sensor,
        friction_share=request.friction_share,
        stated=request.stated,
        starts=starts,
        time_limit=time_limit,
        seed=seed,
        workers=workers,
        executor=executor,
        progress=progress,
    )
    return _with_moves(design, request, seed, (*request.notes, *moved.notes))


def _with_moves(
    design: ExcitationDesign, request: DesignRequest, seed: int, notes: tuple[str, ...]
) -> PlayableDesign:
    """Return a design with the moves that play it and a validation path."""
    played: dict[str, ProvenMove] = {}
    refusals: list[str] = []
    validation = None
    try:
        played[TRAINING] = _played(
            design, request, design.trajectory, design.proof, request.periods
        )
    except (InfeasibleError, ProblemError) as cause:
        refusals.append(f"the trajectory cannot be played: {cause}")
    try:
        # Where the training motion cannot be played, others hardly can.
        most = None if TRAINING in played else 1
        validation, played[VALIDATION] = _validation(design, request, seed, most)
    except (InfeasibleError, ProblemError) as cause:
        refusals.append(f"there is no validation motion: {cause}")
    of_moves = [f"{name}: {one.note}" for name, one in played.items() if one.note]
    return PlayableDesign(
        design,
        validation,
        moves={name: one.move for name, one in played.items()},
        proofs={name: one.proof for name, one in played.items()},
        refusals=tuple(refusals),
        notes=(*notes, *of_moves),
    )


def _validation(
    design: ExcitationDesign, request: DesignRequest, seed: int, most: int | None
) -> tuple[ValidationPath, ProvenMove]:
    """Return the first of at most so many paths that can be played, and its move."""
    first: Exception | None = None
    for path in islice(_validation_paths(design, seed), most):
        try:
            return path, _played(design, request, path.trajectory, path.proof)
        except (InfeasibleError, ProblemError) as cause:
            first = first or cause
    raise first or _none_proven()


def _played(
    design: ExcitationDesign,
    request: DesignRequest,
    path: FourierTrajectory,
    proof: PathProof,
    periods: int | None = None,
) -> ProvenMove:
    """Return the move that plays a path; if there is none, advise on the start pose."""
    try:
        return proven_move(
            path,
            proof,
            design.demands,
            Playing(request.start_pose, periods, design.form.smooth),
            seed=design.seed,
        )
    except InfeasibleError as cause:
        advice = _advice(path, design.demands, request)
        raise InfeasibleError(f"{cause}. {advice}") from None


def _advice(path: FourierTrajectory, demands: Demands, request: DesignRequest) -> str:
    """Return advice on the start pose if run-in or run-out fails."""
    if request.start_pose is None:
        return "Give a start_pose in [excitation]"
    other = "Give another start_pose in [excitation]"
    move = move_along(path, demands.limits)
    pieces = [*move.run_in, *move.run_out]
    if pieces and not demands.proof(pieces).holds:
        return other
    pose = zip(move.joints, move.evaluate([move.start], 0)[0, 0], strict=True)
    start = ", ".join(f"{joint} = {q:.3f}" for joint, q in pose)
    return f"{other}, or none: this path can be reached from {start}"


def _training(problem: Problem) -> Regression:
    if problem.table.data is None:
        raise ProblemError(
            f"problem {problem.name!r} has no earlier recordings; leave out "
            f"sequential, or add a [data] table"
        )
    return regression_of(problem.table, problem.model, problem.training)


def _with_recordings(problem: Problem, aim: Aim, known: Sequence[Regression]) -> Aim:
    """Return the aim with recordings' information, and their noise by default."""
    if drift_of(problem.table) != "none":
        raise ProblemError(
            "[wrist_sensor] drift: the information of recordings without their "
            "biases cannot be included yet; leave out --sequential and --earlier"
        )
    model, noise = problem.model, aim.noise
    base = base_parameters(model)
    for regression in known:
        require_same_model(model, regression, base)
    if noise is None:
        alike = [one.weighted(np.ones(len(one.joints))) for one in known]
        noise = joint_noise(model, alike[0].joined(alike[1:]), base=base)
    return replace(aim, noise=noise, earlier=tuple(known))


def what_moves(problem: Problem, parameters: ArrayLike | None = None) -> MeasuredBodies:
    """Return the torque model and the sensor of a problem's motion.

    Parameters
    ----------
    problem : Problem
    parameters : array_like, shape (parameters,) or (members, parameters), optional
        Parameters of the problem's model.  Those of a tool load the arm; the heaviest
        of several is used.
    """
    table = problem.table.wrist_sensor
    if table is None or problem.arm is None:
        return MeasuredBodies(problem.model, None, parameters, ())
    # a bias that drifts is unknown in each recording, that of this motion included
    told = replace(problem.model, wrench_bias=table.bias)
    sensor = SensorRows(told, problem.arm, table.frame)
    tool = _tool(problem, parameters)
    if tool is None:
        name = problem.model.robot.link_names[0]
        note = (
            "torque limits: those of the arm without its tool, whose mass is unknown; "
            f"state [links.{name}] mass, or --parameters of an estimate"
        )
        return MeasuredBodies(TorqueModel(problem.arm), sensor, None, (note,))
    note = f"torque limits: the arm carries {tool.mass:.3g} kg at {table.frame}"
    loaded = with_load(problem.arm, table.frame, tool)
    return MeasuredBodies(TorqueModel(loaded), sensor, None, (note,))


def _tool(problem: Problem, parameters: ArrayLike | None) -> InertialParameters | None:
    """Return the tool of an estimate, or a point of the datasheet's largest mass."""
    if parameters is not None:
        every = np.atleast_2d(np.asarray(parameters, dtype=float))
        return InertialParameters(every[every[:, 0].argmax(), :10])
    sheet = problem.model.robot.links[0].datasheet
    mass = (sheet.mass_bounds or (0.0, None))[1] if sheet.mass is None else sheet.mass
    if mass is None or np.isinf(mass):
        return None
    com = np.zeros(3) if sheet.com is None else sheet.com
    return InertialParameters.from_central(mass, com, np.zeros((3, 3)))


def with_load(arm: RobotModel, frame: str, load: InertialParameters) -> RobotModel:
    """Return an arm one of whose links carries a load, given in a frame on it.

    Nothing changes if the link's own nominal body is unknown.
    """
    k, rotation, translation = frame_in_link(arm, frame, (0.0, 0.0, 0.0))
    link = arm.links[k]
    if link.nominal is None:
        return arm
    both = link.nominal + load.transformed(rotation, translation)
    links = list(arm.links)
    links[k] = replace(link, nominal=both)
    return replace(arm, links=tuple(links))

"""Output of a playable design: files, tables, record and figure.

The tables of a request are made before the search.
"""

from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from consistent_id._support.arrays import Vector
from consistent_id._support.files import (
    remove_when_written,
    require_writable,
    together,
    write_atomically,
    write_json,
)
from consistent_id._support.singular import singular_values
from consistent_id._support.tables import Table
from consistent_id.errors import InfeasibleError, ProblemError
from consistent_id.excitation.aims import PathForm, parameters_named
from consistent_id.excitation.design_record import (
    PROVEN,
    TO_PROVE,
    design_record,
    design_tables,
    kept_apart,
    kept_limits,
    limits_record,
)
from consistent_id.excitation.designed import PATH, SAMPLES, ExcitationDesign
from consistent_id.excitation.earlier_files import (
    CLIENT,
    RECORD,
    REPLAY,
    earlier_files,
)
from consistent_id.excitation.html_replay import ShapesFile, write_replay
from consistent_id.excitation.playable import (
    TRAINING,
    VALIDATION,
    MeasuredBodies,
    PlayableDesign,
    what_moves,
)
from consistent_id.excitation.request import DesignRequest, design_request
from consistent_id.excitation.search_problem import require_playable_form
from consistent_id.excitation.verification import Demands, demands
from consistent_id.motion.collisions.scene import Scene
from consistent_id.motion.files import follow, write_trajectory
from consistent_id.motion.files.document import require_names
from consistent_id.motion.files.robot_formats import (
    CYCLES,
    cycle_of,
    require_robot,
)
from consistent_id.motion.files.trajectory_file import FORMAT_OF_ENDING
from consistent_id.motion.limits import MotionLimits
from consistent_id.problems.problem import Problem
from consistent_id.report.plot import draw_figure
from consistent_id.robot.kinematics import link_places
from consistent_id.robot.model import RobotModel
from consistent_id.robot.parameters import did_you_mean

FORMATS = ("csv", "yaml")
"""Endings of the files of samples that are written by default."""

_BEFORE = "0.6"
PLAN = "consistent_id plan 1"
"""Format of `Plan.record`."""


def write_design(
    playable: PlayableDesign,
    folder: Path,
    formats: Sequence[str] = FORMATS,
    tolerance: float | None = None,
) -> list[Path]:
    """Write motions, figure and record into a folder; return the files.

    Files of an earlier design there that are not replaced are removed, see
    `earlier_files`.

    Parameters
    ----------
    playable : PlayableDesign
    folder : Path
    formats : sequence of str
        Endings of files of samples, such as ``csv``, ``yaml`` or ``script``, that
        `write_trajectory` knows; the exact motion is always written, as ``json``.
    tolerance : float, optional, [rad or m]
        Tolerance of ROS messages with few points, see `write_trajectory`.
    """
    require_writable(folder)
    earlier = earlier_files(playable.moves, folder, formats)
    written = []
    with together():
        for name, move in playable.moves.items():
            for ending in dict.fromkeys(("json", *formats)):
                file = folder / f"{name}.{ending}"
                rate = _rate_of(ending, playable.design.aim.rate)
                few = tolerance if FORMAT_OF_ENDING[f".{ending}"] == "ros" else None
                written.append(write_trajectory(move, file, rate=rate, tolerance=few))
        if "yaml" in formats:
            script = Path(follow.__file__).read_text(encoding="utf-8")
            written.append(write_atomically(folder / CLIENT, script))
        picture = folder / "excitation.png"
        written += draw_figure(lambda: design_figure(playable.design), picture)
        record = playable_record(playable)
        written.append(write_json(folder / RECORD, record))
        remove_when_written(earlier.removed)
    return written


def require_formats(formats: Sequence[str], robot: RobotModel) -> None:
    """Refuse formats that do not support a robot's joints, before any search.

    Parameters
    ----------
    formats : sequence of str
        Endings of files of samples; those of controllers support a certain number of
        joints only, all of which turn.
    robot : RobotModel
        The robot that moves.

    Raises
    ------
    ProblemError
        With the format and what it expects, or with a name that cannot be written.
    """
    for ending in formats:
        form = FORMAT_OF_ENDING[f".{ending}"]
        require_robot(form, robot, f"--format {ending}")
        require_names(robot.joint_names, Path(f"--format {ending}"))


def require_thinned(formats: Sequence[str], tolerance: float | None) -> None:
    """Refuse a tolerance of files with few points where none is written."""
    if tolerance is not None and "yaml" not in formats:
        raise ProblemError(
            f"--thin is for the yaml file, but the formats are {', '.join(formats)}; "
            "add yaml to --format, or leave --thin out"
        )


def require_places(folder: Path, formats: Sequence[str]) -> None:
    """Refuse a folder in which `write_design` cannot write."""
    motions = (TRAINING, VALIDATION)
    names = [f"{name}.{end}" for name in motions for end in ("json", *formats)]
    names += [CLIENT] * ("yaml" in formats)
    require_writable(folder, ["excitation.png", RECORD, *names])


def _rate_of(ending: str, rate: float) -> float:
    """Return the rate of a file's samples: controllers have their own."""
    form = FORMAT_OF_ENDING[f".{ending}"]
    if form not in CYCLES:
        return rate
    return cycle_of(form, rate) or CYCLES[form][0]


def checked_formats(text: str) -> tuple[str, ...]:
    """Return endings from a list with commas.

    Raises
    ------
    ProblemError
        If one is unknown; it is checked before the search.

    Examples
    --------
    >>> checked_formats("csv, script")
    ('csv', 'script')
    """
    endings = tuple(word.strip().lstrip(".") for word in text.split(","))
    for ending in endings:
        if f".{ending}" not in FORMAT_OF_ENDING:
            near = did_you_mean(ending, [e.lstrip(".") for e in FORMAT_OF_ENDING])
            raise ProblemError(f"format {ending!r} of a trajectory; {near}")
    return endings


def replay_design(problem: Problem, playable: PlayableDesign, folder: Path) -> Path:
    """Write a page that replays the training motion; return the file."""
    if TRAINING not in playable.moves:
        raise InfeasibleError(f"nothing to replay: {playable.refusals[0]}")
    model, scene = problem.table.model, problem.table.excitation.scene
    shapes = None
    if model.urdf is not None:
        packages = tuple(problem.file(name) for name in scene.packages) if scene else ()
        shapes = ShapesFile(problem.file(model.urdf), packages, model.locked)
    return write_replay(
        playable.moves[TRAINING],
        problem.moving,
        folder / REPLAY,
        shapes=shapes,
        scene=playable.design.demands.scene,
    )


class Plan(NamedTuple):
    """The outline of a design before its search.

    Parameters
    ----------
    tables : list of Table
        For people.
    record : dict
        The same as plain values.
    """

    tables: list[Table]
    record: dict[str, Any]


def planned(problem: Problem, parameters: ArrayLike | None = None) -> Plan:
    """Return the request of `playable_design`, without a search."""
    request = design_request(problem)
    parameters_named(problem.model.layout, request.aim.interest)
    moved = what_moves(problem, parameters)
    required = demands(
        moved.torque,
        request.limits,
        moved.parameters,
        request.scene,
        request.friction_share,
        request.stated,
    )
    for form in request.forms:
        require_playable_form(form, request.aim, required.limits)
    tables, form = request_tables(moved, request, required), request.form
    record = {
        "format": PLAN,
        "problem": problem.name,
        "robot": moved.torque.robot.name,
        "objectives": list(request.aim.objectives),
        "form": {
            "duration_s": form.duration,
            "frequencies_hz": [f.frequencies.tolist() for f in request.forms],
            "rest": form.rest,
            "smooth": form.smooth,
        },
        "periods": request.periods or 1,
        "start_pose": request.start_pose,
        "limits": limits_record(request.limits),
        "kept_apart": list(kept_apart(required.scene, TO_PROVE)),
        "notes": list(request.notes),
        "tables": [asdict(table) for table in tables],
    }
    return Plan(tables, record)


def playable_record(playable: PlayableDesign) -> dict[str, Any]:
    """Return a design and its moves as plain values."""
    record = design_record(playable.design, playable.validation, playable.proofs)
    record["played"] = {
        name: {
            "duration_s": move.duration,
            "proven": playable.proofs[name].holds,
            "least_margin": asdict(playable.proofs[name].margins.least),
        }
        for name, move in playable.moves.items()
    }
    record["notes_on_playing"] = list(playable.notes)
    record["refusals"] = list(playable.refusals)
    return record


def playable_tables(playable: PlayableDesign) -> list[Table]:
    """Return the same for people."""
    rows = tuple(_rows(playable))
    header = ("motion", "lasts", "least margin", "joint", "limit of")
    proven = _proven_words(playable.design.demands.scene)
    what = f"run-in and run-out included; {proven}"
    notes = (what, *playable.notes, *playable.refusals)
    found, *others = design_tables(playable.design, playable.proofs)
    return [found, Table("What is played", header, rows, notes), *others]


def _proven_words(scene: Scene | None) -> str:
    """Return what is proven of a motion in a scene, in words."""
    if scene is None:
        return f"limits {PROVEN}"
    of = "limits and clearances"
    if scene.unchecked:
        of = "limits, and clearances of the bodies that are checked,"
    left = len(scene.left_out)
    pairs = f"{left} pair{'s' if left > 1 else ''}"
    without = f", without the {pairs} left out above" if left else ""
    return f"{of} {PROVEN}{without}"


def _rows(playable: PlayableDesign) -> Iterator[tuple[str, ...]]:
    for name, move in playable.moves.items():
        least = playable.proofs[name].margins.least
        share = f"{100.0 * least.relative:.2f} %"
        yield name, f"{move.duration:.2f} s", share, least.joint, least.quantity


_COLLISIONS = "collisions: "  # not said twice in the row of this name


def request_tables(
    moved: MeasuredBodies, request: DesignRequest, required: Demands
) -> list[Table]:
    """Return form, aim, limits and demands of a requested path."""
    form, aim, robot = request.form, request.aim, moved.torque.robot
    rows = moved.torque if moved.sensor is None else moved.sensor
    tried = "; or ".join(_frequencies(one) for one in request.forms)
    bound = f", condition number up to {aim.growth:g} times the least"
    if aim.condition_at_most is not None:
        bound = f", condition number up to {aim.condition_at_most:g}"
    objectives = ", then ".join(aim.objectives) + bound * (len(aim.objectives) > 1)
    pose, times = request.start_pose, request.periods or 1
    apart = kept_apart(required.scene, TO_PROVE)
    lines = [
        ("collisions", "; ".join(apart).removeprefix(_COLLISIONS)),
        ("limits", kept_limits(required, TO_PROVE).removeprefix("limits of ")),
        ("duration", f"{form.duration:g} s"),
        ("frequencies", tried),
        ("ends", _ends(form)),
        ("played", "once" if times == 1 else f"{times} times"),
        ("start pose", "any" if pose is None else _pose(pose)),
        ("objective", objectives),
        *[("for", ", ".join(aim.interest))] * bool(aim.interest),
        *[("others", "known")] * (aim.others == "known"),
        ("column scaling", aim.scaling),
        ("noise", "by default" if aim.noise is None else "as given"),
        ("samples", f"{aim.rate:g} Hz"),
        ("parameters", f"{len(rows.layout)}, by {_measured(moved)}"),
    ]
    plan = Table(
        f"Exciting trajectory of {robot.name}: what would be designed",
        ("", "requested"),
        tuple(lines),
        (*required.notes, *request.notes, *moved.notes),
    )
    return [plan, limits_table(request.limits), *_scene(required)]


def _measured(moved: MeasuredBodies) -> str:
    if moved.sensor is None:
        return f"the torque of {len(moved.torque.torque_joints)} joints"
    return f"the wrench sensor at {moved.sensor.frame}"


def _frequencies(form: PathForm) -> str:
    """Return the frequencies of a form in words: harmonics of one, or all of them."""
    every = form.frequencies
    if np.allclose(every, every[0] * np.arange(1, len(every) + 1)):
        return f"{len(every)} harmonics of {every[0]:.4g} Hz"
    return ", ".join(f"{f:.4g}" for f in every) + " Hz"


def _ends(form: PathForm) -> str:
    if not form.rest:
        return "periodic"
    return "from rest to rest" + ", jerk continuous" * form.smooth


def limits_table(limits: MotionLimits) -> Table:
    """Return limits of motion and torque, joint by joint.

    Examples
    --------
    >>> from consistent_id import DHRow, from_modified_dh, motion_limits
    >>> from consistent_id.robot import JointLimits
    >>> arm = from_modified_dh("arm", [DHRow(0, 0, limits=JointLimits(-1, 2))])
    >>> print(limits_table(motion_limits(arm, velocity=1.0)).text())
    Limits
      joint   lower  upper  velocity  acceleration  jerk  effort
      joint1     -1      2         1           inf   inf     inf
      per joint in rad or m, s, and N m or N
    """
    names = ["lower", "upper", "velocity", "acceleration", "jerk", "effort"]
    over_time = ("effort_rate", "effort_rms")
    names += [n for n in over_time if np.isfinite(getattr(limits, n)).any()]
    values = [getattr(limits, name) for name in names]
    rows = tuple(
        (joint, *(f"{value[j]:.5g}" for value in values))
        for j, joint in enumerate(limits.joints)
    )
    note = "per joint in rad or m, s, and N m or N"
    return Table("Limits", ("joint", *names), rows, (note,))


def _scene(required: Demands) -> list[Table]:
    scene = required.scene
    if scene is None:
        return []
    rows = tuple(
        (*scene.names(pair), f"{pair.wanted * 1e3:.1f}") for pair in scene.pairs
    )
    header = ("one", "other", "by [mm]")
    return [Table("Bodies kept apart", header, rows, scene.remarks)]


def _pose(pose: dict[str, float]) -> str:
    return ", ".join(f"{joint} = {value:.4g}" for joint, value in pose.items())


def design_figure(design: ExcitationDesign, before: Vector | None = None) -> Any:
    """Return a Matplotlib figure of a design.

    Parameters
    ----------
    before : array_like, shape (base parameters,), optional
        Singular values of the base regressor to compare with; by default of the best
        random path that the search began with.
    """
    from matplotlib.figure import Figure

    joints = design.limits.joints
    height = 1.5 * len(joints) + 1.5
    figure = Figure(figsize=(13.0, height))
    title = f"{design.model.robot.name}: condition number {design.condition}"
    figure.suptitle("\n".join([title, *_clearance(design)]), y=1.0 - 0.1 / height)
    sides: Any = figure.subfigures(1, 2, width_ratios=(2.0, 1.0))
    left, right = sides
    axes = left.subplots(len(joints), 3, sharex=True, squeeze=False)
    design.plot(axes)
    # By hand: Matplotlib's own layout takes seconds for a dozen joints.
    below, above = 0.5 / height, 1.0 - 0.9 / height
    left.subplots_adjust(0.08, below, 0.98, above, wspace=0.28, hspace=0.18)
    upper, lower = right.subfigures(2, 1)
    _singular_values(upper, design, before)
    upper.subplots_adjust(0.15, 1.0 / height, 0.95, 1.0 - 1.8 / height)
    _tool_path(lower, design)
    lower.subplots_adjust(0.0, 0.05, 0.9, 0.95)
    return figure


def _clearance(design: ExcitationDesign) -> list[str]:
    report = design.proof.clearance
    if report is None or not report.first:
        return []
    scene = design.demands.scene
    how = "of checked bodies" if scene and scene.unchecked else PROVEN
    return [
        f"least clearance: {report.first} and {report.second} at {report.time:.2f} s, "
        f"{report.proven * 1e3:.1f} mm {how}"
    ]


def _singular_values(
    place: Any, design: ExcitationDesign, before: Vector | None
) -> None:
    axis = place.subplots()
    factor = design.unoptimised.factor
    earlier = singular_values(factor) if before is None else before
    number = np.arange(1, len(earlier) + 1)
    after = singular_values(design.accuracy.factor)
    axis.semilogy(
        number, earlier / earlier[0], ".-", color=_BEFORE, label="random path"
    )
    axis.semilogy(number, after / after[0], ".-", color=PATH, label="design")
    axis.set_title(
        "singular values of the base regressor, over the largest", fontsize=10
    )
    axis.set_xlabel("number")
    axis.grid(alpha=0.3)
    axis.legend(fontsize=8)


def _tool_path(place: Any, design: ExcitationDesign) -> None:
    axis = place.add_subplot(projection="3d")
    robot, path = design.model.robot, design.trajectory
    time = path.start + path.duration * np.linspace(0.0, 1.0, SAMPLES)
    tip = link_places(robot, path.evaluate(time)[0]).translation[:, -1]
    axis.plot(*tip.T, color=PATH, lw=1.0)
    axis.set_title(f"path of {robot.link_names[-1]} [m]", fontsize=10)
    axis.set_aspect("equal")
    axis.tick_params(labelsize=7)

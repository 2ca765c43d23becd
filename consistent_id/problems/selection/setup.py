"""The beginning of a search: rows, the plain model, scales of errors, moves to try."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import msgspec
import numpy as np

from consistent_id.errors import RecordingError
from consistent_id.problems.file import DriveTable
from consistent_id.problems.problem import Problem
from consistent_id.problems.selection.band import motion_cutoffs, thinning
from consistent_id.problems.selection.choice import (
    TERMS,
    Choice,
    Widths,
    data_of,
)
from consistent_id.problems.selection.evaluation import Evaluated, Evaluator, Setting
from consistent_id.problems.selection.forward_search import Scope
from consistent_id.problems.selection.samples import (
    NUMBERS,
    SampledLog,
    Samples,
    motion_period,
    velocity_scales,
)
from consistent_id.problems.selection.superset import (
    NOTHING,
    KeptLaws,
    loaded_joints,
    sloped_joints,
)
from consistent_id.problems.stated_model import DEFAULT_DRIVE
from consistent_id.recordings.recording import Recording
from consistent_id.recordings.signals.clocks import own_rate
from consistent_id.regression.base import base_parameters
from consistent_id.regression.drive.drive_terms import DEFAULTS
from consistent_id.regression.regressor import TorqueModel

DRIVE = (*TERMS, "asymmetric", "stribeck_velocity", "velocity_scale", "coupling")
"""Kinds of moves that change drive terms."""

KINDS = (*DRIVE, "masses", "motion_cutoff", "least_speed", "delay")
"""Kinds of settings that are chosen; each can be kept as in the file instead."""

_MOST_ROWS = 6000  # samples: more of them add little information, and cost time
_WIDTH = 0.03  # of the median top speed: where the search for friction's width begins
_ROUGH = 0.1  # of the torque: misfit that counts as one before the first fit


@dataclass(frozen=True, slots=True, eq=False)
class Beginning:
    """An evaluator, the evaluated plain model, and the scope of the search."""

    evaluator: Evaluator
    plain: Evaluated
    scope: Scope

    @property
    def parameters(self) -> int:
        """Number of parameters of the plain model: those of bodies and of drives."""
        setting = self.evaluator.setting
        known = setting.table.constraints.bodies == "model"
        return (0 if known else len(setting.base)) + len(self.plain.fits.candidate.keys)


def beginning(
    problem: Problem, raws: tuple[Recording, ...], fixed: Collection[str], band: float
) -> Beginning:
    """Prepare a search.

    Each joint's error is divided by its own error with the plain model, so that all
    joints have equal weight.

    Parameters
    ----------
    raws : tuple of Recording
        Training logs as they were recorded.
    fixed : collection of str
        See `KINDS`.
    band : float, [Hz]

    Raises
    ------
    RecordingError
        If there is too little motion, or a joint has no torque.
    """
    setting = _setting(problem, raws, band)
    cutoff = _cutoff(problem, fixed, band)
    evaluator = Evaluator(setting)
    samples = evaluator.samples(cutoff)
    _require_rows(samples, setting)
    _require_torque(samples, setting)
    widths = _widths(samples, setting.bodies)
    start = replace(
        _plain(problem, fixed, widths), motion_cutoff=cutoff, torque_cutoff=band
    )
    kept = set(DRIVE) & set(fixed)
    stated = KeptLaws(start.drive, start.couplings) if kept else NOTHING
    laws = _frictions(problem, start, samples, setting)
    evaluator = evaluator.with_friction(*laws, stated)
    torque = np.sqrt(np.mean(samples.torque**2, axis=0))
    rough = evaluator.rescaled(torque, _ROUGH * np.sqrt(samples.torque.size))
    errors = rough.evaluated(start).errors.squares.sum(axis=0) / len(NUMBERS)
    sigma = torque * np.sqrt(errors / len(samples.torque))
    evaluator = rough.rescaled(sigma, float(np.sqrt(samples.torque.size)))
    rate = min(own_rate(raw) for raw in raws)
    scope = Scope(
        fixed=frozenset(fixed) | _settled(problem),
        widths=tuple(each for each, _ in widths),
        cutoffs=motion_cutoffs(band, rate),
    )
    return Beginning(evaluator, evaluator.evaluated(start), scope)


def _setting(problem: Problem, raws: tuple[Recording, ...], band: float) -> Setting:
    data = data_of(problem.table)
    model = problem.model
    bodies = TorqueModel(model.robot, torque_joints=model.torque_joints)
    rate = min(own_rate(raw) for raw in raws)
    thin = thinning(band, rate)
    rows = sum(len(raw) for raw in raws) // thin
    return Setting(
        table=problem.table,
        preparation=data.preparation,
        folder=problem.folder,
        bodies=bodies,
        base=base_parameters(bodies),
        loaded=(),
        sloped=(),
        logs=tuple(SampledLog(raw, motion_period(raw)) for raw in raws),
        band=band,
        thin=thin * max(-(-rows // _MOST_ROWS), 1),
        sigma=np.ones(len(bodies.torque_joints)),
        size=1.0,
    )


def _frictions(
    problem: Problem, start: Choice, samples: Samples, setting: Setting
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the joints whose friction may depend on load, and those on position.

    If torque is computed from commands, the model is meant for simulators, which
    support friction that varies with position but not with the load.  If torque is
    measured, friction by position is not offered, because springs, loads and zero
    offsets vary with position, too.
    """
    if data_of(problem.table).gains is None:
        able = {"load_friction": loaded_joints(setting.bodies, samples)}
    else:
        able = {"friction_slope": sloped_joints(setting.bodies)}
    drives = dict(zip(setting.bodies.robot.joint_names, start.drive, strict=True))
    loaded, sloped = (
        tuple(
            name
            for name in setting.bodies.torque_joints
            if name in able.get(term, ()) or getattr(drives[name], term)
        )
        for term in ("load_friction", "friction_slope")
    )
    return loaded, sloped


def _cutoff(problem: Problem, fixed: Collection[str], band: float) -> float | None:
    preparation = data_of(problem.table).preparation
    if preparation.method != "butterworth":
        return None
    return preparation.motion_cutoff if "motion_cutoff" in fixed else band


def _settled(problem: Problem) -> frozenset[str]:
    """Return the kinds that cannot be chosen, or that the file states for a reason."""
    table = problem.table
    columns = data_of(problem.table).columns
    settled = set()
    if data_of(problem.table).preparation.method != "butterworth":
        settled.add("motion_cutoff")
    if columns is None or columns.torque is None:
        settled.add("delay")
    if table.constraints.masses == "bounds" or table.constraints.bodies == "model":
        settled.add("masses")
    return frozenset(settled)


def _masses_known(problem: Problem) -> bool:
    robot = problem.model.robot
    return any(link.datasheet.mass is not None for link in robot.links)


def _require_rows(samples: Samples, setting: Setting) -> None:
    rows, needed = samples.torque.size, 3 * len(setting.base)
    if rows < needed:
        raise RecordingError(
            f"{rows} rows of training data are left for choosing a model, expected "
            f"{needed} or more; record for longer"
        )


def _require_torque(samples: Samples, setting: Setting) -> None:
    joints = setting.bodies.torque_joints
    dead = np.flatnonzero(~samples.torque.any(axis=0))
    if len(dead):
        names = ", ".join(joints[j] for j in dead)
        raise RecordingError(f"the torque of {names} is zero in all training data")


def _widths(samples: Samples, bodies: TorqueModel) -> tuple[tuple[Widths, float], ...]:
    """Return widths of friction to try, and the first of them, by kind of joint.

    Turning and sliding joints have speeds in other units.  Joints of a kind that never
    move are taken to be of the other.
    """
    robot = bodies.robot
    measured = np.isin(robot.joint_names, bodies.torque_joints)
    slides = np.array([joint.kind == "prismatic" for joint in robot.driven])
    moving = measured & (samples.top_speeds > 0.0)
    kinds = [kind for kind in (~slides, slides) if (kind & moving).any()]
    if not kinds:
        raise RecordingError("no joint with torque ever moves in the training data")
    both = len(kinds) == 2
    found = []
    for kind in kinds:
        joints = np.flatnonzero(measured & kind if both else measured).tolist()
        speeds = samples.top_speeds[moving & kind]
        scales = velocity_scales(speeds)
        first = min(scales, key=lambda s: abs(np.log(s / (_WIDTH * np.median(speeds)))))
        which = " of sliding joints" if kind is slides else " of turning joints"
        names = tuple(robot.joint_names[j] for j in joints)
        own = Widths(tuple(joints), names, scales, which if both else "")
        found.append((own, first))
    return tuple(found)


def _plain(
    problem: Problem,
    fixed: Collection[str],
    widths: Sequence[tuple[Widths, float]],
) -> Choice:
    """Return the plain model; fixed settings are those of the file."""
    first = {name: width for each, width in widths for name in each.names}
    table = problem.table
    masses = table.constraints.masses
    if not _masses_known(problem):
        masses = "free"
    elif "masses" not in fixed and masses == "free":
        masses = "datasheet"
    preparation = data_of(table).preparation
    delay = preparation.delays.get("torque", 0.0) if "delay" in fixed else 0.0
    if delay == "estimated":  # a floating base, whose model is not selected
        delay = 0.0
    return Choice(
        tuple(
            _plain_drive(problem, name, fixed, first.get(name, widths[0][1]))
            for name in problem.model.robot.joint_names
        ),
        couplings=tuple(table.couplings) if "coupling" in fixed else (),
        masses=masses,
        least_speed=preparation.least_speed if "least_speed" in fixed else None,
        delay=float(delay),
    )


def _plain_drive(
    problem: Problem, name: str, fixed: Collection[str], width: float
) -> DriveTable:
    """Return a joint's drive in the plain model; without torque it has none."""
    if name not in problem.model.torque_joints:
        return DriveTable()
    table = problem.table
    joint = table.joints.get(name)
    own = table.drive if joint is None else joint.over(table.drive)
    kept = {key: getattr(own, key) for key in DRIVE if key in fixed and key in DEFAULTS}
    if kept.get("asymmetric"):
        kept["offset"] = False
    if "velocity_scale" in kept:
        kept["coulomb"] = own.coulomb
    if joint is not None and joint.motor_inertia is not None:
        kept["rotor_inertia"] = True
    if set(DRIVE) - {"velocity_scale", "coupling"} <= set(fixed):
        given = own.coulomb == "tanh" and "velocity_scale" not in fixed
        kept = {key: getattr(own, key) for key in DEFAULTS}
        kept |= {"velocity_scale": width} if given else {}
    geared = data_of(table).gains is not None  # drives that follow commands have gears
    plain = {"velocity_scale": width, "rotor_inertia": geared}
    return msgspec.structs.replace(DEFAULT_DRIVE, **(plain | kept))

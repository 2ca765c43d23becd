"""A design as plain values for JSON, and as tables and sentences for people.

Sentences say which limits a motion keeps, and what could not be checked.
"""

from collections import Counter
from collections.abc import Mapping
from itertools import compress
from typing import Any

import numpy as np

from consistent_id._support.singular import singular_values
from consistent_id._support.tables import Table, some_of
from consistent_id.excitation.designed import ExcitationDesign, Stage
from consistent_id.excitation.playable import ValidationPath
from consistent_id.excitation.used_limits import (
    largest_values,
    least_moved,
    longer_words,
    used_limits,
)
from consistent_id.excitation.verification import Demands, PathProof
from consistent_id.motion.collisions.bodies import HalfSpace
from consistent_id.motion.collisions.clearance import ClearanceReport
from consistent_id.motion.collisions.scene import NEIGHBOURS, Scene
from consistent_id.motion.limits import MotionLimits
from consistent_id.motion.proofs.margins import Margin
from consistent_id.regression.base import ConditionNumber

PROVEN = "proven for all times"
TO_PROVE = "to be proven for all times"
_STATED = ("velocity", "acceleration", "jerk", "effort")
_NAMED = 4  # of unchecked bodies or of obstacles, in one sentence


def clearance_words(scene: Scene) -> str:
    """Return what is "proven" of a scene's pairs, or only "checked"; and the others."""
    pairs = f"{len(scene.pairs)} pairs of bodies"
    if scene.unchecked:
        return f"{pairs} checked; others are not"
    return f"{pairs}: {PROVEN}{left_out_words(scene)}"


def left_out_words(scene: Scene) -> str:
    """Return which pairs are left out of a proof, and why."""
    words = []
    if (count := len(scene.adjacent)) > 0:
        names = tuple(" and ".join(pair) for pair in scene.adjacent)
        pairs = f"{count} pair{'s' if count > 1 else ''}"
        words.append(f"{pairs} of {NEIGHBOURS} ({some_of(names, _NAMED)})")
    allowed = tuple(f"{n.first} and {n.second}" for n in scene.notes if n.wanted)
    if allowed:
        pairs = f"{len(allowed)} pair{'s' if len(allowed) > 1 else ''}"
        words.append(f"{pairs} that may touch, as stated ({some_of(allowed, _NAMED)})")
    return f"; left out: {' and '.join(words)}" if words else ""


def kept_limits(demands: Demands, proven: str = PROVEN) -> str:
    """Return which limits of motion and torque are kept, and which are not stated.

    A limit that only some joints have is named with the joints that lack it.
    """
    limits = demands.limits
    has = {name: np.isfinite(getattr(limits, name)) for name in _STATED}
    unchecked = demands.parameters is None and has["effort"].any()
    if unchecked:
        del has["effort"]
    words = {name: name for name in _STATED} | {"effort": "torque"}
    kept = ", ".join(["position", *(words[n] for n, its in has.items() if its.any())])
    missing = [
        words[name]
        if not its.any()
        else f"{words[name]} ({some_of(tuple(compress(limits.joints, ~its)), _NAMED)})"
        for name, its in has.items()
        if not its.all()
    ]
    more = f"; no limit is stated for {', '.join(missing)}" if missing else ""
    first = "limits of torque: NOT CHECKED; " if unchecked else ""
    if demands.unweighed and not unchecked and has["effort"].any():
        kept = kept.replace(", torque", "")
        listed = some_of(demands.unweighed, _NAMED)
        first = f"limits of torque: NOT CHECKED with the weight of {listed}; "
    return f"{first}limits of {kept}: {proven}{more}"


def kept_apart(scene: Scene | None, proven: str = PROVEN) -> tuple[str, ...]:
    """Return what is proven of which bodies, what is left out, and what is unknown."""
    if scene is None:
        return ("collisions: NOT CHECKED",)
    found = [_distances(scene, proven)]
    if scene.unchecked:
        found.insert(
            0, f"NOT CHECKED for collisions: {some_of(scene.unchecked, _NAMED, '; ')}"
        )
    return tuple(found)


def _distances(scene: Scene, proven: str) -> str:
    if not scene.pairs:
        return "bodies: no two can come together"
    counts = Counter(pair.wanted for pair in scene.pairs)
    apart = []
    for wanted, count in sorted(counts.items(), reverse=True):
        pairs = f"{count} pair{'s' if count > 1 else ''}"
        if wanted == 0.0:
            close = (pair for pair in scene.pairs if pair.wanted == wanted)
            names = tuple(" and ".join(scene.names(pair)) for pair in close)
            why = _relaxed_words(scene)
            apart.append(f"{pairs} must not touch ({some_of(names, _NAMED)}{why})")
        else:
            verb = "stay" if count > 1 else "stays"
            apart.append(f"{pairs} {verb} {wanted * 1e3:.4g} mm apart")
    count = len(scene.pairs)
    which = f"{count} pairs that can come together" if count > 1 else "one pair"
    how = "checked" if scene.unchecked else proven
    return (
        f"bodies: {how} between {which}: {', '.join(apart)}{left_out_words(scene)}; "
        f"{_around(scene)}"
    )


def _relaxed_words(scene: Scene) -> str:
    """Return why some pairs must only not touch: they hardly can be farther apart."""
    relaxed = {frozenset((n.first, n.second)) for n in scene.notes if n.watched}
    count = sum(
        pair.wanted == 0.0 and frozenset(scene.names(pair)) in relaxed
        for pair in scene.pairs
    )
    if not count:
        return ""
    of = "" if count == sum(p.wanted == 0.0 for p in scene.pairs) else f" of {count}"
    return f"; the default clearance{of} is relaxed: few poses or none keep it"


def _around(scene: Scene) -> str:
    """Return the obstacles in words; a level floor with its height."""
    words = []
    for body in scene.bodies:
        if body.frame is not None:
            continue
        level = np.asarray(body.rotation)[2, 2] == 1.0
        if isinstance(body.shape, HalfSpace) and level and body.name == "ground":
            words.append(f"floor at {np.asarray(body.translation)[2]:g} m")
        else:
            words.append(body.name)
    if not words:
        return "no floor and no obstacle is known (--ground, [excitation.scene])"
    return f"around it: {some_of(words, _NAMED)}"


FORMAT = "consistent_id design 1"
_MOVES = {"trajectory": "whole_move", "validation": "validation_move"}
"""Names of the moves, and the keys of their clearances in a record."""


def design_record(
    design: ExcitationDesign,
    validation: ValidationPath | None = None,
    proofs: Mapping[str, PathProof] | None = None,
) -> dict[str, Any]:
    """Return a design as a complete record, for a file.

    Parameters
    ----------
    design : ExcitationDesign
    validation : ValidationPath, optional
    proofs : mapping of str to PathProof, optional
        Proofs of the whole moves, with run-in and run-out: ``"trajectory"``,
        ``"validation"``.
    """
    form = design.form
    return {
        "format": FORMAT,
        "robot": design.model.robot.name,
        "sensor": None if design.sensor is None else design.sensor.frame,
        "seed": design.seed,
        "starts": design.starts,
        "seconds": design.seconds,
        "notes": list(design.notes),
        "kept": list(kept_sentences(design)),
        "form": {
            "duration_s": form.duration,
            "frequencies_hz": form.frequencies.tolist(),
            "rest": form.rest,
            "smooth": form.smooth,
        },
        "aim": _aim(design),
        "limits": limits_record(design.limits),
        "largest": largest_values(design),
        "scene": _scene(design, proofs or {}),
        "before": _condition(design.unoptimised.condition),
        "forms_tried": [form.frequencies.tolist() for form in design.tried],
        "relative_accuracy": _relative(design),
        "stages": [_stage(stage) for stage in design.stages],
        "base_parameters": list(design.base.groupings),
        "validation": None
        if validation is None
        else {
            "trajectory": validation.trajectory.to_dict(),
            "margins": [_margin(m) for m in validation.proof.margins.margins],
            "clearance": _clearance(validation.proof.clearance),
            "velocity_correlation": validation.likeness.tolist(),
        },
    }


def _aim(design: ExcitationDesign) -> dict[str, Any]:
    aim = design.aim
    return {
        "objective": aim.objective,
        "refine": aim.objectives[1] if len(aim.objectives) == 2 else None,
        "interest": list(aim.interest),
        "others": aim.others,
        "growth": aim.growth,
        "condition_at_most": aim.condition_at_most,
        "column_scaling": aim.scaling,
        "noise": None
        if aim.noise is None
        else aim.noise_of(design.measured.torque_joints).tolist(),
        "noise_is_assumed": aim.assumed_noise,
        "rate_hz": aim.rate,
        "correlation_time_s": aim.correlation_time,
        "earlier_recordings": len(aim.recordings),
    }


def design_tables(
    design: ExcitationDesign, proofs: Mapping[str, PathProof] | None = None
) -> list[Table]:
    """Return a design as tables: its stages, its proof, its predicted accuracy.

    Parameters
    ----------
    design : ExcitationDesign
    proofs : mapping of str to PathProof, optional
        As `design_record`.
    """
    random = design.unoptimised
    rows = [("random path", "-", f"{random.condition.value:.4g}", "-")]
    rows += [
        (
            f"{stage.objective}, search {stage.number + 1}",
            f"{stage.value:.4g}",
            f"{stage.accuracy.condition.value:.4g}",
            f"{100.0 * stage.proof.margins.least.relative:.2f} %",
        )
        for stage in design.stages
    ]
    found = Table(
        f"Exciting trajectory of {design.model.robot.name}: "
        f"{design.form.duration:g} s, {len(design.form.frequencies)} frequencies",
        ("stage", "its objective", "condition number", "least margin"),
        tuple(rows),
        (
            *kept_sentences(design),
            f"condition number of {design.condition.basis}; column scaling: "
            f"{design.condition.scaling}",
            _searched(design),
            *([] if design.relative is None else [design.relative.note]),
            *longer_words(design),
            *design.notes,
        ),
    )
    return [
        found,
        *_clearances(design, proofs or {}),
        used_limits(design),
        design.accuracy.table(),
        design.proof.margins.table(),
    ]


def kept_sentences(design: ExcitationDesign) -> tuple[str, ...]:
    """Return sentences on a design's kept limits and the joint that moves least."""
    required = design.demands
    return (
        *kept_apart(required.scene),
        kept_limits(required),
        least_moved(design.trajectory, design.limits),
    )


def _searched(design: ExcitationDesign) -> str:
    """Return the extent of the search, in words."""
    starts = f"{design.starts} start" + "s" * (design.starts != 1)
    searched = f"{starts} from seed {design.seed}, {design.seconds:.1f} s"
    if len(design.tried) < 2:
        return searched
    counts = ", ".join(str(len(form.frequencies)) for form in design.tried)
    return f"{searched}; the most promising of {counts} numbers of frequencies"


def _clearances(
    design: ExcitationDesign, proofs: Mapping[str, PathProof]
) -> list[Table]:
    scene = design.demands.scene
    if scene is None:
        return []
    reports = [("trajectory", design.proof.clearance)]
    reports += [
        (_MOVES[name].replace("_", " "), p.clearance) for name, p in proofs.items()
    ]
    rows = tuple(
        (
            name,
            f"{report.first}, {report.second}",
            f"{report.time:.3f}",
            f"{report.distance * 1e3:.1f}",
            f"{report.wanted * 1e3:.1f}",
            f"{report.proven * 1e3:.1f}",
        )
        for name, report in reports
        if report is not None
    )
    notes = (
        clearance_words(scene),
        *scene.remarks,
    )
    header = (
        "motion",
        "least clearance between",
        "at [s]",
        "seen [mm]",
        "wanted",
        "bound" if scene.unchecked else "proven",
    )
    return [Table("Clearance", header, rows, notes)]


def _scene(
    design: ExcitationDesign, proofs: Mapping[str, PathProof]
) -> dict[str, Any] | None:
    scene = design.demands.scene
    if scene is None:
        return None
    return {
        "bodies": [body.name for body in scene.bodies],
        "pairs": [
            {"bodies": list(scene.names(pair)), "wanted_m": pair.wanted}
            for pair in scene.pairs
        ],
        "statement": list(kept_apart(scene)),
        "left_out": [
            {"bodies": [first, second], "why": why}
            for first, second, why in scene.left_out
        ],
        "notes": [str(note) for note in scene.notes],
        "dropped": [link for link, _ in scene.dropped],
        "unchecked": list(scene.unchecked),
        "swept": list(scene.swept),
    } | {_MOVES[name]: _clearance(proof.clearance) for name, proof in proofs.items()}


def _clearance(report: ClearanceReport | None) -> dict[str, Any] | None:
    if report is None or not report.first:
        return None
    return {
        "bodies": [report.first, report.second],
        "at_s": report.time,
        "distance_m": report.distance,
        "wanted_m": report.wanted,
        "proven_m": report.proven,
    }


def _relative(design: ExcitationDesign) -> dict[str, Any] | None:
    found = design.relative
    if found is None:
        return None
    return {
        "base_parameters_that_matter": list(found.matter),
        "within_5_percent": found.accurate,
        "unknown": found.unknown,
        "repetitions_for_5_percent": found.repetitions,
    }


def _stage(stage: Stage) -> dict[str, Any]:
    return {
        "objective": stage.objective,
        "value": stage.value,
        "search": stage.number + 1,
        "condition": _condition(stage.accuracy.condition),
        "singular_values": singular_values(stage.accuracy.factor).tolist(),
        "standard_errors": stage.accuracy.standard_errors().tolist(),
        "standard_errors_per_unit_noise": stage.accuracy.unit_noise,
        "margins": [_margin(m) for m in stage.proof.margins.margins],
        "clearance": _clearance(stage.proof.clearance),
        "proven": stage.proof.holds,
        "improved": stage.improved,
        "iterations": stage.iterations,
        "trajectory": stage.trajectory.to_dict(),
    }


def _condition(condition: ConditionNumber) -> dict[str, Any]:
    value = condition.value
    return {
        "value": value if np.isfinite(value) else None,
        "basis": condition.basis,
        "column_scaling": condition.scaling,
    }


def _margin(margin: Margin) -> dict[str, Any]:
    return {
        "joint": margin.joint,
        "quantity": margin.quantity,
        "limit": margin.limit,
        "proven": margin.bound,
        "at_s": margin.time,
        "margin": margin.margin,
    }


def limits_record(limits: MotionLimits) -> dict[str, Any]:
    """Return limits by name, in the order of the joints; None where there is none."""

    def finite(values: Any) -> list[float | None]:
        return [float(v) if np.isfinite(v) else None for v in values]

    return {
        "joints": list(limits.joints),
        "lower": finite(limits.lower),
        "upper": finite(limits.upper),
        "velocity": finite(limits.velocity),
        "acceleration": finite(limits.acceleration),
        "jerk": finite(limits.jerk),
        "effort": finite(limits.effort),
        "effort_rate": finite(limits.effort_rate),
        "effort_rms": finite(limits.effort_rms),
    }

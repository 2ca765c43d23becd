"""The computation of a verdict: evidence, gates, one rule for each kind of evidence.

Rules check whether the estimate explains the torque that it was fitted to, whether that
torque agrees with the nominal robot, how well the estimate predicts held-out torque,
whether a robot can have its parameters, which faults the recordings have, and whether
the optimum is proven.  The worst reason decides.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from consistent_id._support.arrays import BoolArray, Vector
from consistent_id.constraints.cones.certificate import OptimumVerdict
from consistent_id.constraints.links import LinkCondition
from consistent_id.constraints.robot_size import RobotSize
from consistent_id.estimation.fit import Fit
from consistent_id.estimation.torque_error import (
    AT_REST,
    IN_MOTION,
    TorqueError,
    stacked_beyond,
    stacked_error,
)
from consistent_id.estimation.verdict import Reason, Verdict, Word, percent, weighed
from consistent_id.recordings.recording import LogFinding
from consistent_id.regression.mass_matrix import POSES
from consistent_id.regression.residual_noise import WHITE

# Gates.  Of simulated logs without a fault (five robots with Stribeck and load friction
# that the model lacks), the misfit was 0.5-2.5 %, the excess over least squares
# 1.00-1.09, the held-out error 0.1-2.4 % and slopes 0.92-1.12; real arms with a model
# that was chosen for them have misfits of 3-6 % and held-out errors of 3-8 %, with a
# default model 3-14 % and 6-25 %.
MISFIT_CARE = 0.08

MISFIT_REFUSED = 0.5
JOINT_MISFIT_CARE = 0.30
EXCESS_CARE = 1.15
EXCESS_REFUSED = 2.0
NO_EXCESS = 0.005  # misfit below which the excess is ignored: noise of good sensors
HELD_OUT_CARE = 0.12
JOINT_HELD_OUT_CARE = 0.40
GENERALISATION_CARE = 3.0  # held-out error over misfit
LEAST_MISFIT = 0.02  # least misfit that the held-out error is compared with
NO_BETTER_THAN_ZERO = 1.0  # error of predicting zero torque
SPARE_CARE = 3.0  # effective samples per parameter; clean logs above have 11-40
GUESSED_CARE = 0.3  # clean logs: 0.00; rich ones of real arms: 0.03-0.15
FRICTIONLESS = 0.01  # share of drive terms in the torque; drives have 10-80 %
_ALIKE = 0.999  # errors that differ by less are printed with the same digits
_UNSEEN = "some parameters hardly affect the measured torque"

# Of simulated logs without a fault (see `judge`), slopes were 0.92-1.12.
SLOPE_CARE = (0.8, 1.25)

SLOPE_FAR = 3.0  # no designer's masses are so wrong
SLOPE_MISSING = 0.2  # below, the bodies' torque is not in the channel
EFFORT_CARE = 1.2  # peak torque over effort limit: limits are often rounded down
EXPLAINED = 0.3  # squared share of torque from which a slope is significant
EXPECTED = 0.1  # share of a joint's torque from which its slope is used
EXPECTED_MUCH = 0.3  # share that cannot be missing for lack of excitation
# Inertia about a joint over the most that bodies have within their sizes, and extent of
# a body over its size.  Of clean logs of real arms, up to 0.7 and 1.9, and 1.4 of a Z1
# whose torque is made of commands; of a UR10e whose clock runs at half speed, 2.4-2.9
# and 2.1-3.9.
INERTIA_CARE = 1.5
INERTIA_REFUSED = 2.0
EXTENT_CARE = 3.0
JOINT_MATTERS = 0.05  # torque over that of the strongest joint


@dataclass(frozen=True, slots=True, eq=False)
class Evidence:
    """The evidence for a verdict; unknown parts are None or empty.

    Parameters
    ----------
    method : str
    optimum : {"certified", "uncertified"}
    optimum_reason : str
    links : tuple of LinkCondition
    least_mass_eigenvalue : float, [kg m^2 or kg]
        Of the mass matrix over `POSES` random poses.
    fit : Fit, optional
    impossible : str
        Proof that no consistent robot has the base parameters, in words.
    contradicted : str
        How much worse than least squares the best consistent robot fits, in words, if
        the difference is significant.
    held_out : tuple of TorqueError
    findings : tuple of LogFinding
        Findings about the recordings.
    undetermined : tuple of str
        Combinations that the data do not determine.
    accepted : tuple of str
        Kinds of reasons to override.
    size : RobotSize, optional
        Extents of the bodies beside the robot's geometry.
    loose_trunk : tuple of str
        Mass and first moments of a floating base's body of which the data determine at
        most sums with other bodies; see `Estimate.loose_trunk`.
    """

    method: str
    optimum: OptimumVerdict
    optimum_reason: str
    links: tuple[LinkCondition, ...]
    least_mass_eigenvalue: float
    fit: Fit | None = None
    impossible: str = ""
    contradicted: str = ""
    held_out: tuple[TorqueError, ...] = ()
    findings: tuple[LogFinding, ...] = ()
    undetermined: tuple[str, ...] = ()
    accepted: tuple[str, ...] = ()
    loose_trunk: tuple[str, ...] = ()
    size: RobotSize | None = None


def judge(evidence: Evidence) -> Verdict:
    """Weigh all evidence: the worst reason that was not accepted decides.

    Parameters
    ----------
    evidence : Evidence
    """
    found = [reason for rule in RULES for reason in rule(evidence)]
    error = stacked_error(evidence.held_out)
    recordings = tuple(dict.fromkeys(each.recording for each in evidence.held_out))
    return weighed(evidence.method, found, evidence.accepted, error, recordings)


class _Found(NamedTuple):
    """Joints by the fault of their slopes; a joint is in one of the lists."""

    reversed_: list[int]
    missing: list[int]
    off: list[int]
    far: list[int]  # of those that are off
    alike: bool  # all significant slopes are off, as by one gain


def of_slopes(evidence: Evidence) -> Iterator[Reason]:
    """Compare the channel with the torque of the nominal bodies, joint by joint."""
    fit = evidence.fit
    if fit is None:
        return
    found = _found(fit)
    if found.reversed_:
        yield Reason(
            "torque sign",
            "do not use",
            "measured torque has the opposite sign of the nominal bodies': "
            f"{_slopes(fit, found.reversed_)}",
            "reverse the torque of these joints by a negative gain (--torque-gain), or "
            "their position, or their axes in the model; consistent-id check tries it",
        )
    if found.missing:
        yield Reason(
            "torque channel",
            "use with care",
            "the channel hardly contains the torque of the nominal bodies: "
            f"{_slopes(fit, found.missing)}",
            "check for compensated gravity, another quantity or another joint",
        )
    if found.off:
        # Two independent signs of a gain: masses, and effort limits of the drives.
        shown = found.alike and bool((fit.efforts[found.far] > EFFORT_CARE).any())
        yield Reason(
            "gain or unit" if found.alike else "nominal model",
            "do not use" if shown else "use with care",
            "measured over nominal torque: " + _slopes(fit, found.off),
            "check the unit and gain of torque, and the model's masses"
            if found.alike
            else "check these joints' gains, drive terms (rotor inertia) and bodies",
        )


def _found(fit: Fit) -> _Found:
    """Return the joints whose slopes are wrong.

    Friction at rest may change a slope by as much as `_held_slopes` returns.
    """
    held = _held_slopes(fit)
    least, most = fit.slopes - held, fit.slopes + held
    strong = fit.shares >= JOINT_MATTERS
    matters = strong & (fit.expected >= EXPECTED)
    # With a gain of 100, the nominal torque is a hundredth, but explains it all.
    scaled = strong & (abs(fit.slopes) * fit.expected >= EXPECTED_MUCH)
    means = (matters | scaled) & (fit.explained >= EXPLAINED)
    low, high = SLOPE_CARE
    reversed_ = means & (most < 0.0)
    missing = matters & (fit.expected >= EXPECTED_MUCH) & (most < SLOPE_MISSING)
    missing &= ~reversed_
    off = means & ((most < low) | (least > high)) & ~reversed_ & ~missing
    alike = bool(off.any()) and bool((off == means).all()) and _alike(fit.slopes[off])
    far = where(off & (least > SLOPE_FAR))
    return _Found(where(reversed_), where(missing), where(off), far, alike)


def _held_slopes(fit: Fit) -> Vector:
    """Return how much friction at rest can change each slope, either way.

    For a joint that mostly rests, the torque at rest is assumed to be as similar to the
    nominal bodies' torque as possible.  NaN where the limit of friction is not known:
    the slope is then not significant.
    """
    rests = fit.moving < IN_MOTION
    share = np.sqrt(np.where(rests, 1.0 - fit.moving, 0.0))
    nominal = np.maximum(fit.expected * fit.torque, np.finfo(float).tiny)
    with np.errstate(over="ignore"):  # bodies without torque: any change
        return np.where(rests, share * fit.holding / nominal, 0.0)


def _alike(slopes: Vector) -> bool:
    """Return whether slopes are off as by one gain.

    This is so if all are far off to the same side, or if the slopes of several joints
    differ by less than the gate.
    """
    far = slopes.min() > SLOPE_FAR or slopes.max() < 1.0 / SLOPE_FAR
    near = slopes.max() / slopes.min() < SLOPE_CARE[1] / SLOPE_CARE[0]
    return bool(far or (near and len(slopes) > 1))


def _slopes(fit: Fit, joints: Sequence[int]) -> str:
    return ", ".join(f"{fit.joints[j]} {fit.slopes[j]:.2f}" for j in joints)


def _of_findings(evidence: Evidence) -> Iterator[Reason]:
    for finding in evidence.findings:
        if finding.severity == "note":
            continue
        word: Word = "do not use" if finding.severity == "fault" else "use with care"
        where = ", ".join(w for w in (finding.recording, finding.where) if w)
        said = f"{where}: {finding.statement}"
        yield Reason(finding.kind, word, said, finding.advice)


def _of_fit(evidence: Evidence) -> Iterator[Reason]:
    fit = evidence.fit
    if fit is None:
        said = "the misfit of the estimate on its training data is not known"
        yield Reason("unknown fit", "use with care", said, "estimate it again")
        return
    kind, advice = (
        "misfit",
        "check units, signs, gains and columns (consistent-id check)",
    )
    matters = fit.shares >= JOINT_MATTERS
    misfits = np.where(matters, fit.misfits, 0.0)
    j = int(np.argmax(misfits))
    if fit.misfit > MISFIT_CARE:
        word: Word = "do not use" if fit.misfit > MISFIT_REFUSED else "use with care"
        said = f"training misfit of all joints: {percent(fit.misfit)} of their torque"
        yield Reason(kind, word, said, advice)
    elif misfits[j] > JOINT_MISFIT_CARE:
        joint, share = fit.joints[j], percent(misfits[j])
        said = f"training misfit of {joint}: {share} of its RMS torque"
        yield Reason(kind, "use with care", said, advice)
    if fit.excess > EXCESS_CARE and fit.misfit > NO_EXCESS:
        yield Reason(
            "contradiction",
            "do not use" if fit.excess > EXCESS_REFUSED else "use with care",
            f"the residual is {fit.excess:.2f} times that of least squares without "
            "constraints: data and constraints, or weights, contradict each other",
            "see the cost of each constraint; check masses, geometry, drive terms",
        )


def _of_held_out(evidence: Evidence) -> Iterator[Reason]:
    """Judge held-out errors beyond those that friction can balance at rest."""
    error, whole = stacked_beyond(evidence.held_out), stacked_error(evidence.held_out)
    if error is None or whole is None:
        return
    fit = evidence.fit
    rests = error < _ALIKE * whole
    beyond = " beyond friction at rest" if rests else ""
    measure = f"held-out error of all joints{beyond}: {percent(error)}"
    advice = "check the residuals of each joint; record a motion that covers the task"
    kind = "held-out error"
    joint, joint_error = _worst_joint(evidence)
    of_joint = (
        f"held-out error of {joint}{beyond}: {percent(joint_error)} of its RMS torque "
        "(the larger of training and held-out)"
    )
    if error >= NO_BETTER_THAN_ZERO:
        said = f"{measure}; predicting no torque is no worse"
        yield Reason(kind, "do not use", said, advice)
    elif joint_error >= NO_BETTER_THAN_ZERO:
        said = f"{of_joint}; predicting no torque is no worse"
        yield Reason(kind, "do not use", said, advice)
    elif error > HELD_OUT_CARE:
        said = f"{measure}; good models reach 2-8 %"
        yield Reason(kind, "use with care", said, advice)
    elif joint_error > JOINT_HELD_OUT_CARE:
        yield Reason(kind, "use with care", of_joint, advice)
    if fit is not None and error > GENERALISATION_CARE * max(fit.misfit, LEAST_MISFIT):
        yield Reason(
            "overfitting",
            "use with care",
            f"{measure}, but their training misfit is {percent(fit.misfit)}",
            "record more motion, or use fewer drive terms; see which parameters the "
            "data determine",
        )


def _worst_joint(evidence: Evidence) -> tuple[str, float]:
    """Return the joint with the largest held-out error, of the relevant joints.

    The error is relative to the larger of its torques in held-out and training data: a
    joint that rests while the others move has little held-out torque.
    """
    fit = evidence.fit
    if fit is None:
        return "", 0.0
    matters = fit.shares >= JOINT_MATTERS
    worst = np.zeros(len(fit.joints))
    for error in evidence.held_out:
        size = np.maximum(error.torque, fit.torque)
        worst = np.maximum(worst, np.where(matters, error.beyond / size, 0.0))
    j = int(np.argmax(worst))
    return fit.joints[j], float(worst[j])


def _of_bodies(evidence: Evidence) -> Iterator[Reason]:
    advice = "use a constrained estimate: all its links are physically consistent"
    if evidence.impossible:
        yield Reason("impossible robot", "do not use", evidence.impossible, advice)
    wrong = [link.link for link in evidence.links if not link.consistent]
    if wrong:
        said = f"not physically consistent: {_some(wrong)}"
        yield Reason("inconsistent bodies", "do not use", said, advice)
    empty = [k.link for k in evidence.links if k.consistent and k.massless]
    if empty:
        yield Reason(
            "vanishing mass",
            "do not use",
            f"estimated without mass: {_some(empty)}",
            "state masses of the datasheet ([constraints] masses), or mass bounds",
        )
    least = evidence.least_mass_eigenvalue
    if least <= 0.0 and not wrong:
        yield Reason(
            "mass matrix",
            "do not use",
            f"the mass matrix has an eigenvalue of {least:.2g} at one of {POSES} poses",
            "constrain rotor inertias not to be negative (NonNegativeDrive)",
        )


def _of_size(evidence: Evidence) -> Iterator[Reason]:
    """Hold the inertia about joints, and the bodies, against the robot's geometry."""
    size, fit = evidence.size, evidence.fit
    if size is None or fit is None:
        return
    strong = [fit.joints[j] for j in where(fit.shares >= JOINT_MATTERS)]
    advice = (
        "check the clock (a log at half speed shows four times the inertia), the gain "
        "of torque, and lengths and masses of the model"
    )
    matters = np.isin(size.joints, strong)
    heavy = where(matters & (size.inertia > INERTIA_CARE))
    if heavy:
        said = ", ".join(f"{size.joints[j]} {size.inertia[j]:.3g}" for j in heavy)
        worst = max(float(size.inertia[j]) for j in heavy)
        yield Reason(
            "robot's size",
            "do not use" if worst > INERTIA_REFUSED else "use with care",
            "inertia about joints, over the most that bodies of these masses and the "
            f"model's lengths have: {said}",
            advice,
        )
    moved = np.isin(size.carried_by, strong)
    for what, extent in (
        ("radius of gyration", size.radius),
        ("distance of the centre of mass from the joint", size.centre),
    ):
        wide = where(moved & (extent > EXTENT_CARE * size.size))
        if wide:
            k = max(wide, key=lambda i: float(extent[i] / size.size[i]))
            yield Reason(
                "robot's size",
                "use with care",
                f"{what} of {size.links[k]}: {extent[k]:.3g} m, but its lengths in the "
                f"model are at most {size.size[k]:.3g} m",
                advice,
            )


def _of_channel(evidence: Evidence) -> Iterator[Reason]:
    fit = evidence.fit
    if fit is None:
        return
    beyond = [j for j in where(fit.efforts > EFFORT_CARE)]
    if beyond:
        said = ", ".join(f"{fit.joints[j]} {fit.efforts[j]:.2g} times" for j in beyond)
        yield Reason(
            "effort limit",
            "use with care",
            f"torque exceeds the model's effort limit: {said}",
            "check the unit and gain of torque, or correct the limit",
        )
    if fit.drive_share < FRICTIONLESS:
        yield Reason(
            "no friction",
            "use with care",
            f"friction and drives are {percent(fit.drive_share)} of the torque: the "
            "channel may be compensated for friction",
            "check the channel; accept this for a robot simulated without friction",
        )


def _of_optimum(evidence: Evidence) -> Iterator[Reason]:
    if evidence.optimum != "certified":
        yield Reason(
            "optimum not proven",
            "use with care",
            evidence.optimum_reason,
            "compare with another method",
        )


def _of_noise(evidence: Evidence) -> Iterator[Reason]:
    """Count the independent samples, as residuals are correlated."""
    fit = evidence.fit
    if fit is None or not np.isfinite(fit.spare):
        return
    if fit.spare < SPARE_CARE:
        yield Reason(
            "few samples",
            "use with care",
            f"residuals are correlated over {fit.correlation:.0f} samples: there are "
            f"{fit.spare:.1f} independent samples for each parameter",
            "record for longer, or use fewer drive terms: standard errors are "
            "inaccurate",
        )
    elif fit.correlation > WHITE:
        yield Reason(
            "correlated residuals",
            "use",
            f"the residuals are correlated: {fit.correlation:.0f} samples carry the "
            "information of one; standard errors account for it",
        )


def _of_rest(evidence: Evidence) -> Iterator[Reason]:
    """Name the joints that hardly moved: their friction is not identifiable."""
    fit = evidence.fit
    resting = [] if fit is None else where(fit.moving < AT_REST)
    if fit is not None and resting:
        yield Reason(
            "joint at rest",
            "use with care",
            f"{_some([fit.joints[j] for j in resting])} hardly moved: friction and "
            "rotor inertia there are not identifiable, and friction may balance any "
            "torque up to breakaway",
            "move these joints too, or take them out of the model (locked)",
        )


def _of_guesses(evidence: Evidence) -> Iterator[Reason]:
    """Warn when predictions depend on parameters that the data do not determine."""
    fit = evidence.fit
    if fit is None or not fit.guessed > GUESSED_CARE:
        return
    count = len(evidence.undetermined)
    why = f"{count} combinations are not identifiable" if count else _UNSEEN
    yield Reason(
        "mostly guessed",
        "use with care",
        f"on other motions up to {percent(fit.guessed)} of one joint's torque, or of "
        f"the base's, comes from the prior, not from the data: {why}",
        "move all joints more, measure more rows, or state what is known (masses)",
    )


def _worth_knowing(evidence: Evidence) -> Iterator[Reason]:
    if evidence.undetermined:
        count = len(evidence.undetermined)
        said = (
            f"{count} combinations of base parameters: {_some(evidence.undetermined)}"
        )
        yield Reason("not identifiable", "use", said)
    if evidence.loose_trunk:
        yield Reason(
            "trunk",
            "use",
            "the data do not determine the body of the floating base, but only sums "
            f"of {_some(evidence.loose_trunk)} with other bodies, which the prior "
            "divides",
            "state bodies that are known (known_links), for example from a log of the "
            "robot hanging by its base",
        )
    if evidence.contradicted:
        # Missing friction terms are a sufficient cause: a third of clean logs have it.
        yield Reason("physical consistency", "use", evidence.contradicted)
    edges = [link.link for link in evidence.links if link.edge]
    if edges:
        yield Reason(
            "boundary",
            "use",
            f"on the boundary of physical consistency: {_some(edges)}; torque "
            "prediction stays valid, but single inertias of these links are unreliable",
        )


def where(mask: BoolArray) -> list[int]:
    """Return the indices of true entries."""
    return [int(j) for j in np.flatnonzero(mask)]


def _some(names: Sequence[str]) -> str:
    shown = ", ".join(names[:3])
    return shown if len(names) <= 3 else f"{shown} and {len(names) - 3} more"


Rule = Callable[[Evidence], Iterable[Reason]]


RULES: tuple[Rule, ...] = (
    of_slopes,
    _of_findings,
    _of_fit,
    _of_held_out,
    _of_bodies,
    _of_size,
    _of_channel,
    _of_optimum,
    _of_noise,
    _of_rest,
    _of_guesses,
    _worth_knowing,
)
"""Rules for the evidence.  Of several reasons with the same word, the first is the most
important: a cause comes before its effects.
"""

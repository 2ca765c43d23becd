"""The computation of a verdict: evidence, gates, one rule for each kind of evidence.

Rules check whether the estimate explains the torque that it was fitted to, whether that
torque agrees with the nominal robot, how well the estimate predicts held-out torque,
whether a robot can have its parameters, which faults the recordings have, and whether
the optimum is proven.  The worst reason decides.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np

from consistent_id._support.arrays import Vector
from consistent_id._support.tables import brief, some_of
from consistent_id.constraints.cones.certificate import OptimumVerdict
from consistent_id.constraints.delivered_bodies import LinkCondition, RobotSize
from consistent_id.estimation.body_reasons import (
    CONSTRAINED,
    body_reasons,
    size_reasons,
)
from consistent_id.estimation.drive_ratios import DriveRatios, drive_reasons
from consistent_id.estimation.fit import Fit
from consistent_id.estimation.method import Method
from consistent_id.estimation.slope_reasons import (
    JOINT_MATTERS,
    effort_reasons,
    slope_reasons,
    where,
)
from consistent_id.estimation.torque_error import (
    AT_REST,
    Slopes,
    TorqueError,
    stacked_beyond,
    stacked_error,
)
from consistent_id.estimation.verdict import (
    Reason,
    Verdict,
    Word,
    factor_of,
    percent,
    weighed,
)
from consistent_id.recordings.recording import LogFinding
from consistent_id.regression.mass_matrix import POSES
from consistent_id.regression.residual_noise import WHITE

# Gates.  In simulated logs without a fault (five robots with Stribeck and load friction
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
GUESSED_REFUSED = 0.5  # beside `small motion`; not beside `short`, as of a KUKA: 0.78
FRICTIONLESS = 0.01  # share of friction in the torque; drives have 10-80 %
_WORDS: dict[str, Word] = {
    "fault": "do not use",
    "warning": "use with care",
    "note": "use",
}
_SAID = ("hidden factor",)  # findings of which notes are told, too
_ALIKE = 0.999  # errors that differ by less are printed with the same digits
_UNSEEN = "some parameters hardly affect the measured torque"


@brief
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
        Least eigenvalue of the mass matrix over `POSES` random poses.
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
    crossed : Slopes, optional
        Slopes of doubtful joints, on bodies that the other joints determine; see
        `confirmed_slopes`.
    usual_efforts : Vector, optional
        Torque that 99 % of the samples do not exceed, over each joint's effort limit;
        see `usual_efforts`.
    drives : DriveRatios, optional
        Friction and rotor inertia over those of the robot's file.
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
    crossed: Slopes | None = None
    usual_efforts: Vector | None = None
    drives: DriveRatios | None = None


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


def _of_slopes(evidence: Evidence, *, of_faults: bool = False) -> Iterator[Reason]:
    """Compare the channel with the torque of the nominal bodies, joint by joint.

    Slopes of a kind, or of a factor, that a fault states follow it: it also says what
    mends the log.
    """
    faults = [f for f in evidence.findings if f.severity == "fault"]
    stated = {f.kind for f in faults}
    stated |= {factor_of(f, evidence.findings)[0] for f in faults} - {""}
    if evidence.fit is not None:
        for reason in slope_reasons(evidence.fit, evidence.crossed):
            if (not stated.isdisjoint((reason.kind, reason.factor))) == of_faults:
                yield reason


def _of_findings(evidence: Evidence) -> Iterator[Reason]:
    for finding in evidence.findings:
        if finding.severity == "note" and finding.kind not in _SAID:
            continue
        word: Word = _WORDS[finding.severity]
        places = dict.fromkeys((finding.recording, finding.where))
        where = ", ".join(place for place in places if place)
        said = f"{where}: {finding.statement.removeprefix(f'{finding.where}: ')}"
        held_out = {error.recording for error in evidence.held_out}
        learnt = finding.recording not in held_out
        if word == "use with care" and learnt and _mistimed(finding, evidence):
            word = "do not use"
            said += "; and the estimate leaves too much of the torque unexplained"
        factor, size = factor_of(finding, evidence.findings)
        yield Reason(finding.kind, word, said, finding.advice, factor, size)


def _mistimed(finding: LogFinding, evidence: Evidence) -> bool:
    """Return whether torque is late or held, and the log is not explained with it.

    A lag is inferred from a fit.  Bodies imitate it, as far as they stay consistent: so
    others have to explain the log better.  Where an estimate is refined by rollout,
    torque is computed from commands: rollouts show how late these act, and a fit of
    torque takes errors of friction for a lag.  That a torque is held shows in its
    samples; one in coarse steps has no size, and is not late.
    """
    fit = evidence.fit
    if fit is None or fit.misfit <= MISFIT_CARE:
        return False
    if finding.kind == "lag":
        timed = evidence.method == Method.REFINED_BY_ROLLOUT
        return not timed and fit.excess > EXCESS_CARE
    return finding.kind == "torque resolution" and bool(finding.size)


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
    # A weight of nominal bodies that left-out data ask for costs misfit by choice.
    chosen = evidence.method == Method.CROSS_VALIDATED and fit.misfit <= MISFIT_CARE
    if fit.excess > EXCESS_CARE and fit.misfit > NO_EXCESS:
        yield Reason(
            "contradiction",
            "do not use"
            if fit.excess > EXCESS_REFUSED and not chosen
            else "use with care",
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
    if evidence.impossible:
        said = evidence.impossible
        yield Reason("impossible robot", "do not use", said, CONSTRAINED)
    yield from body_reasons(evidence.links)
    wrong = any(not link.consistent for link in evidence.links)
    least = evidence.least_mass_eigenvalue
    if least <= 0.0 and not wrong:
        yield Reason(
            "mass matrix",
            "do not use",
            f"the mass matrix has an eigenvalue of {least:.2g} at one of {POSES} poses",
            "constrain rotor inertias not to be negative (NonNegativeDrive)",
        )


def _of_size(evidence: Evidence) -> Iterator[Reason]:
    """Compare the inertia about joints, and the bodies, with the robot's geometry."""
    size, fit = evidence.size, evidence.fit
    if size is not None and fit is not None:
        strong = [fit.joints[j] for j in where(fit.shares >= JOINT_MATTERS)]
        yield from size_reasons(size, strong)


def _of_drives(evidence: Evidence) -> Iterator[Reason]:
    """Compare friction and rotor inertia with those of the robot's file."""
    if evidence.drives is not None:
        yield from drive_reasons(evidence.drives)


def _of_channel(evidence: Evidence) -> Iterator[Reason]:
    fit = evidence.fit
    if fit is None:
        return
    yield from effort_reasons(fit, evidence.usual_efforts)
    if fit.friction_share < FRICTIONLESS:
        yield Reason(
            "no friction",
            "use with care",
            f"friction is {percent(fit.friction_share)} of the torque: the channel may "
            "be compensated for friction",
            "check the channel; accept this for a robot simulated without friction",
        )


def _of_optimum(evidence: Evidence) -> Iterator[Reason]:
    """Name an optimum that is open: a fault of the solver, or of a refinement's kind.

    A refinement begins at a certified fit, and is taken only if motion that it has not
    seen is predicted as well; that its error is not convex says nothing against it.
    """
    if evidence.optimum != "certified":
        refined = evidence.method == Method.REFINED_BY_ROLLOUT
        yield Reason(
            "optimum not proven",
            "use" if refined else "use with care",
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
            f"{some_of([fit.joints[j] for j in resting])} hardly moved: friction and "
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
    said = (
        f"on other motions up to {percent(fit.guessed)} of one joint's torque, or of "
        f"the base's, comes from the prior, not from the data: {why}"
    )
    if _prior_is_good(fit):
        typical = percent(float(np.max(fit.prior_errors)))
        yield Reason(
            "mostly guessed",
            "use",
            f"{said}; but the prior's bodies are those of the model, which agree with "
            "the log, and their usual errors change that torque by typically "
            f"{typical}",
        )
        return
    tiny = fit.guessed > GUESSED_REFUSED and _hardly_moved(evidence)
    if tiny:
        said = (
            f"held-out data of so small a motion say nothing about other motion; {said}"
        )
    yield Reason(
        "mostly guessed",
        "do not use" if tiny else "use with care",
        said,
        "move all joints more, measure more rows, or state what is known (masses)",
    )


def _hardly_moved(evidence: Evidence) -> bool:
    """Return whether the motion of a training recording was small."""
    held_out = {error.recording for error in evidence.held_out}
    small = {f.recording for f in evidence.findings if f.kind == "small motion"}
    return not small <= held_out


def _prior_is_good(fit: Fit) -> bool:
    """Return whether the prior's errors pass the gates of a misfit: of one, of all."""
    errors = fit.prior_errors
    if not np.isfinite(errors).all():
        return False
    together = np.linalg.norm(errors * fit.torque) / np.linalg.norm(fit.torque)
    return bool(errors.max() <= JOINT_MISFIT_CARE and together <= MISFIT_CARE)


def _worth_knowing(evidence: Evidence) -> Iterator[Reason]:
    if evidence.undetermined:
        count = len(evidence.undetermined)
        said = (
            f"{count} combinations of base parameters: {some_of(evidence.undetermined)}"
        )
        yield Reason("not identifiable", "use", said)
    if evidence.loose_trunk:
        yield Reason(
            "trunk",
            "use",
            "the data do not determine the body of the floating base, but only sums "
            f"of {some_of(evidence.loose_trunk)} with other bodies, which the prior "
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
            f"on the boundary of physical consistency: {some_of(edges)}; torque "
            "prediction stays valid, but single inertias of these links are unreliable",
        )


Rule = Callable[[Evidence], Iterable[Reason]]


RULES: tuple[Rule, ...] = (
    _of_slopes,
    _of_findings,
    partial(_of_slopes, of_faults=True),
    _of_fit,
    _of_held_out,
    _of_bodies,
    _of_size,
    _of_drives,
    _of_channel,
    _of_optimum,
    _of_noise,
    _of_rest,
    _of_guesses,
    _worth_knowing,
)
"""Rules for the evidence.  Among several reasons with the same word, the first is the
most important: a cause comes before its effects.
"""

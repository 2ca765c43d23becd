"""How a verdict is reached: gates, one rule for each kind of evidence, and their sum.

Rules ask whether the estimate explains the torque that it was fitted to, how well it
predicts torque held out, whether a robot could have its parameters, what was found in
the recordings, and whether the optimum is proven.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from consistent_id.estimation.evidence import Evidence
from consistent_id.estimation.judge_slopes import (
    EFFORT_CARE,
    JOINT_MATTERS,
    of_slopes,
    where,
)
from consistent_id.estimation.stiction import AT_REST
from consistent_id.estimation.torque_error import stacked_beyond, stacked_error
from consistent_id.estimation.verdict import WORDS, Reason, Verdict, Word, percent
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
NO_EXCESS = 0.005  # misfit below which no excess matters: noise of good sensors
HELD_OUT_CARE = 0.12
JOINT_HELD_OUT_CARE = 0.40
GENERALISATION_CARE = 3.0  # held-out error over misfit
LEAST_MISFIT = 0.02  # misfit that the held-out error is compared with at the least
NO_BETTER_THAN_ZERO = 1.0  # error of who predicts no torque at all
SPARE_CARE = 3.0  # effective samples per parameter; clean logs above have 11-40
GUESSED_CARE = 0.3  # clean logs: 0.00; rich ones of real arms: 0.03-0.15
FRICTIONLESS = 0.01  # share of drive terms in the torque; drives have 10-80 %

_UNSEEN = "the torque measured hardly shows some parameters"


def judge(evidence: Evidence) -> Verdict:
    """Weigh all evidence: the worst reason that was not accepted decides.

    Parameters
    ----------
    evidence : Evidence
    """
    found = [reason for rule in RULES for reason in rule(evidence)]
    reasons = [
        replace(r, word="use", statement=f"{r.statement} (accepted by the user)")
        if _overridden(r, evidence.accepted)
        else r
        for r in found
    ]
    reasons.sort(key=lambda r: -WORDS.index(r.word))
    word = reasons[0].word if reasons else "use"
    held_out = stacked_error(evidence.held_out)
    return Verdict(word, evidence.method, tuple(reasons), evidence.accepted, held_out)


def _overridden(reason: Reason, accepted: Sequence[str]) -> bool:
    return reason.word != "use" and reason.kind in accepted


def _of_findings(evidence: Evidence) -> Iterator[Reason]:
    for finding in evidence.findings:
        if finding.severity == "note":
            continue
        word: Word = "do not use" if finding.severity == "fault" else "use with care"
        where = ", ".join(w for w in (finding.recording, finding.where) if w)
        said = f"{where}: {finding.statement}"
        yield Reason(finding.kind, word, said, finding.advice)


def _of_bodies(evidence: Evidence) -> Iterator[Reason]:
    advice = "use a constrained estimate, which only robots that can exist compete for"
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
            f"{_some(empty)} came out without mass",
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


def _of_held_out(evidence: Evidence) -> Iterator[Reason]:
    """Judge what is predicted, but not what friction holds while a joint rests."""
    error = stacked_beyond(evidence.held_out)
    if error is None:
        return
    fit = evidence.fit
    advice = "see residuals joint by joint; record a motion that covers the task"
    kind = "held-out error"
    joint, joint_error = _worst_joint(evidence)
    if error >= NO_BETTER_THAN_ZERO:
        said = f"{percent(error)} of the torque held out: predicting none is no worse"
        yield Reason(kind, "do not use", said, advice)
    elif joint_error >= NO_BETTER_THAN_ZERO:
        said = f"{percent(joint_error)} of {joint}'s torque: none predicted is no worse"
        yield Reason(kind, "do not use", said, advice)
    elif error > HELD_OUT_CARE:
        said = f"{percent(error)} of the torque held out; good models reach 2-8 %"
        yield Reason(kind, "use with care", said, advice)
    elif joint_error > JOINT_HELD_OUT_CARE:
        said = f"{percent(joint_error)} of {joint}'s torque held out"
        yield Reason(kind, "use with care", said, advice)
    if fit is not None and error > GENERALISATION_CARE * max(fit.misfit, LEAST_MISFIT):
        yield Reason(
            "overfitting",
            "use with care",
            f"held-out error {percent(error)}, but {percent(fit.misfit)} on the "
            "training data",
            "record more motion, or fewer drive terms; see what the data determine",
        )


def _worst_joint(evidence: Evidence) -> tuple[str, float]:
    """Return the joint with the largest held-out error of those that matter.

    Relative to the larger of its torques, held out and in training: of a joint that
    rests while the others are tested, the torque is small and says little.
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


def _of_fit(evidence: Evidence) -> Iterator[Reason]:
    fit = evidence.fit
    if fit is None:
        said = "how well it explains the torque that it was fitted to is not known"
        yield Reason("unknown fit", "use with care", said, "estimate it anew")
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
        said = f"{percent(fit.misfit)} of the training torque stay unexplained"
        yield Reason(kind, word, said, advice)
    elif misfits[j] > JOINT_MISFIT_CARE:
        said = f"{percent(misfits[j])} of {fit.joints[j]}'s torque stay unexplained"
        yield Reason(kind, "use with care", said, advice)
    if fit.excess > EXCESS_CARE and fit.misfit > NO_EXCESS:
        yield Reason(
            "contradiction",
            "do not use" if fit.excess > EXCESS_REFUSED else "use with care",
            f"the residual is {fit.excess:.2f} times that of least squares without "
            "constraints: data and constraints, or weights, disagree",
            "see what each constraint costs; check masses, geometry, drive terms",
        )


def _of_guesses(evidence: Evidence) -> Iterator[Reason]:
    """Say if other motions rest on what no data determine."""
    fit = evidence.fit
    if fit is None or not fit.guessed > GUESSED_CARE:
        return
    count = len(evidence.undetermined)
    why = f"{count} combinations are not identifiable" if count else _UNSEEN
    yield Reason(
        "mostly guessed",
        "use with care",
        f"up to {percent(fit.guessed)} of a joint's or the base's torque on other "
        f"motions is the prior's, not the data's: {why}",
        "move all joints more, measure more rows, or state what is known (masses)",
    )


def _of_rest(evidence: Evidence) -> Iterator[Reason]:
    """Name the joints that hardly moved: nothing tells their friction."""
    fit = evidence.fit
    resting = [] if fit is None else where(fit.moving < AT_REST)
    if fit is not None and resting:
        yield Reason(
            "joint at rest",
            "use with care",
            f"{_some([fit.joints[j] for j in resting])} hardly moved: friction and "
            "rotor inertia there are undetermined, and friction may hold any torque "
            "up to breakaway",
            "move these joints too, or take them out of the model (locked)",
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
            f"friction and drives make {percent(fit.drive_share)} of the torque: it "
            "may be compensated for friction",
            "see what the channel is; of a simulated robot without friction, go on",
        )


def _of_noise(evidence: Evidence) -> Iterator[Reason]:
    """Ask how much the samples tell, as residuals are correlated."""
    fit = evidence.fit
    if fit is None or not np.isfinite(fit.spare):
        return
    if fit.spare < SPARE_CARE:
        yield Reason(
            "few samples",
            "use with care",
            f"residuals are correlated over {fit.correlation:.0f} samples: there are "
            f"{fit.spare:.1f} independent ones for each parameter",
            "record for longer, or fewer drive terms: errors are rough",
        )
    elif fit.correlation > WHITE:
        yield Reason(
            "correlated residuals",
            "use",
            f"what is left of the torque is no white noise: {fit.correlation:.0f} "
            "samples tell as much as one; standard errors allow for it",
        )


def _of_optimum(evidence: Evidence) -> Iterator[Reason]:
    if evidence.optimum != "certified":
        yield Reason(
            "optimum not proven",
            "use with care",
            evidence.optimum_reason,
            "compare with cross_check, or with another method",
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
            f"the body of the floating base is not told by the data: of "
            f"{_some(evidence.loose_trunk)} only sums with other bodies are, and the "
            "prior shares them out",
            "state bodies that are known (known_links), as from a log of the robot "
            "hung up by its base",
        )
    if evidence.contradicted:
        # Friction that the model lacks is enough: of clean logs it is said of a third.
        yield Reason("physical consistency", "use", evidence.contradicted)
    edges = [link.link for link in evidence.links if link.edge]
    if edges:
        yield Reason(
            "boundary",
            "use",
            f"on the boundary of physical consistency: {_some(edges)}; torque "
            "prediction stays valid, single inertias of these mean little",
        )


Rule = Callable[[Evidence], Iterable[Reason]]

RULES: tuple[Rule, ...] = (
    of_slopes,
    _of_findings,
    _of_fit,
    _of_held_out,
    _of_bodies,
    _of_channel,
    _of_optimum,
    _of_noise,
    _of_rest,
    _of_guesses,
    _worth_knowing,
)
"""What is asked of the evidence; of reasons with the same word, the first weighs most:
a cause before its effects."""


def _some(names: Sequence[str]) -> str:
    shown = ", ".join(names[:3])
    return shown if len(names) <= 3 else f"{shown} and {len(names) - 3} more"

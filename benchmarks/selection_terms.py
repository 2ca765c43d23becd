"""Drive terms that `select_model` finds, on simulated robots whose terms are known.

``python benchmarks/selection_terms.py [--robots 40] [--first 1000] [--plain 16]
[--write PAGE]``

Each joint of a robot has viscous and Coulomb friction, an offset, and a random choice
of other terms.  The log has encoder steps and coloured torque noise.  A term of a joint
that has none is false; a joint's own term that is not chosen is missed.  Errors are of
another motion's true torque, beside those of the true model fitted to the same rows.
"""

import argparse
import sys
import tempfile
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from time import process_time

import numpy as np
from faults_robots import robots
from pages import add_write, shown_on
from selection_robots import Case, Truth, case_of, written

import consistent_id as ci
from consistent_id.problems.problem import Problem

ROBOTS = ("ur10_like", "seven_joints", "rx60_like", "tree")
TERMS = {
    "rotor_inertia": 0.7,
    "load_friction": 0.3,
    "drag": 0.2,
    "spring": 0.15,
    "asymmetric": 0.15,
    "stribeck_velocity": 0.25,
}
"""Terms that a joint may have, and how often it does."""

_STRIBECK = (0.05, 0.25)  # rad/s, between which Stribeck velocities are drawn
_CLOSE = 1.25  # ratio of velocities that counts as close


@dataclass(frozen=True, slots=True)
class Found:
    """What became of one robot.

    Parameters
    ----------
    false, missed : tuple of (str, str)
        Joints and terms.
    absent, present : Counter
        Joints without a term, and with it, by term.
    width : float, [rad/s]
        Chosen for friction's change of sign; the truth is .02.
    velocities : tuple of float
        Chosen Stribeck velocities over true ones.
    error, oracle : float
        Of another motion's true torque, over it.
    seconds : float
        Of the processor.
    """

    false: tuple[tuple[str, str], ...]
    missed: tuple[tuple[str, str], ...]
    absent: Counter[str]
    present: Counter[str]
    width: float
    velocities: tuple[float, ...]
    error: float
    oracle: float
    seconds: float


def truth_of(seed: int, *, plain: bool) -> Truth:
    """Return a robot with random terms, or with rotor inertia alone."""
    rng, fading = (np.random.default_rng([seed, k]) for k in (29, 77))
    robot = ROBOTS[seed % len(ROBOTS)]
    if plain:
        return Truth(robot, {"rotor_inertia": True})
    own = []
    for _ in range(len(robots()[robot].parts)):
        has = {name: bool(rng.random() < share) for name, share in TERMS.items()}
        stribeck = has.pop("stribeck_velocity") and not has["asymmetric"]
        terms: dict[str, object] = dict(has)
        terms["offset"] = not has["asymmetric"]
        if stribeck:
            velocity = np.exp(fading.uniform(*np.log(_STRIBECK)))
            terms["stribeck_velocity"] = float(velocity)
        own.append(terms)
    return Truth(robot, {}, by_joint=tuple(own))


def found(seed: int, *, plain: bool) -> Found:
    """Draft the problem of a simulated robot's log and compare it with the truth."""
    stated = truth_of(seed, plain=plain)
    case = case_of(stated, seed)
    with tempfile.TemporaryDirectory() as folder:
        model, log = written(case, Path(folder))
        started = process_time()
        draft = ci.draft_problem(model, log)
        seconds = process_time() - started
        problem = draft.problem()
        error = _of_hidden(fitted(problem), case)
        oracle = _of_hidden(fitted(problem, case.model), case)
    if draft.selection is None:
        raise SystemExit(f"seed {seed}: {draft.notes[-1]}")
    names = case.model.robot.joint_names
    drive = dict(
        zip(problem.model.robot.joint_names, draft.selection.choice.drive, strict=True)
    )
    false, missed, velocities = [], [], []
    absent, present = Counter[str](), Counter[str]()
    for j, name in enumerate(names):
        own = stated.terms | (stated.by_joint[j] if stated.by_joint else {})
        for term in TERMS:
            real = bool(own.get(term))
            chosen = bool(getattr(drive[name], term))
            (present if real else absent)[term] += 1
            if chosen and not real:
                false.append((name, term))
            if real and not chosen:
                missed.append((name, term))
        if own.get("stribeck_velocity") and drive[name].stribeck_velocity:
            ratio = drive[name].stribeck_velocity / own["stribeck_velocity"]
            velocities.append(float(ratio))
    width = next(d.velocity_scale for d in drive.values())
    return Found(
        tuple(false),
        tuple(missed),
        absent,
        present,
        width,
        tuple(velocities),
        error,
        oracle,
        seconds,
    )


def fitted(problem: Problem, model: ci.TorqueModel | None = None) -> ci.Estimate:
    """Fit a problem's model, or another one, to its rows under its constraints."""
    constraints = problem.constraints if model is None else ()
    model = problem.model if model is None else model
    regression = ci.build_regression(model, problem.training)
    return ci.constrained_least_squares(model, regression, constraints=constraints)


def _of_hidden(estimate: ci.Estimate, case: Case) -> float:
    states = case.hidden.of(estimate.model.robot.joint_names)
    error = estimate.predict(states) - states.torque
    return float(np.linalg.norm(error) / np.linalg.norm(states.torque))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robots", type=int, default=40)
    parser.add_argument("--plain", type=int, default=16)
    parser.add_argument("--first", type=int, default=1000)
    add_write(parser)
    options = parser.parse_args()
    with shown_on(options.write):
        report(options)


def report(options: argparse.Namespace) -> None:
    """Print a table for robots of each kind; those of each seed go to stderr."""
    for kind, number in (("plain", options.plain), ("mixed", options.robots)):
        all_found = []
        for seed in range(options.first, options.first + number):
            one = found(seed, plain=kind == "plain")
            all_found.append(one)
            false = Counter(term for _, term in one.false)
            missed = Counter(term for _, term in one.missed)
            print(
                f"{kind} {seed}: error {one.error:.2%}, true model {one.oracle:.2%}, "
                f"width {one.width:g}, false {dict(false)}, missed {dict(missed)}, "
                f"{one.seconds:.1f} CPU s",
                file=sys.stderr,
                flush=True,
            )
        if all_found:
            print(summary(kind, all_found), flush=True)


def summary(kind: str, all_found: list[Found]) -> str:
    """Return what robots of a kind have in common, in lines."""
    ratios = np.array([one.error / one.oracle for one in all_found])
    errors = np.array([one.error for one in all_found])
    wide = np.mean([0.01 <= one.width <= 0.04 for one in all_found])
    rows = {term: _counts(term, all_found) for term in TERMS}
    totals = np.sum(list(rows.values()), axis=0)
    lines = [
        f"{len(all_found)} robots, {kind}: error {errors.mean():.2%} mean, "
        f"{errors.max():.2%} worst; over the true model's {np.median(ratios):.2f} "
        f"median, {ratios.max():.2f} worst; width within a factor of two {wide:.0%}"
    ]
    if kind == "plain":  # one term, so a table would have little to say
        false, absent, missed, present = totals
        found = f"false terms {false} of {absent}, missed {missed} of {present}"
        return f"{lines[0]}; {found}\n"
    ratios = np.log([v for one in all_found for v in one.velocities])
    close = int((abs(ratios) <= np.log(_CLOSE)).sum())
    lines[0] += (
        f"; Stribeck velocities {100 * np.median(np.expm1(abs(ratios))):.0f}% wrong in "
        f"the median, within a quarter {close} of {len(ratios)}"
    )
    lines += [
        "\n| term | false, of joints without it | missed, of joints with it |",
        "|---|--:|--:|",
    ]
    for term, counts in rows.items():
        lines.append(_row(term.removesuffix("_velocity").replace("_", " "), counts))
    return "\n".join([*lines, _row("all", totals)])


def _counts(term: str, all_found: Sequence[Found]) -> tuple[int, int, int, int]:
    """Return how many joints have a false term, lack it, miss it, have it."""
    return (
        sum(t == term for one in all_found for _, t in one.false),
        sum(one.absent[term] for one in all_found),
        sum(t == term for one in all_found for _, t in one.missed),
        sum(one.present[term] for one in all_found),
    )


def _row(name: str, counts: Sequence[int]) -> str:
    false, absent, missed, present = counts
    return f"| {name} | {false} of {absent} | {missed} of {present} |"


if __name__ == "__main__":
    main()

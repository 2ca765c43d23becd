"""How many random problems are solved and certified, and whether any verdict is wrong.

``python benchmarks/robustness.py [--problems 1000] [--write docs/robustness.md]``.
Robots of 2 to 9 joints, serial and branched, turning and sliding, with friction; masses
fixed or free; motions from rich to next to nothing, some joints standing still.
"""

import argparse
import sys
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits
from tqdm import tqdm

import consistent_id as ci
from consistent_id.constraints import Constraint, lowered
from consistent_id.constraints.cones.least_norm import LeastNorm
from consistent_id.constraints.cones.programmes import Multipliers
from consistent_id.constraints.cones.sets import ConicSet
from consistent_id.constraints.delivered_bodies import link_conditions
from consistent_id.constraints.priors import nominal_distance
from consistent_id.estimation.best_fit import FitProblem
from consistent_id.estimation.constrained_fit import (
    ConstrainedFit,
    constrained_fit,
)

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "helpers"))
from robots import random_body, random_robot
from second_solver import FORMULATIONS, solve_anew

SAMPLES = (60, 200, 2000)
FAR_AWAY = ", but is farther away than the proof reaches"
ROUNDING = 1e-9
"""Relative amount by which a fit may be better than the stated gap allows."""


@dataclass(frozen=True)
class Case:
    """A random problem whose truth is known."""

    seed: int
    model: ci.TorqueModel
    truth: np.ndarray
    recording: ci.Recording
    constraints: tuple[Constraint, ...]
    possible: bool


@dataclass(frozen=True)
class Result:
    """What came of a problem."""

    condition: float
    verdict: str
    gap: float
    wrong: tuple[str, ...]


def case(seed: int, *, joints: int = 9, samples: Sequence[int] = SAMPLES) -> Case:
    """Return a problem; every twentieth has a datasheet that no robot satisfies.

    Parameters
    ----------
    joints : int
        At most.
    samples : sequence of int
        Of which one is drawn.
    """
    rng = np.random.default_rng(seed)
    joints = int(rng.integers(2, joints + 1))
    _, robot = random_robot(rng, joints, tree=bool(rng.integers(2)))
    drive = ci.DriveTerms(
        viscous=True,
        coulomb="sign" if rng.integers(2) else "none",
        offset=bool(rng.integers(2)),
        rotor_inertia=bool(rng.integers(2)),
    )
    model = ci.TorqueModel(robot, drive)
    extra = rng.uniform(0.0, 1.0, len(model.layout) - 10 * joints)
    bodies = [scaled_to(link.nominal.mass, random_body(rng)) for link in robot.links]
    truth = np.concatenate([*bodies, extra])
    motion = random_motion(rng, robot.joint_names, int(rng.choice(samples)))
    noise = 10.0 ** rng.uniform(-4, 0)
    recording = ci.simulate_torque(model, truth, motion, noise=noise, rng=rng)
    constraints: list[Constraint] = [
        ci.PhysicalConsistency(),
        ci.NonNegativeDrive(),
    ]
    if rng.integers(2):
        constraints.append(ci.FixedMasses())
    possible = seed % 20 != 0
    if not possible:
        name = f"{robot.link_names[-1]}.Izz"
        constraints.append(
            ci.constraints.FixedParameters({name: -float(rng.uniform(0.01, 1.0))})
        )
    return Case(seed, model, truth, recording, tuple(constraints), possible)


def scaled_to(mass: float, body: ci.InertialParameters) -> np.ndarray:
    """Return another body of a nominal one's mass."""
    return body.vector * (mass / body.mass)


def random_motion(
    rng: np.random.Generator, joints: tuple[str, ...], samples: int
) -> ci.Recording:
    """Return sums of sinusoids of amplitudes 1e-4 to 1 rad, some joints at rest."""
    n = len(joints)
    time = np.arange(samples) / 100
    size = 10.0 ** rng.uniform(-4, 0) if rng.integers(3) == 0 else 1.0
    rest = 0.2 if rng.integers(4) == 0 else 0.0
    amplitude = size * rng.normal(size=(3, n)) * (rng.uniform(size=n) > rest)
    rate = 2 * np.pi * rng.uniform(0.1, 1.5, (3, n))
    phase = rng.uniform(0, 2 * np.pi, (3, n))
    angle = rate * time[:, None, None] + phase
    q = rng.uniform(-2, 2, n) + np.sum(amplitude * np.sin(angle), axis=1)
    dq = np.sum(amplitude * rate * np.cos(angle), axis=1)
    ddq = -np.sum(amplitude * rate**2 * np.sin(angle), axis=1)
    return ci.Recording(joints, time, q, dq, ddq)


def run(problem: Case) -> Result:
    """Solve a problem and look for what is wrong with the answer."""
    model = problem.model
    base = ci.regression.base_parameters(model)
    regression = ci.build_regression(model, problem.recording)
    R = regression.stacked()[:, list(base.independent)]
    condition = ci.regression.condition_number(R, basis="base", unit_columns=True).value
    try:
        estimate = ci.constrained_least_squares(
            model, regression, constraints=problem.constraints, base=base
        )
    except ci.InfeasibleError:
        wrong = ("called impossible",) if problem.possible else ()
        return Result(condition, "refused", 0.0, wrong)
    except ci.SolverError:
        return Result(condition, "no answer", 0.0, ())
    certificate = estimate.certificate
    gap = certificate.figures["prior: relative gap"]
    wrong = ()
    if certificate.verdict == "certified":
        wrong = mistakes(problem, regression, base, estimate)
    return Result(condition, certificate.verdict, gap, wrong)


def mistakes(
    problem: Case,
    regression: ci.Regression,
    base: ci.regression.BaseParameters,
    estimate: ci.Estimate,
) -> tuple[str, ...]:
    """Return what contradicts a certified estimate, found by other means."""
    model, found = problem.model, []
    if not problem.possible:
        found.append("certified what no robot satisfies")
    links = link_conditions(model, estimate.parameters)
    if not all(link.consistent for link in links):
        found.append("a link is not consistent")
    domain = lowered(problem.constraints, model).normalised(
        np.maximum(abs(estimate.parameters), 1.0)
    )
    linear = ConicSet(
        domain.A_eq, domain.b_eq, domain.eq_labels,
        domain.A_in, domain.b_in, domain.in_labels,
    )  # fmt: skip
    scaled = estimate.parameters / np.maximum(abs(estimate.parameters), 1.0)
    if linear.violation(scaled) > 1e-6:
        found.append("a row is violated")
    fitted = constrained_fit(
        FitProblem.of(model, regression, problem.constraints, base), None
    )
    fit = fitted.best
    mine = fit.optimality.objective
    truth = problem.truth / fit.scaled.unit
    others = {"the truth": truth} if problem.possible else {}
    for formulation in FORMULATIONS:
        try:
            others[formulation] = solve_anew(fit.scaled.problem, formulation).u
        except ci.SolverError:
            continue
    unit = fit.scaled.unit
    centre = nominal_distance(model, "pullback", unit).nominal
    radius = fit.optimality.radius
    for name, u in others.items():
        # What a point outside of the constraints gains is at most its violation times
        # the multipliers.  The proof reaches ten times as far as the estimate.
        outside = fit.scaled.domain.violation(u)
        if outside > 1e-7:
            continue
        theirs = (
            0.5
            * float(np.linalg.norm(fit.scaled.problem.G @ u - fit.scaled.problem.g))
            ** 2
        )
        theirs += outside * size_of(fit.solution.multipliers)
        stated = fit.optimality.gap + ROUNDING
        if mine - theirs > stated * max(mine, 0.5):
            beyond = np.linalg.norm(u - centre) > radius
            found.append(f"{name} fits better" + (FAR_AWAY if beyond else ""))
    return tuple(found + final_mistakes(fitted))


def final_mistakes(fitted: ConstrainedFit) -> list[str]:
    """Return what contradicts the second stage: nearest to nominal for its misfit."""
    scaled, fit = fitted.best.scaled, fitted.final
    rows, root = fitted.distance.local(fit.solution.u), np.sqrt(fit.weight)
    stacked = LeastNorm(
        np.vstack([scaled.M, root * rows.G]),
        np.append(scaled.z, root * rows.g),
        scaled.domain,
    )
    mine, found = fit.optimality.objective, []
    for formulation in FORMULATIONS:
        try:
            u = solve_anew(stacked, formulation).u
        except ci.SolverError:
            continue
        theirs = 0.5 * float(np.sum((stacked.G @ u - stacked.g) ** 2))
        theirs += scaled.domain.violation(u) * size_of(fit.solution.multipliers)
        if mine - theirs > (fit.optimality.gap + ROUNDING) * max(mine, 0.5):
            found.append(f"{formulation} finds a better compromise")
    return found


def size_of(multipliers: Multipliers) -> float:
    """Return the sum of multipliers' sizes."""
    rows = float(np.sum(abs(multipliers.equal)) + np.sum(multipliers.at_most))
    return rows + sum(float(np.trace(Z)) for Z in multipliers.blocks)


def page(results: list[Result]) -> str:
    """Return the counts as Markdown."""
    decades = [(0, 2), (2, 4), (4, 6), (6, 8), (8, np.inf)]
    verdicts = ("certified", "uncertified", "no answer", "refused")
    lines = [
        "# Certificates over random problems",
        "",
        f"Measured by `python benchmarks/robustness.py --problems {len(results)}`:",
        "robots of 2 to 9 joints, serial and branched, turning and sliding, with",
        "friction; masses fixed or free; 60 to 2000 samples; amplitudes of 1e-4 to 1;",
        "some joints at rest; noise of 1e-4 to 1 N m. In every twentieth problem the",
        "datasheet requires a negative moment of inertia; the right answer is then",
        "that no robot exists. An answer is wrong in three cases: it says that no",
        "robot exists although one does; a certified estimate violates a constraint",
        "or has an inconsistent link; or the true parameters, or the result of a",
        "second formulation or solver, fit better by more than the stated gap, in",
        "either stage. Proofs are valid up to ten times the distance of the estimate",
        "from the nominal robot; better points beyond are counted separately.",
        "",
        "| condition number (unit columns) | problems | "
        + " | ".join((*verdicts[:-1], "no robot exists"))
        + " | better, but far away | wrong |",
        "|---|" + "---:|" * (len(verdicts) + 3),
    ]
    for low, high in decades:
        chosen = [r for r in results if 10.0**low <= r.condition < 10.0**high]
        if high == np.inf:
            chosen = [r for r in results if r.condition >= 10.0**low]
        name = f"1e{low} to 1e{high}" if high < np.inf else "1e8 and more, or deficient"
        lines.append(_row(name, chosen, verdicts))
    lines.append(_row("all", results, verdicts))
    gaps = [r.gap for r in results if r.verdict == "certified"] or [np.inf]
    lines += ["", f"Largest relative gap of a certified optimum: {max(gaps):.1e}."]
    open_ended = [r for r in results if r.verdict == "uncertified"]
    if open_ended:
        least = min(r.condition for r in open_ended)
        most = max(r.gap for r in open_ended)
        lines += [
            f"Uncertified estimates have condition numbers of {least:.0e} and",
            f"more, and gaps of up to {most:.0e}.",
        ]
    return "\n".join(lines) + "\n"


def _row(name: str, chosen: list[Result], verdicts: tuple[str, ...]) -> str:
    counts = Counter(r.verdict for r in chosen)
    wrong = sum(any(not w.endswith(FAR_AWAY) for w in r.wrong) for r in chosen)
    far = sum(any(w.endswith(FAR_AWAY) for w in r.wrong) for r in chosen)
    cells = [*(str(counts[v]) for v in verdicts), str(far), str(wrong)]
    return f"| {name} | {len(chosen)} | " + " | ".join(cells) + " |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--problems", type=int, default=1000)
    parser.add_argument("--first", type=int, default=1, help="seed of the first")
    parser.add_argument("--show", action="store_true", help="print doubtful ones")
    parser.add_argument("--write", type=Path, help="file to write the page to")
    options = parser.parse_args()
    results = []
    seeds = range(options.first, options.first + options.problems)
    with threadpool_limits(1):
        for seed in tqdm(seeds, unit="problem"):
            result = run(case(seed))
            results.append(result)
            if options.show and (
                result.wrong or result.verdict in ("uncertified", "no answer")
            ):
                tqdm.write(f"{seed}: {result}")
    text = page(results)
    print(text)
    if options.write:
        options.write.write_text(text)


if __name__ == "__main__":
    main()

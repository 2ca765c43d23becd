"""Whether odd torque leads to foreign errors, warnings, or needless doubt.

``python benchmarks/odd_torque.py [--problems 1000] [--first 1] [--minutes 10] [--small]
[--write PAGE]`` prints the table of ``docs/certificates.md``.  It takes the random
robots and motions of ``robustness.py``, with ``--small`` of up to 4 joints and 200
samples; their torque is reversed, of another robot's motion, noise, constant, tiny or
huge.  Where an optimum is not proven, CVXPY with Clarabel and SCS solve the same
problem anew; agreement to 1e-5 of the objective means that the doubt was needless.
Where the estimate itself violates constraints by more than a certificate allows, it is
no optimum, and the doubt is right.
"""

import argparse
import sys
import warnings
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path
from time import monotonic

import numpy as np
from pages import add_write, shown_on
from robustness import Case, case
from threadpoolctl import threadpool_limits
from tqdm import tqdm

import consistent_id as ci
from consistent_id.constraints.cones.certificate import FEASIBILITY_TOLERANCE
from consistent_id.constraints.cones.least_norm import LeastNorm
from consistent_id.errors import ConsistentIdError
from consistent_id.estimation.best_fit import FitProblem
from consistent_id.estimation.constrained_fit import constrained_fit

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "helpers"))
from second_solver import FORMULATIONS, solve_anew

KINDS = ("reversed", "one reversed", "exchanged", "garbage", "constant", "tiny", "huge")
AGREES = 1e-5
SMALL = {"joints": 4, "samples": (60, 200)}


@dataclass(frozen=True)
class Outcome:
    """What came of a problem."""

    seed: int
    kind: str
    verdict: str
    warned: tuple[str, ...] = ()
    agrees: tuple[str, ...] = ()
    detail: str = ""


def odd(problem: Case, kind: str) -> np.ndarray:
    """Return a torque that the robot does not have, shape (samples, joints)."""
    rng = np.random.default_rng([problem.seed, KINDS.index(kind)])
    torque = problem.recording.torque
    joint = int(rng.integers(torque.shape[1]))
    sign = np.ones(torque.shape[1])
    sign[joint] = -1.0
    size = float(np.sqrt(np.mean(torque**2)))
    return {
        "reversed": -torque,
        "one reversed": torque * sign,
        "exchanged": np.roll(torque, 1, axis=1),
        "garbage": size * rng.normal(size=torque.shape),
        "constant": np.full(torque.shape, size * rng.normal()),
        "tiny": torque * 10.0 ** -rng.uniform(3, 14),
        "huge": torque * 10.0 ** rng.uniform(3, 14),
    }[kind]


def run(seed: int, *, small: bool = False) -> Outcome:
    """Solve a problem; say what came of it."""
    problem = case(seed, **SMALL) if small else case(seed)
    kind = KINDS[seed % len(KINDS)]
    recording = replace(problem.recording, torque=odd(problem, kind))
    with warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("always")
        outcome = _outcome(problem, kind, recording)
    said = tuple(sorted({f"{w.category.__name__}: {w.message}" for w in heard}))
    return replace(outcome, warned=said)


def _outcome(problem: Case, kind: str, recording: ci.Recording) -> Outcome:
    model = problem.model
    try:
        base = ci.regression.base_parameters(model)
        regression = ci.build_regression(model, recording)
        estimate = ci.constrained_least_squares(
            model, regression, constraints=problem.constraints, base=base
        )
    except ConsistentIdError as error:
        name = type(error).__name__
        return Outcome(problem.seed, kind, name, detail=str(error)[:200])
    except Exception as foreign:
        name = type(foreign).__name__
        return Outcome(problem.seed, kind, "foreign", detail=f"{name}: {foreign}"[:200])
    certificate = estimate.certificate
    if certificate.verdict == "certified":
        return Outcome(problem.seed, kind, "certified")
    agrees = agreement(problem, regression, base)
    reason = certificate.reason[:220]
    return Outcome(problem.seed, kind, certificate.verdict, (), agrees, reason)


def agreement(
    problem: Case, regression: ci.Regression, base: ci.regression.BaseParameters
) -> tuple[str, ...]:
    """Return the solvers that find no better point than ours, if it is feasible."""
    whole = FitProblem.of(problem.model, regression, problem.constraints, base)
    fitted = constrained_fit(whole, None)
    scaled, fit = fitted.best.scaled, fitted.final
    rows, root = fitted.distance.local(fit.solution.u), np.sqrt(fit.weight)
    second = LeastNorm(
        np.vstack([scaled.M, root * rows.G]),
        np.append(scaled.z, root * rows.g),
        scaled.domain,
    )
    stages = (
        (scaled.problem, fitted.best.optimality.objective),
        (second, fit.optimality.objective),
    )
    proofs = fitted.best.optimality, fit.optimality
    if max(proof.violation for proof in proofs) > FEASIBILITY_TOLERANCE:
        return ()
    found = []
    for formulation in FORMULATIONS:
        try:
            ours_is_least = all(
                _no_better(stage, ours, formulation) for stage, ours in stages
            )
        except ci.SolverError:
            continue
        if ours_is_least:
            found.append(formulation)
    return tuple(found)


def _no_better(stage: LeastNorm, ours: float, formulation: str) -> bool:
    u = solve_anew(stage, formulation).u
    theirs = 0.5 * float(np.sum((stage.G @ u - stage.g) ** 2))
    close = stage.domain.violation(u) < AGREES
    return close and abs(ours - theirs) <= AGREES * max(ours, 0.5)


def table(outcomes: list[Outcome]) -> str:
    """Return the counts as Markdown."""
    columns = ("certified", "uncertified", "InfeasibleError", "foreign")
    lines = [
        "| torque | problems | "
        + " | ".join(columns)
        + " | other | warned | needless |",
        "|---|" + "---:|" * (len(columns) + 4),
    ]
    for kind in (*KINDS, "all"):
        own = [o for o in outcomes if kind in (o.kind, "all")]
        counts = Counter(o.verdict for o in own)
        cells = [counts[c] for c in columns]
        other = len(own) - sum(cells)
        warned = sum(bool(o.warned) for o in own)
        needless = sum(bool(o.agrees) for o in own)
        row = [len(own), *cells, other, warned, needless]
        lines.append(f"| {kind} | " + " | ".join(map(str, row)) + " |")
    return "\n".join(lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--problems", type=int, default=1000)
    parser.add_argument("--first", type=int, default=1, help="seed of the first")
    parser.add_argument("--small", action="store_true", help="4 joints, 200 samples")
    parser.add_argument("--minutes", type=float, default=np.inf, help="end after these")
    add_write(parser)
    options = parser.parse_args()
    with shown_on(options.write):
        report(options)


def report(options: argparse.Namespace) -> None:
    """Print the table."""
    outcomes = []
    seeds = range(options.first, options.first + options.problems)
    end = monotonic() + 60.0 * options.minutes
    with threadpool_limits(1):
        for seed in tqdm(seeds, unit="problem", disable=None):
            if monotonic() > end:
                break
            outcomes.append(outcome := run(seed, small=options.small))
            if outcome.verdict != "certified" or outcome.warned:
                tqdm.write(str(outcome), file=sys.stderr)
    print(table(outcomes))


if __name__ == "__main__":
    main()

"""Errors measured on other recordings, beside those that training data let expect.

``python benchmarks/expected.py [--write docs/model-selection.md]``, with recordings in
``CONSISTENT_ID_DATASETS``.  One recording of a robot predicts another one of it, by the
estimate that its own data recommend.  Nothing of the other recording is used, but for
the motion, from which the widened range is computed.
"""

import argparse
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pairs
from pages import written_to
from repair import EXAMPLES

import consistent_id as ci
from consistent_id.estimation.expected_error import ExpectedError
from consistent_id.estimation.left_out import FOLDS
from consistent_id.problems.study import Study

BOTH_WAYS = ("kuka_kr300", "staubli_tx40", "tiago")
CLOSE = (0.8, 1.25)
UR3 = EXAMPLES / "ur_description/urdf/ur3_robot.urdf"
UR3_GAIN = -8.0  # N m/A; the gains are not known, and currents have the other sign
UR3_JOINTS = {
    "Base": "shoulder_pan_joint",
    "Shoulder": "shoulder_lift_joint",
    "Elbow": "elbow_joint",
    "Wrist 1": "wrist_1_joint",
    "Wrist 2": "wrist_2_joint",
    "Wrist 3": "wrist_3_joint",
}
WITH_RESTS = "ur10e, rests at both ends kept"
HEADER = (
    "| recordings | pairs | averaged: median | 0.8 to 1.25 | pooled: median "
    "| 0.8 to 1.25 | in the 80 % range | in the motion's own range | high over low |",
    "|---|---:|---:|---:|---:|---:|---:|---:|---:|",
)


@dataclass(frozen=True, slots=True)
class Outcome:
    """One recording predicted from another one.

    Parameters
    ----------
    group : str
        Robot, and how its recordings were cut.
    averaged : float
        Error expected if each block's error is divided by its own torque, and the
        squares are averaged.
    expected : ExpectedError
        On a motion of which nothing is known.
    there : ExpectedError
        On the motion predicted.
    measured : float
        Relative error of all joints.
    """

    group: str
    averaged: float
    expected: ExpectedError
    there: ExpectedError
    measured: float


def outcomes() -> Iterator[Outcome]:
    """Yield the outcome of every pair of recordings."""
    problem = ci.load_problem("problems/ur10e")
    whole = [problem.prepare(problem.read(file)) for file in pairs.files()]
    yield from crossed("ur10e, in motion", problem, list(map(pairs.in_motion, whole)))
    yield from crossed(WITH_RESTS, problem, whole)
    for name in BOTH_WAYS:
        yield from both_ways(name, ci.load_problem(f"problems/{name}"))
    yield from both_ways("ur3_currents, as drafted", ur3())


def both_ways(name: str, problem: ci.Problem) -> Iterator[Outcome]:
    """Yield what the training recording makes of the validation recording, and back."""
    (first,), (second,) = problem.training, problem.validation
    yield from crossed(f"{name}, both ways", problem, [first, second])


def ur3() -> ci.Problem:
    """Return the problem of the UR3's bags, its model selected on the first."""
    folder = Path(os.environ["CONSISTENT_ID_DATASETS"]) / "ur3_currents"
    return ci.draft_problem(
        UR3,
        [folder / "id1.bag"],
        validation=[folder / "id2.bag"],
        torque_gain=[UR3_GAIN] * len(UR3_JOINTS),
        names=UR3_JOINTS,
    ).problem()


def crossed(
    group: str, problem: ci.Problem, recordings: list[ci.Recording]
) -> Iterator[Outcome]:
    """Yield what each recording makes of each other one."""
    for own in recordings:
        others = tuple(r for r in recordings if r is not own)
        study = Study(problem, recordings=((own,), others))
        expected = study.recommendation.expected
        if expected is None:
            raise ValueError(f"{group}: no block of {own.name} can be left out")
        errors = study.recommended.validation
        for error, there in zip(errors, study.expected_held_out, strict=True):
            if there is not None:
                yield Outcome(group, averaged(study), expected, there, error.stacked)


def averaged(study: Study) -> float:
    """Return the root mean square of the blocks' errors over their own torque."""
    left_out = study.left_out[study.recommendation.method]
    torque = np.array([np.sum(s.counts * s.torque_rms**2) for s in study.segments])
    blocks = np.array_split(np.arange(len(torque)), FOLDS)
    errors = left_out.errors[0] ** 2 * left_out.shares * torque.sum()
    ratios = [errors[block].sum() / torque[block].sum() for block in blocks]
    return float(np.sqrt(np.mean(ratios)))


def row(group: str, found: list[Outcome]) -> str:
    """Return a group's row of the table."""
    measured = np.array([o.measured for o in found])
    old = measured / [o.averaged for o in found]
    new = measured / [o.expected.error for o in found]
    anywhere = np.mean([o.expected.contains(o.measured) for o in found])
    there = np.mean([o.there.contains(o.measured) for o in found])
    width = np.median([o.there.high / o.there.low for o in found])
    return (
        f"| {group} | {len(found)} | {np.median(old):.2f} | {close(old):.0%} "
        f"| {np.median(new):.2f} | {close(new):.0%} | {anywhere:.0%} | {there:.0%} "
        f"| {width:.1f} |"
    )


def close(ratios: np.ndarray) -> float:
    """Return the share of ratios near one."""
    return float(np.mean((ratios > CLOSE[0]) & (ratios < CLOSE[1])))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", type=Path, help="page to write the table to")
    page = parser.parse_args().write
    groups: dict[str, list[Outcome]] = {}
    for outcome in outcomes():
        groups.setdefault(outcome.group, []).append(outcome)
    moving = [o for g, found in groups.items() if g != WITH_RESTS for o in found]
    with written_to(page, "expected errors", ("ur10e", *BOTH_WAYS)):
        print("\n".join(HEADER))
        for group, found in groups.items():
            print(row(group, found))
        print(row(f"all but {WITH_RESTS}", moving))


if __name__ == "__main__":
    main()

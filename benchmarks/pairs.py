"""UR10e: each recording of full motion predicts each other one.

Ten recordings, ninety pairs.  All settings are those of ``problems/ur10e``.
"""

import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import consistent_id as ci
from consistent_id.estimation.method import Method

FOLDERS = ("identification", "validation")


@dataclass(frozen=True, slots=True, eq=False)
class Pairs:
    """What each recording makes of each other one.

    Parameters
    ----------
    names : tuple of str
        Of the recordings.
    errors : dict of str to ndarray, shape (recordings, recordings)
        By method: stacked error, training on the row's recording, predicting the
        column's; NaN on the diagonal.
    bodies : dict of str to int
        Physically consistent links, over all fits.
    links : int
        Their number.
    """

    names: tuple[str, ...]
    errors: dict[str, np.ndarray]
    bodies: dict[str, int]
    links: int

    def held_out(self, method: str) -> np.ndarray:
        """Return the errors of all pairs."""
        errors = self.errors[method]
        return errors[~np.isnan(errors)]

    def no_worse(self, method: str, other: str) -> float:
        """Return the share of pairs in which one method is no worse than another."""
        return float(np.mean(self.held_out(method) <= self.held_out(other)))


def measure() -> Pairs:
    """Learn from each recording by every method and predict the others."""
    problem = ci.load_problem("problems/ur10e")
    model = problem.model
    recordings = [in_motion(problem.prepare(problem.read(f))) for f in files()]
    regressions = [ci.build_regression(model, r) for r in recordings]
    errors: dict[str, list[list[float]]] = {}
    bodies: dict[str, int] = {}
    for i, recording in enumerate(recordings):
        for estimate in ci.Study(problem, recordings=((recording,), ())).estimates:
            x, method = estimate.parameters, estimate.method
            row = [stacked_error([r], [x]) for r in regressions]
            row[i] = float("nan")
            errors.setdefault(method, []).append(row)
            good = sum(
                link.consistent for link in ci.constraints.link_conditions(model, x)
            )
            bodies[method] = bodies.get(method, 0) + good
    return Pairs(
        tuple("{} s, {}".format(*seconds_and_harmonics(r.name)) for r in recordings),
        {method: np.array(rows) for method, rows in errors.items()},
        bodies,
        len(recordings) * len(model.robot),
    )


def files() -> list[Path]:
    """Return the recordings of full motion, the shortest first."""
    root = Path(os.environ["CONSISTENT_ID_DATASETS"]) / "ur10e"
    found = [file for name in FOLDERS for file in (root / name).glob("*harm*")]
    return sorted(found, key=lambda file: seconds_and_harmonics(file.name))


def seconds_and_harmonics(name: str) -> tuple[int, int]:
    """Return what a recording's name says of it."""
    (seconds,) = re.findall(r"(\d+)sec", name)
    (harmonics,) = re.findall(r"(\d+)harm", name)
    return int(seconds), int(harmonics)


def in_motion(recording: ci.Recording) -> ci.Recording:
    """Return the longest part in which not all joints stand still.

    A log begins with a rest, a jerk to the start and another rest.
    """
    still = ci.signals.standstill(recording).all(axis=1)
    return max(ci.signals.without(recording, still), key=len)


def stacked_error(
    regressions: Sequence[ci.Regression], parameters: Sequence[np.ndarray]
) -> float:
    """Return ``||tau - prediction|| / ||tau||`` over regressions, each with its fit."""
    pairs = list(zip(regressions, parameters, strict=True))
    missed = sum(np.sum(r.counts * r.residual_rms(x) ** 2) for r, x in pairs)
    total = sum(np.sum(r.counts * r.torque_rms**2) for r, _ in pairs)
    return float(np.sqrt(missed / total))


def section(found: Pairs, shown: dict[str, str]) -> list[str]:
    """Return the page's section on pairs; methods as shown, by name."""
    pairs = len(found.held_out(Method.CONSTRAINED))
    rows = [
        f"| {label} | {np.median(errors):.2%} | {errors.mean():.2%} "
        f"| {errors.max():.2%} | {found.no_worse(m, 'least squares'):.0%} "
        f"| {found.bodies[m]} of {found.links} |"
        for m, label in shown.items()
        for errors in [found.held_out(m)]
    ]
    return [
        "## ur10e, all pairs",
        "",
        f"Each of {len(found.names)} recordings of full motion is used to predict each",
        f"other one: {pairs} pairs. Standstill is cut off at both ends. Settings are",
        "those of the",
        "problem file: velocity scale and friction under load were chosen on the",
        "recording of 30 s; cut-offs and drive gains come with the recordings.",
        "",
        "| method | median | mean | worst | no worse than least squares "
        "| consistent links |",
        "|---|---:|---:|---:|---:|---:|",
        *rows,
        "",
        *matrix(found, Method.LEAST_SQUARES),
        *matrix(found, Method.CONSTRAINED),
    ]


def matrix(found: Pairs, method: str) -> list[str]:
    """Return one method's errors, pair by pair, in percent."""
    rows = [
        f"| **{name}** | "
        + " | ".join("" if np.isnan(e) else f"{100 * e:.2f}" for e in errors)
        + " |"
        for name, errors in zip(found.names, found.errors[method], strict=True)
    ]
    return [
        f"{method.capitalize()}, error of all joints [%]; training on the row's "
        "recording",
        "(duration, number of harmonics), validation on the column's:",
        "",
        f"| | {' | '.join(found.names)} |",
        "|---|" + "---:|" * len(found.names),
        *rows,
        "",
    ]

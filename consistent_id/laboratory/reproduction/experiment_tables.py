"""Reproduced experiments as a paper prints them."""

import numpy as np

from consistent_id._support.arrays import Array
from consistent_id._support.tables import Table
from consistent_id.laboratory.reproduction.experiments import (
    ParameterTable,
    Reproduction,
)
from consistent_id.laboratory.reproduction.inertia_errors import ENTRIES, InertiaTable
from consistent_id.laboratory.reproduction.paper_study import PaperStudy
from consistent_id.laboratory.reproduction.paper_verification import Verification
from consistent_id.problems.published import published_table


def experiments_table(table: ParameterTable, *, decimals: int = 4) -> Table:
    """Return one method's vectors, a row for each parameter, as papers print them."""
    return Table(
        f"Parameters by experiment: {table.method}",
        ("parameter", *table.experiments),
        tuple(
            (name, *(f"{value:.{decimals}f}" for value in column))
            for name, column in zip(table.names, table.vectors.T, strict=True)
        ),
    )


def deviations_table(done: Reproduction, *, decimals: int = 4) -> Table:
    """Return each method's mean and standard deviation, as in a paper's Table IV.

    Beside the true vector; where torque does not depend on a direction, a method's mean
    may differ from it along that direction and be as true.
    """
    tables = done.tables
    header = ["parameter", "true"]
    for table in tables:
        header += [f"{table.method}: mean", "standard deviation"]
    rows = []
    for i, name in enumerate(done.names):
        row = [name, f"{done.truth[i]:.{decimals}f}"]
        for table in tables:
            for values in (table.mean, table.standard_deviation):
                row.append(f"{values[i]:.{decimals}f}")
        rows.append(tuple(row))
    count = len(done.experiments)
    return Table(
        f"Means and standard deviations over {count} experiments",
        tuple(header),
        tuple(rows),
    )


def inertia_table(study: PaperStudy, table: InertiaTable) -> Table:
    """Return a method's inertias about the centres of mass, with their errors."""
    printed = published_table(study.problem).central_inertia
    rows = []
    for k, link in enumerate(table.links):
        for e, entry in enumerate(ENTRIES):
            own = f"{printed[link][e]:.4f}" if link in printed else ""
            rows.append(
                (
                    link,
                    entry,
                    own,
                    f"{table.true[k, e] + 0.0:.4f}",
                    f"{table.mean[k, e] + 0.0:.4f}",
                    f"{table.standard_deviation[k, e]:.4f}",
                    f"{table.standard_error[k, e]:.4f}",
                    "torque" if table.identifiable[k, e] else "convention",
                )
            )
    return Table(
        f"Inertia about the centres of mass: {table.method}",
        (
            "link",
            "entry",
            "printed",
            "true",
            "mean",
            "standard deviation",
            "of the mean",
            "determined by",
        ),
        tuple(rows),
        (
            "kg m^2; over the experiments along the tasks; of the mean: divided by "
            "their root, right only if they err independently",
            "convention: torque determines only sums that contain the entry; the "
            "deviation shows how steady the conventional choice is",
            *(
                f"mean of {link}: {words}"
                for link, words in zip(table.links, table.bodies, strict=True)
            ),
        ),
    )


def verification_table(study: PaperStudy, found: Verification, title: str) -> Table:
    """Return mean squared errors by motion and joint, beside the printed ones."""
    names = [recording.name.split(" (")[0] for recording in found.recordings]
    header = ["moved along", "method"]
    header += [f"{name}, {joint}" for name in names for joint in found.joints]
    rows = [
        (one.source, one.method, *_squares(errors.ravel()))
        for one, errors in zip(found.predictors, found.mean_squared_errors, strict=True)
    ]
    printed = np.array(published_table(study.problem).mean_squared_errors)
    if printed.shape == (len(names), len(found.joints)):
        rows.insert(0, ("the paper", "as printed", *_squares(printed.ravel())))
    return Table(
        title,
        tuple(header),
        tuple(rows),
        (
            "mean of squares of measured minus predicted torque, (N m)^2, by the mean "
            "of each method's estimates; truth: what is left is the sensors' noise "
            "and offsets",
            "of the paper's motions one is printed; the columns of the others are "
            "not for the same motions",
        ),
    )


def _squares(values: Array) -> list[str]:
    return [f"{value:.4f}" if value < 1.0 else f"{value:.1f}" for value in values]

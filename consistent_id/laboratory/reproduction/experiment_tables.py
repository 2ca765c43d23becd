"""Reproduced experiments as a paper prints them."""

from consistent_id._support.tables import Table
from consistent_id.laboratory.reproduction.experiments import (
    ParameterTable,
    Reproduction,
)


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

"""Tables of a reproduced study: as the paper prints them, and the sources of errors."""

from collections.abc import Sequence

import numpy as np

from consistent_id._support.arrays import Array, Vector
from consistent_id._support.tables import Table
from consistent_id.laboratory.reproduction.error_analysis import Verification
from consistent_id.laboratory.reproduction.experiments import (
    ENTRIES,
    InertiaTable,
    ParameterTable,
    Reproduction,
)
from consistent_id.laboratory.reproduction.paper_study import TASKS, PaperStudy
from consistent_id.problems.published import published_table

_QUANTILES = (0.0, 0.1, 0.5, 0.9, 1.0)


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
            "kg m^2; over the experiments along the tasks; of the mean: divided by the "
            "root of their number, right only if they err independently",
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
            "of each method's estimates; truth: these errors are the sensors' noise "
            "and offsets",
            "the paper prints one of its motions; the columns of the others are "
            "not for the same motions",
        ),
    )


def _squares(values: Array) -> list[str]:
    return [f"{value:.4f}" if value < 1.0 else f"{value:.1f}" for value in values]


def free_places(study: PaperStudy) -> list[int]:
    """Return the places of the combinations that the paper estimates."""
    fixed = published_table(study.problem).fixed
    return [i for i, name in enumerate(study.tasks.names) if name not in fixed]


def printed_deviation(study: PaperStudy) -> Vector:
    """Return the standard deviations over the paper's own experiments."""
    return study.report.standard_deviation


def spread_table(study: PaperStudy) -> Table:
    """Return the differences of the paper's vectors along its verification motion."""
    spread, joints = study.spread, study.verification.joints
    most = study.tasks.names[study.place.most_scattered]
    rows = [
        (f"experiment {i}, less the mean", *(f"{v:.4f}" for v in row))
        for i, row in enumerate(spread.vectors, start=1)
    ]
    alone = (f"{most} alone, by one standard deviation",)
    rows.append((*alone, *(f"{v:.4f}" for v in spread.most_scattered)))
    rows += [
        (f"printed error {i}", *(f"{v:.4f}" for v in row))
        for i, row in enumerate(spread.printed, start=1)
    ]
    return Table(
        "The paper's vectors along its verification motion",
        ("vector", *joints),
        tuple(rows),
        ("mean square of the torque, (N m)^2; nothing of ours is in these numbers",),
    )


def excitation_table(study: PaperStudy) -> Table:
    """Return each experiment's excitation, and the directions that it leaves open."""
    rows = []
    for name, done in study.with_friction.items():
        for experiment in done.experiments:
            excited, log = experiment.excitation, experiment.log.wanted
            rows.append(
                (
                    name,
                    experiment.name,
                    f"{log.time[-1] - log.time[0]:.0f}",
                    f"{excited.rank}",
                    f"{excited.condition:.1f}",
                    excited.weakest if name == TASKS else "",
                )
            )
    columns = len(free_places(study))
    undetermined = study.tasks.experiments[0].excitation.undetermined
    return Table(
        "Excitation, experiment by experiment",
        (
            "moved along",
            "experiment",
            "s",
            "rank",
            "condition number",
            "least identifiable",
        ),
        tuple(rows),
        (
            f"condition number and rank of the {columns} free columns of the paper's "
            "regressor, each of unit length; zeros of the singular values do not count",
            "least identifiable: largest parts of that combination, in units of the "
            "columns' lengths",
            "not identifiable by any motion: " + "; ".join(undetermined),
        ),
    )


def cause_table(study: PaperStudy) -> Table:
    """Return the scatter of each parameter, and the part of each cause in it."""
    budget, done = study.error_analysis.budget, study.tasks
    found = done.scatter(done.tables[0])
    rest = done.errors(done.tables[0]) - budget.error()
    columns = [printed_deviation(study), found]
    columns += [budget.scatter(cause) for cause in budget.causes]
    columns += [rest.std(axis=0, ddof=1), budget.noise_scatter]
    return Table(
        "Scatter of least squares as published, and its causes",
        (
            "parameter",
            "printed",
            "found",
            *(f"by {cause}" for cause in budget.causes),
            "rest",
            "predicted noise",
        ),
        _rows(study, columns),
        (
            "standard deviation over the experiments; printed: in the paper; found: "
            "in the laboratory, without the parts along which no torque changes",
            "causes add up experiment by experiment, not in this table; rest: found "
            "less all causes; predicted noise: from load cell and cameras alone",
        ),
    )


def drawn_table(study: PaperStudy) -> Table:
    """Return the scatter under other assumptions."""
    varied, place = study.error_analysis.varied, study.place
    most, least = (
        study.tasks.names[i] for i in (place.most_scattered, place.least_scattered)
    )
    printed = printed_deviation(study)
    rows = []
    for what, scatter in (
        ("friction drawn", varied.friction),
        ("tasks drawn", varied.tasks),
        ("tasks and friction drawn", varied.both),
        ("tasks drawn, noise alone", varied.noise),
    ):
        size = scatter[:, place.most_scattered]
        values = np.quantile(size, _QUANTILES)
        ratio = scatter[:, place.least_scattered] / np.where(size > 0.0, size, np.inf)
        rows.append(
            (
                what,
                f"{len(scatter)}",
                *(f"{value:.3f}" for value in values),
                f"{np.mean(size >= printed[place.most_scattered]):.0%}",
                f"{ratio.min():.2g}",
            )
        )
    own = printed[place.least_scattered] / printed[place.most_scattered]
    return Table(
        f"The scatter of {most} when assumptions are drawn at random",
        (
            "drawn",
            "draws",
            *(f"{q:.0%}" for q in _QUANTILES),
            "at least as printed",
            f"least {least} / {most}",
        ),
        tuple(rows),
        (
            "quantiles over the draws; places within 5 cm, sizes and durations within "
            "a factor of 1.25, each joint's viscous and Coulomb friction within 2",
            f"printed: {most} {printed[place.most_scattered]:.4f}, {least} "
            f"{printed[place.least_scattered]:.4f}, which is {own:.2g} of it",
        ),
    )


def tempo_table(study: PaperStudy) -> Table:
    """Return the scatter of slower tasks, with the friction that errors allow."""
    tempo, place = study.error_analysis.tempo, study.place
    most = study.tasks.names[place.most_scattered]
    printed = float(printed_deviation(study)[place.most_scattered])
    needed = tempo.needed(place.most_scattered, printed)
    rows = tuple(
        (
            f"{factor:g}",
            f"{own[place.most_scattered]:.4f}",
            f"{noise[place.most_scattered]:.4f}",
        )
        for factor, own, noise in zip(
            tempo.slowness, tempo.scatter, tempo.noise, strict=True
        )
    )
    shares = ", ".join(f"{share:.3f}" for share in tempo.allowed)
    return Table(
        f"The scatter of {most} when tasks take longer",
        ("times longer", "by the friction that printed errors allow", "by noise alone"),
        rows,
        (
            "friction: the laboratory's times " + shares + " (joint by joint), so that "
            "its mean square along the paper's verification motion is what is printed",
            f"printed: {printed:.4f}, reached when tasks take {needed:.2g} times as "
            "long as in the problem file",
        ),
    )


def shrinking_table(
    study: PaperStudy, method: int, reproductions: dict[str, Reproduction], title: str
) -> Table:
    """Return each set's scatter by parameter, and by which factor it is smaller."""
    first = reproductions[TASKS]
    own = first.scatter(first.tables[method])
    others = [(name, done) for name, done in reproductions.items() if name != TASKS]
    header = ["parameter", TASKS]
    for name, _ in others:
        header += [name, "times smaller", "RMS error"]
    rows = []
    for i in free_places(study):
        row = [first.names[i], f"{own[i]:.4f}"]
        for _, done in others:
            table = done.tables[method]
            scatter = done.scatter(table)[i]
            error = np.sqrt((done.errors(table)[:, i] ** 2).mean())
            row += [f"{scatter:.4f}", _times(own[i], scatter), f"{error:.4f}"]
        rows.append(tuple(row))
    return Table(
        title,
        tuple(header),
        tuple(rows),
        (
            f"{first.tables[method].method}; standard deviation over "
            f"{len(first.experiments)} experiments of the same lengths and noise, "
            "without the parts along which no torque changes",
        ),
    )


def shrunk_table(study: PaperStudy) -> Table:
    """Return by how much exciting motions shrink scatter, whatever the friction."""
    most, places = study.place.most_scattered, free_places(study)
    rows = []
    for name, times in study.error_analysis.shrunk.items():
        values = np.quantile(times[:, most], _QUANTILES)
        middle = np.median(times[:, places], axis=0)
        rows.append(
            (
                name,
                *(f"{value:.1f}" for value in values),
                f"{np.sum(middle > 1.0)} of {len(places)}",
            )
        )
    return Table(
        f"Times that {study.tasks.names[most]} scatters less, friction drawn at random",
        ("instead of the tasks", *(f"{q:.0%}" for q in _QUANTILES), "smaller"),
        tuple(rows),
        (
            "quantiles over draws of friction, the same along tasks and exciting "
            "motions, not in the model; smaller: parameters whose scatter shrinks in "
            "the median",
        ),
    )


def constraints_table(study: PaperStudy) -> Table:
    """Return the effect of constraints alone, along the tasks."""
    columns, header = [], ["parameter"]
    for what, reproductions in (
        ("robot with friction", study.with_friction),
        ("robot without", study.without_friction),
    ):
        done = reproductions[TASKS]
        for table in done.tables[:2]:
            error = np.sqrt((done.errors(table) ** 2).mean(axis=0))
            columns += [done.scatter(table), error]
            header += [f"{what}: {table.method}, scatter", "RMS error"]
    return Table(
        "What constraints alone do, along the tasks",
        tuple(header),
        _rows(study, columns),
        ("both methods have no friction in their model; the robot has, or has none",),
    )


def _rows(study: PaperStudy, columns: Sequence[Array]) -> tuple[tuple[str, ...], ...]:
    names = study.tasks.names
    return tuple(
        (names[i], *(f"{column[i]:.4f}" for column in columns))
        for i in free_places(study)
    )


def _times(before: float, after: float) -> str:
    times = before / after if after > 0.0 else np.inf
    return f"{times:.1f}" if times < 10.0 else f"{times:.0f}"

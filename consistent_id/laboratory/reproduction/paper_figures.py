"""Figures of a reproduced study; drawn for light and dark backgrounds alike."""

from typing import Any

import numpy as np

from consistent_id._support.arrays import Array
from consistent_id._support.extras import needed
from consistent_id.laboratory.reproduction.paper_study import TASKS, PaperStudy
from consistent_id.laboratory.reproduction.paper_tables import (
    free_places,
    printed_deviation,
)
from consistent_id.problems.published import published_table

_COLOURS = ("#d55e00", "#0072b2", "#009e73", "#cc79a7", "#e69f00", "#56b4e9")
_GREY = "#808080"
_POINTS = 1000  # of a curve; more would not be seen


def vectors_figure(study: PaperStudy) -> Any:
    """Return the most scattered parameter in each experiment, set by set."""
    place, table = study.place.most_scattered, published_table(study.problem)
    rows = [("the paper", np.array(table.experiments)[:, place])]
    for name, done in study.with_friction.items():
        shown = done.tables if name == TASKS else (done.tables[0], done.tables[2])
        rows += [(f"{name}:\n{t.method}", t.vectors[:, place]) for t in shown]
    figure = _figure(8.0, 0.48 * len(rows) + 1.0)
    axis = figure.subplots()
    for k, (_, values) in enumerate(rows):
        colour = _GREY if k == 0 else _COLOURS[(k - 1) % len(_COLOURS)]
        axis.plot(values, np.full(len(values), -k), "o", color=colour, alpha=0.8)
        axis.plot(values.mean(), -k, "|", color=colour, ms=18, mew=2)
    axis.axvline(study.tasks.truth[place], color=_GREY, lw=1, ls="--")
    axis.set_yticks(range(0, -len(rows), -1), [name for name, _ in rows], fontsize=7)
    axis.set_xlabel(
        f"{study.tasks.names[place]} [{_unit(study, place)}]; dashed: the laboratory's"
    )
    return figure


def scatter_figure(study: PaperStudy) -> Any:
    """Return the scatter of each parameter: printed, found, noise alone."""
    done = study.tasks
    return _scatters(
        study,
        (
            ("printed by the paper", printed_deviation(study), "D", _GREY),
            ("found along the tasks", done.scatter(done.tables[0]), "o", _COLOURS[0]),
            (
                "found, friction in the model",
                done.scatter(done.tables[2]),
                "^",
                _COLOURS[2],
            ),
            (
                "predicted from noise alone",
                study.error_analysis.budget.noise_scatter,
                "_",
                _COLOURS[1],
            ),
        ),
    )


def exciting_figure(study: PaperStudy) -> Any:
    """Return the scatter of each parameter by the motions of the experiments."""
    rows = []
    for k, (name, done) in enumerate(study.with_friction.items()):
        rows.append((name, done.scatter(done.tables[0]), "o", _COLOURS[k]))
    done = study.tasks
    rows.insert(
        1, (f"{TASKS}, constrained", done.scatter(done.tables[1]), "x", _COLOURS[5])
    )
    return _scatters(study, rows)


def budget_figure(study: PaperStudy) -> Any:
    """Return the most scattered parameter's errors by experiment and cause."""
    budget, place = study.error_analysis.budget, study.place.most_scattered
    figure = _figure(8.0, 0.45 * len(budget.experiments) + 1.4)
    axis = figure.subplots()
    y = -np.arange(len(budget.experiments))
    positive, negative = np.zeros(len(y)), np.zeros(len(y))
    for c, cause in enumerate(budget.causes[:-1]):
        for j, joint in enumerate(budget.joints):
            values = budget.parts[:, c, j, place]
            start = np.where(values >= 0.0, positive, negative)
            axis.barh(
                y,
                values,
                left=start,
                height=0.6,
                color=_COLOURS[j % len(_COLOURS)],
                alpha=1.0 if c else 0.45,
                label=f"{cause}, {joint}",
            )
            positive = positive + np.maximum(values, 0.0)
            negative = negative + np.minimum(values, 0.0)
    errors = study.tasks.errors(study.tasks.tables[0])[:, place]
    axis.plot(errors, y, "D", color=_GREY, ms=6, label="error found")
    axis.axvline(0.0, color=_GREY, lw=0.8)
    axis.set_yticks(y, budget.experiments)
    axis.set_xlabel(f"error of {budget.names[place]} [{_unit(study, place)}]")
    _legend(figure, axis, 4)
    return figure


def assumptions_figure(study: PaperStudy) -> Any:
    """Return the most scattered parameter's scatter over guesses and over the tempo."""
    figure = _figure(9.0, 3.4)
    left, right = figure.subplots(1, 2, sharey=True)
    _draw_guesses(left, study)
    _draw_tempo(right, study)
    printed = printed_deviation(study)[study.place.most_scattered]
    for axis in (left, right):
        axis.axhline(printed, color=_GREY, lw=1, ls="--", label="printed")
    right.legend(fontsize=8, frameon=False)
    return figure


def _draw_guesses(axis: Any, study: PaperStudy) -> None:
    """Draw the scatter for friction as in the file, and for guesses around it."""
    place, drawn = study.place.most_scattered, study.error_analysis.varied
    guesses = {
        "noise alone": drawn.noise,
        "tasks drawn": drawn.tasks,
        "friction drawn": drawn.friction,
        "both drawn": drawn.both,
    }
    for k, scatter in enumerate(guesses.values()):
        values = scatter[:, place]
        spread = np.linspace(-0.25, 0.25, len(values))
        axis.semilogy(k + spread, values, ".", color=_COLOURS[k], ms=4, alpha=0.6)
    axis.set_xticks(range(len(guesses)), guesses, fontsize=8)
    axis.set_ylabel(f"scatter of {drawn.names[place]} [{_unit(study, place)}]")
    axis.set_title("friction as in the file, and guesses around it", fontsize=9)


def _draw_tempo(axis: Any, study: PaperStudy) -> None:
    """Draw the scatter over the tempo of the tasks."""
    place, tempo = study.place.most_scattered, study.error_analysis.tempo
    for colour, label, scatter in (
        (_COLOURS[0], "friction that printed errors allow", tempo.scatter),
        (_COLOURS[1], "noise alone", tempo.noise),
    ):
        axis.loglog(tempo.slowness, scatter[:, place], "o-", color=colour, label=label)
    axis.set_xticks(tempo.slowness, [f"{value:g}" for value in tempo.slowness])
    axis.minorticks_off()
    axis.set_xlabel("tasks take this many times longer")
    axis.set_title("friction no larger than errors allow", fontsize=9)


def motions_figure(study: PaperStudy) -> Any:
    """Return the verification motions, as they were performed."""
    logs, joints = study.verification.recordings, study.verification.joints
    figure = _figure(9.0, 1.3 * len(joints) + 0.9)
    axes = figure.subplots(len(joints), len(logs), squeeze=False, sharey="row")
    for column, log in zip(axes.T, logs, strict=True):
        keep = _thin(len(log))
        column[0].set_title(log.name.split(" (")[0], fontsize=9)
        for axis, q in zip(column, log.of(joints).position.T, strict=True):
            axis.plot(log.time[keep], q[keep], color=_COLOURS[1], lw=1.2)
        column[-1].set_xlabel("time [s]")
    for axis, joint in zip(axes[:, 0], joints, strict=True):
        axis.set_ylabel(f"{joint}\n[rad]")
    return figure


def prediction_figure(study: PaperStudy) -> Any:
    """Return measured and predicted torque along the first motion, and the rest."""
    found = study.verification
    log, joints = found.recordings[0], found.joints
    shown = [p for p in found.predictors if p.source == TASKS][::2]
    torque = log.of(joints).torque
    figure = _figure(9.0, 1.7 * len(joints) + 1.0)
    axes = figure.subplots(len(joints), 2, squeeze=False, sharex=True)
    keep = _thin(len(log))
    for row, joint in zip(axes, joints, strict=True):
        row[0].set_ylabel(f"{joint}\n[N m]")
    if torque is not None:
        for j, row in enumerate(axes):
            row[0].plot(
                log.time[keep], torque[keep, j], color=_GREY, lw=2.5, label="measured"
            )
        for k, one in enumerate(shown):
            predicted = one.predict(log)
            for j, row in enumerate(axes):
                style: dict[str, Any] = {"color": _COLOURS[2 * k], "lw": 0.9}
                row[0].plot(
                    log.time[keep], predicted[keep, j], label=one.method, **style
                )
                row[1].plot(
                    log.time[keep], torque[keep, j] - predicted[keep, j], **style
                )
    axes[0, 0].set_title("measured and predicted", fontsize=9)
    axes[0, 1].set_title("measured less predicted", fontsize=9)
    for axis in axes[-1]:
        axis.set_xlabel("time [s]")
    _legend(figure, axes[0, 0], 3)
    return figure


def _scatters(study: PaperStudy, rows: Any) -> Any:
    places = free_places(study)
    figure = _figure(9.0, 3.8)
    axis = figure.subplots()
    at = np.arange(len(places))
    for k, (name, scatter, marker, colour) in enumerate(rows):
        shift = 0.11 * (k - (len(rows) - 1) / 2)
        values: Array = np.asarray(scatter)[places]
        size = 12 if marker == "_" else 6
        axis.semilogy(
            at + shift, values, marker, color=colour, ms=size, mew=2, label=name
        )
    axis.set_xticks(at, [study.tasks.names[i] for i in places], rotation=45, fontsize=8)
    axis.set_ylabel("standard deviation")
    _legend(figure, axis, 3)
    return figure


def _figure(width: float, height: float) -> Any:
    # The object interface keeps figures out of pyplot's global state.
    kind = needed("matplotlib.figure", "plots", "a figure").Figure
    return kind(figsize=(width, height), layout="constrained")


def _legend(figure: Any, axis: Any, columns: int) -> None:
    handles, labels = axis.get_legend_handles_labels()
    figure.legend(
        handles,
        labels,
        loc="outside lower center",
        ncol=columns,
        fontsize=8,
        frameon=False,
    )


def _thin(samples: int) -> slice:
    return slice(None, None, max(1, -(-samples // _POINTS)))


def _unit(study: PaperStudy, place: int) -> str:
    return study.report.parametrisation.combinations[place].unit

"""A rollout as one HTML page: table, errors over time, frequency responses."""

import numpy as np

from consistent_id._support.arrays import Vector
from consistent_id.laboratory.rollout.frequency_response import frequency_response
from consistent_id.laboratory.rollout.replay import Replay
from consistent_id.laboratory.rollout.rollout import Rollout
from consistent_id.report.downsampling import buckets, extremes, instants
from consistent_id.report.markup import Html, joined, paragraphs, table_html, tag
from consistent_id.report.page import document
from consistent_id.report.plot import Frame, line, plot, spanning
from consistent_id.report.report_content import Section

_STYLES = ("main", "plain", "measured")  # of the page's style sheet, first on top
_POINTS = 400  # of a curve


ABOUT = (
    "Each model was given the robot's commands in MuJoCo, from the robot's state at "
    "the start; its own motion closes the loop."
)


def rollout_html(rollout: Rollout, title: str) -> str:
    """Return a rollout as one HTML file that needs nothing else."""
    sections = [
        Section("errors", "Errors", _errors(rollout)),
        *(
            Section(
                f"time {i + 1}",
                f"Errors over time: {replays[0].log.name}",
                _over_time(replays),
            )
            for i, replays in enumerate(_by_log(rollout))
        ),
        Section("response", "Frequency response", _responses(_by_log(rollout)[0])),
    ]
    header = joined((tag("h1", title), tag("p", "Commands replayed by models.")))
    return document(f"{title}: rollout", header, sections)


def rollout_body(rollout: Rollout) -> Html:
    """Return a rollout as the body of one section; over time the first log alone."""
    first = _by_log(rollout)[0]
    return joined(
        (
            _errors(rollout),
            tag("h3", f"Errors over time: {first[0].log.name}"),
            _over_time(first),
            tag("h3", "Frequency response"),
            _responses(first),
        )
    )


def _by_log(rollout: Rollout) -> list[list[Replay]]:
    """Return the replays of all models, log by log."""
    shown = (rollout.offsets or rollout.replays).values()
    return [list(replays) for replays in zip(*shown, strict=True)]


def _errors(rollout: Rollout) -> Html:
    return joined((paragraphs(ABOUT), *map(table_html, rollout.tables())))


def _over_time(replays: list[Replay]) -> Html:
    """Return the errors of all models over one log."""
    time = replays[0].log.time
    coarse = buckets(len(time), _POINTS)
    panels = []
    for j, joint in enumerate(replays[0].log.joints):
        errors = [1e3 * replay.errors[:, j] for replay in replays]
        frame = Frame((time[0], time[-1]), spanning(errors), 720, 140)
        curves = [
            line(
                frame, instants(time, coarse), extremes(e, coarse), f"curve {_style(i)}"
            )
            for i, e in reversed(list(enumerate(errors)))
        ]
        panels.append(
            plot(frame, *curves, across="time [s]", down="[mrad]", title=joint)
        )
    return joined((_legend(replays), *panels))


def _responses(replays: list[Replay]) -> Html:
    """Return gain and lag of the robot and of all models."""
    log = replays[0].log
    robot = frequency_response(log, log.position)
    models = [frequency_response(log, replay.position) for replay in replays]
    panels = []
    for j, joint in enumerate(log.joints):
        known = np.isfinite(robot.response[:, j])
        if known.sum() < 2:
            continue
        f = robot.frequency[known]
        pairs = [("measured", robot), *zip(_STYLES, models, strict=False)]
        for what, of in (("gain", np.abs), ("phase [deg]", _degrees)):
            curves = [(style, of(r.response[known, j])) for style, r in pairs]
            frame = Frame((f[0], f[-1]), spanning([c for _, c in curves]), 360, 140)
            panels.append(
                plot(
                    frame,
                    *(line(frame, f, c, f"curve {style}") for style, c in curves),
                    across="frequency [Hz]",
                    down=what,
                    title=f"{joint}: {what}",
                )
            )
    text = "Position over its command; the robot is drawn as measured."
    return joined((tag("p", text), *panels))


def _degrees(response: Vector) -> Vector:
    return np.asarray(np.degrees(np.unwrap(np.angle(response))))


def _style(place: int) -> str:
    return _STYLES[min(place, len(_STYLES) - 1)]


def _legend(replays: list[Replay]) -> Html:
    return tag(
        "span",
        *(
            tag(
                "span",
                tag("i", class_=f"key {_style(i)}"),
                replay.model,
                class_="entry",
            )
            for i, replay in enumerate(replays)
        ),
    )

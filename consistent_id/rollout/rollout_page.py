"""A rollout as one HTML page, and as a section of a study's report.

It has tables, errors over time, and frequency responses of joints to commands.
"""

from typing import NamedTuple

import numpy as np

from consistent_id._support.arrays import Array, Vector
from consistent_id._support.given_values import require_type
from consistent_id.errors import ModelError, RecordingError
from consistent_id.export.mjcf_bodies import require_mujoco
from consistent_id.problems.study import Study
from consistent_id.recordings.recording import Recording
from consistent_id.report.markup import Html, joined, paragraphs, table_html, tag
from consistent_id.report.page import document
from consistent_id.report.plot import (
    Frame,
    buckets,
    extremes,
    instants,
    line,
    plot,
    spanning,
)
from consistent_id.report.report_content import Section
from consistent_id.rollout.commanded_motion import Replay
from consistent_id.rollout.compared_models import Rollout, rollout

_SEGMENTS = 8  # of a log, each half over the next (Welch)
_POWER = 0.01  # of the command's largest, below which a frequency was not commanded

_STYLES = ("main", "plain", "measured")  # of the page's style sheet, first on top
_POINTS = 400  # of a curve

ABOUT = (
    "Each model was given the robot's commands in MuJoCo, from the robot's state at "
    "the start; its own motion closes the loop."
)


class FrequencyResponse(NamedTuple):
    """Position over its command.

    Parameters
    ----------
    frequency : ndarray, shape (frequencies,), [Hz]
    response : ndarray of complex, shape (frequencies, joints)
        NaN where the command has too little power.
    """

    frequency: Vector
    response: Array


def frequency_response(log: Recording, position: Array) -> FrequencyResponse:
    """Return the response of a motion to the commands of a log (Welch's method).

    Parameters
    ----------
    log : Recording
        With commands of position, on a uniform clock.
    position : ndarray, shape (samples, joints)
        Position of the robot, or of a model.
    """
    from scipy.signal import csd, welch

    length = max(2 * len(log) // (_SEGMENTS + 1), 16)
    command = log.position_command
    options = {"fs": log.rate, "nperseg": min(length, len(log)), "axis": 0}
    frequency, power = welch(command, **options)
    cross = csd(command, position, **options)[1]
    power[0] = 0.0  # the mean is no motion
    excited = power >= _POWER * power.max(axis=0)
    response = np.full(cross.shape, np.nan + 0j)
    np.divide(cross, power, out=response, where=excited)
    return FrequencyResponse(frequency, response)


def rollout_html(rollout: Rollout, title: str) -> str:
    """Return a rollout as one HTML file that needs nothing else.

    Parameters
    ----------
    rollout : Rollout
    title : str
    """
    require_type(rollout, Rollout, "rollout")
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


def rollout_section(study: Study) -> tuple[Section, ...]:
    """Return the section on rollouts; none without commands, gains and MuJoCo.

    The recommended estimate is replayed beside the problem's own file of the robot.
    """
    problem = study.problem
    gains = problem.gains
    if gains is None:
        return ()
    try:
        require_mujoco()
    except ModelError:
        return ()
    training = problem.logs("training")
    try:
        done = rollout(
            study.recommended.with_verdict,
            problem.logs("validation") or training,
            gains,
            against=[file for file in problem.model_files.values() if file is not None],
            training=training,
            delay=problem.delay_of_commands,
            locked=problem.table.model.locked,
        )
    except (ModelError, RecordingError) as cause:
        body = tag("p", f"Commands could not be replayed: {cause}")
        return (Section("rollouts", "Rollouts", body),)
    return (Section("rollouts", "Rollouts", rollout_body(done)),)

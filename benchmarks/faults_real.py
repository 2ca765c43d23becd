"""Verdicts on recordings of six real arms that were spoilt as users spoil logs.

``python benchmarks/faults_real.py [--only ur10e/payload ...] [--results FILE] [--write
FILE]`` takes one recording of each arm of ``$CONSISTENT_ID_DATASETS``, spoils it or the
URDF, and works it through as `clean_recordings` does.  The estimate then predicts
another recording of the same arm.  Of torque that is not the drawing's, real friction
and real noise are part, which no simulation has.  A simulated arm is beside them, see
`faults_arms`.
"""

import argparse
import json
import os
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from clean_recordings import Robot, completed, draft_of
from faults import UNNAMED
from faults_arms import REAL, RECORDINGS, arms, leaning_model
from faults_catalogue import GAIN
from pages import stamp
from scipy.signal import lfilter
from threadpoolctl import threadpool_limits

import consistent_id as ci
from consistent_id.diagnosis.findings import LogFinding
from consistent_id.problems.log_check import check_problem

EVIDENCE = "## What the logs show of their faults"
"""Heading of what `faults_evidence` writes below the page's table."""

UNKNOWN = ("ur3/torques 1.3 times", "ur3/torques 0.7 times")
"""Left out: nobody has measured the UR3's gains, so none of all torques is wrong."""

WRONG, TIMES = 0.05, 1.5  # error, and times that of the whole log, that is wrong
HARM, FAR = 0.10, 2.0  # the same, that harms
OF_MOTION = ("short", "small motion", "slow motion", "rank", "hidden factor")
"""Kinds that are true of a log without its fault, and name no cause."""

POSSIBLE = {
    "torque gain": ("gain or unit", "nominal model"),
    "clock": ("gain or unit", "hidden factor"),
    "offset zero": ("hidden factor",),
}
"""Kind of a fault -> reasons of a verdict that state it as one of several causes."""


@dataclass(frozen=True)
class Log:
    """A recording's columns, and the text of the URDF that goes with it."""

    columns: dict[str, np.ndarray]
    urdf: str
    arms: int

    def of(self, channel: str) -> np.ndarray:
        """Return a channel of all joints, shape (samples, joints)."""
        names = [f"{channel}{k + 1}" for k in range(self.arms)]
        return np.column_stack([self.columns[name] for name in names])

    def with_(self, **channels: np.ndarray) -> "Log":
        """Return the log with other channels."""
        new = dict(self.columns)
        for channel, values in channels.items():
            for k in range(values.shape[1]):
                new[f"{channel}{k + 1}"] = values[:, k]
        return replace(self, columns=new)


Spoil = Callable[[Log, str], Log]


def of_torque(change: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> Spoil:
    """Change the torque, or what it is made of, given the time."""
    return lambda log, torque: log.with_(
        **{torque: change(log.of(torque), log.columns["time"])}
    )


def scaled(joint: int, factor: float) -> Spoil:
    """Scale one torque."""
    return of_torque(
        lambda tau, _: tau * np.where(np.arange(tau.shape[1]) == joint, factor, 1.0)
    )


def turned(tau: np.ndarray, _: np.ndarray) -> np.ndarray:
    """Take the first three torques one column too far."""
    return np.column_stack([tau[:, [1, 2, 0]], tau[:, 3:]])


def stepped(tau: np.ndarray, _: np.ndarray) -> np.ndarray:
    """Round to twenty steps either way."""
    step = abs(tau).max(axis=0) / 20
    return np.asarray(np.round(tau / step) * step)


def held(tau: np.ndarray, time: np.ndarray) -> np.ndarray:
    """Sample at 10 Hz, and hold."""
    every = max(int(0.1 / np.median(np.diff(time))), 1)
    return np.asarray(tau[np.arange(len(tau)) // every * every])


def slow(tau: np.ndarray, time: np.ndarray) -> np.ndarray:
    """Filter as a drive may do, first order at 1 Hz."""
    a = np.exp(-2 * np.pi * float(np.median(np.diff(time))))
    return np.asarray(tau[0] + lfilter([1 - a], [1, -a], tau - tau[0], axis=0))


def degrees(log: Log, _: str) -> Log:
    """Log one joint in degrees, with its velocity."""
    columns = dict(log.columns)
    for name in ("q2", "dq2"):
        if name in columns:
            columns[name] = np.degrees(columns[name])
    return replace(log, columns=columns)


def milliseconds(log: Log, _: str) -> Log:
    """Count milliseconds."""
    columns = {**log.columns, "time": 1e3 * log.columns["time"]}
    return replace(log, columns=columns)


def slower(factor: float) -> Spoil:
    """Stretch the time by a factor; velocities, which a log has beside it, are lost."""

    def spoil(log: Log, _: str) -> Log:
        columns = {k: v for k, v in log.columns.items() if not k.startswith("dq")}
        return replace(log, columns={**columns, "time": factor * columns["time"]})

    return spoil


def zero_off(joint: int, degrees: float) -> Spoil:
    """Add a zero offset to the position of a joint."""

    def spoil(log: Log, _: str) -> Log:
        moved = log.columns[f"q{joint}"] + np.radians(degrees)
        return replace(log, columns={**log.columns, f"q{joint}": moved})

    return spoil


def paused(log: Log, _: str) -> Log:
    """Stop three times for two seconds, friction holding what it held."""
    time = log.columns["time"]
    step = float(np.median(np.diff(time)))
    rows = np.arange(len(time))
    for at in (len(time) * np.array([3, 2, 1])) // 4:
        rows = np.insert(rows, at, np.full(int(2.0 / step), rows[at]))
    columns = {
        name: np.where(np.diff(rows, prepend=-1) == 0, 0.0, values[rows])
        if name.startswith("dq")
        else values[rows]
        for name, values in log.columns.items()
    }
    steps = np.where(np.diff(rows) == 0, step, np.diff(time[rows]))
    columns["time"] = np.append(0.0, np.cumsum(steps))
    return replace(log, columns=columns)


def joined(log: Log, torque: str) -> Log:
    """Go on with a robot whose arms weigh half as much again."""
    tau = log.of(torque).copy()
    tau[len(tau) // 2 :] *= 1.5
    return log.with_(**{torque: tau})


def warming(log: Log, torque: str) -> Log:
    """Lose half of the friction while drives warm up, in a third of the log."""
    time, q, tau = log.columns["time"], log.of("q"), log.of(torque)
    speed = np.gradient(_smooth(q, time), time, axis=0)
    left = np.exp(-3.0 * (time - time[0]) / (time[-1] - time[0]))
    for j in range(tau.shape[1]):
        dry = np.tanh(speed[:, j] / 0.02)
        columns = np.column_stack([speed[:, j], dry, np.ones(len(time)), q, np.sin(q)])
        level = np.linalg.lstsq(columns, tau[:, j], rcond=None)[0]
        tau[:, j] -= 0.5 * (1.0 - left) * (columns[:, :2] @ np.maximum(level[:2], 0.0))
    return log.with_(**{torque: tau})


def _smooth(q: np.ndarray, time: np.ndarray) -> np.ndarray:
    width = max(int(0.05 / np.median(np.diff(time))), 1)
    window = np.ones(width) / width
    return np.column_stack([np.convolve(x, window, "same") for x in q.T])


def leaning(log: Log, _: str) -> Log:
    """Draw the base level, though the robot's leans by 10 degrees."""
    return replace(log, urdf=leaning_model(log.urdf, 10.0))


SPOILS: dict[str, tuple[tuple[str, ...], Spoil]] = {
    "whole": ((), lambda log, _: log),
    "torques one column off": (("channel order", "torque channel"), of_torque(turned)),
    "one joint in degrees": (("degrees", "encoder scale"), degrees),
    "one torque in N mm": (GAIN, scaled(1, 1e3)),
    "time in ms": (("clock",), milliseconds),
    "pauses": (("standstill", "frozen channel", "clock"), paused),
    "two robots joined": (("model does not explain", "contact", "drift"), joined),
    "wrong gear ratio": (GAIN, scaled(1, 1.25)),
    "torques 1.3 times": (GAIN, of_torque(lambda tau, _: 1.3 * tau)),
    "torques 0.7 times": (GAIN, of_torque(lambda tau, _: 0.7 * tau)),
    "time 2 times": (("clock", "robot's size"), slower(2.0)),
    "time 1.3 times": (("clock", "robot's size"), slower(1.3)),
    "time 0.7 times": (("clock", "robot's size"), slower(0.7)),
    "zero of joint 2 off by 15 degrees": (("offset zero", "gravity"), zero_off(2, 15)),
    "zero of joint 3 off by 15 degrees": (("offset zero",), zero_off(3, 15)),
    "torque at the motor": (GAIN, of_torque(lambda tau, _: tau / 100.0)),
    "torque reversed": (("torque sign",), scaled(1, -1.0)),
    "torque in coarse steps": (("torque resolution",), of_torque(stepped)),
    "torque held at 10 Hz": (("torque resolution", "lag", "delay"), of_torque(held)),
    "torque filtered at 1 Hz": (("lag", "drive filter", "delay"), of_torque(slow)),
    "drives warm up": (("drift",), warming),
    "base leans by 10 degrees": (("gravity", "offset zero"), leaning),
}
"""Label -> kinds as which it may be named, and what does it."""


@dataclass(frozen=True)
class Outcome:
    """What was said of a log.

    Parameters
    ----------
    name : str
    said : str
        The verdict, or ``refused``.
    faults, warnings, reasons : list of str
        Kinds.
    error : float
        On the other recording, over its torque.
    """

    name: str
    said: str
    faults: list[str]
    warnings: list[str]
    reasons: list[str]
    error: float

    @property
    def label(self) -> str:
        """What was done to it."""
        return self.name.partition("/")[2]

    def harmful(self, whole: float) -> bool:
        """Whether an estimate was made that is wrong enough to do harm."""
        return self.error > max(HARM, FAR * whole)

    @property
    def causes(self) -> set[str]:
        """The kinds that were named as a cause."""
        return {*self.faults, *self.warnings} - {*UNNAMED, *OF_MOTION}

    @property
    def possible(self) -> bool:
        """Whether the verdict states the fault, perhaps among other causes."""
        kinds = SPOILS[self.label][0]
        more = {reason for kind in kinds for reason in POSSIBLE.get(kind, ())}
        return bool((self.causes & {*kinds}) | ({*self.reasons} & more))

    def answer(self, whole: float) -> str:
        """Return how it was answered, beside the error from the whole log."""
        kinds = SPOILS[self.label][0]
        if self.said == "refused" or self.said == "do not use":
            causes = set(self.faults) - set(UNNAMED)
            right = not causes or causes & set(kinds)
            return "refused" if right else "refused, wrong cause"
        if set((*self.faults, *self.warnings)) & set(kinds):
            return "named"
        if self.error <= max(WRONG, TIMES * whole):
            return "estimated well"
        return "care" if self.said != "use" else "SILENTLY WRONG"


def outcome(robot: Robot, folder: Path, label: str, *, quick: bool = False) -> Outcome:
    """Work a spoilt recording through; without an estimate if `quick` and refused."""
    import pandas as pd

    name = f"{robot.name}/{label}"
    source = folder / robot.name
    learn, predict = (source / f"{part}.parquet" for part in RECORDINGS[robot.name])
    with tempfile.TemporaryDirectory() as where, threadpool_limits(1):
        into = Path(where)
        table = pd.read_parquet(learn)
        arms = sum(c[0] == "q" and c[1:].isdigit() for c in table)
        columns = {c: table[c].to_numpy(float) for c in table}
        log = Log(columns, (source / robot.model).read_text(), arms)
        torque = robot.columns.get("torque", "tau{number}").removesuffix("{number}")
        spoilt = SPOILS[label][1](log, torque)
        (into / robot.name).mkdir()
        (into / robot.name / robot.model).write_text(spoilt.urdf)
        file = into / robot.name / "log.parquet"
        pd.DataFrame(spoilt.columns).to_parquet(file)
        (into / "read").mkdir()
        read = completed(robot, file, into, into / "read")
        spoilt_robot = robot
        if not any(name.startswith("dq") for name in spoilt.columns):
            columns = {k: v for k, v in robot.columns.items() if k != "velocity"}
            spoilt_robot = replace(robot, columns=columns)
        try:
            problem = draft_of(spoilt_robot, into, read).problem()
            found = check_problem(problem)
            if quick and found.faults:
                kinds = _kinds(found.findings)
                return Outcome(name, "do not use", *kinds, kinds[0], np.nan)
            study = ci.run_study(problem)
        except ci.ConsistentIdError as refusal:
            return Outcome(name, "refused", [], [], [str(refusal)[:200]], np.nan)
        other = completed(robot, predict, folder, into / "read")
        hidden = draft_of(robot, into, other, select=False).problem()
        logs = _prepared(hidden, study.problem)
        errors = [study.recommended.estimate.score(log).stacked for log in logs]
    return Outcome(
        name,
        study.verdict.word,
        *_kinds(study.findings),
        list(dict.fromkeys(r.kind for r in study.verdict.grounds)),
        float(np.sqrt(np.mean(np.square(errors)))),
    )


def _prepared(hidden: ci.Problem, problem: ci.Problem) -> list[ci.Recording]:
    """Return hidden recordings as a problem prepares its own, if it can.

    A delay of the spoilt torque is none of theirs.  A preparation for another clock
    does not fit their rate; then their own is used.
    """
    logs, problem = hidden.logs("training"), _with_delays_of(hidden, problem)
    try:
        return [problem.prepare(log) for log in logs]
    except ci.errors.RecordingError:
        return [hidden.prepare(log) for log in logs]


def _with_delays_of(other: ci.Problem, problem: ci.Problem) -> ci.Problem:
    """Return a problem that corrects the delays that another one corrects."""
    data, others = problem.table.data, other.table.data
    assert data is not None and others is not None
    preparation = msgspec.structs.replace(
        data.preparation, delays=others.preparation.delays
    )
    data = msgspec.structs.replace(data, preparation=preparation)
    return replace(problem, table=msgspec.structs.replace(problem.table, data=data))


def _kinds(findings: Sequence[LogFinding]) -> tuple[list[str], list[str]]:
    """Return the kinds of faults, and of warnings."""
    faults, cautions = (
        list(dict.fromkeys(f.kind for f in findings if f.severity == severity))
        for severity in ("fault", "warning")
    )
    return faults, cautions


def page(outcomes: dict[str, Outcome]) -> str:
    """Return the page for the documentation."""
    rows = []
    for found in outcomes.values():
        arm = found.name.partition("/")[0]
        whole = outcomes[f"{arm}/whole"].error
        error = "-" if np.isnan(found.error) else f"{found.error:.1%}"
        named = dict.fromkeys((*found.faults, *found.warnings, *found.reasons))
        said = (
            ", ".join(named)
            if not np.isnan(found.error)
            else ", ".join((*found.faults, *found.warnings))
        )
        rows.append(
            (found.label, arm, found.said, said or "-", error, found.answer(whole)),
        )
    answers = [row[-1] for row in rows if row[0] != "whole"]
    counts = ", ".join(f"{answers.count(a)} {a}" for a in dict.fromkeys(answers))
    spoilt = len(RECORDINGS) * (len(SPOILS) - 1) - len(UNKNOWN)
    lines = [
        "# Verdicts on spoilt recordings",
        "",
        f"Measured by `python benchmarks/faults_real.py --quick`{stamp()}:",
        "a recording of each arm gets a typical fault, a problem is drafted from it,",
        "and the problem is run. The error is that of predicting another recording,",
        "which has no fault. An estimate is called `estimated well` if its error is at",
        f"most {TIMES:g} times the error without the fault. If a fault is found, no",
        "estimate is computed (no error is shown). Six arms are real, the Panda is",
        "simulated (`benchmarks/faults_arms.py`). The gains of the UR3 are those that",
        "its bodies imply: logs of it with another gain of all torques are left out.",
        "",
        f"{len(answers)} of {spoilt} spoilt logs: {counts}.",
        "",
        *_figures(outcomes),
        "",
        "| spoilt by | arm | verdict | findings and reasons | error | answer |",
        "|---|---|---|---|---:|---|",
        *(f"| {' | '.join(row)} |" for row in sorted(rows)),
    ]
    return "\n".join(lines) + "\n"


def _figures(outcomes: dict[str, Outcome]) -> list[str]:
    """Return verdicts on harmful estimates, and how often a named cause is right."""
    spoilt = [found for found in outcomes.values() if found.label != "whole"]
    harmful = [
        found
        for found in spoilt
        if found.harmful(outcomes[f"{found.name.partition('/')[0]}/whole"].error)
    ]
    words = [found.said for found in harmful]
    careful = [found for found in harmful if found.said == "use with care"]
    stated = sum(found.possible for found in careful)
    real = sum(found.name.partition("/")[0] in REAL for found in careful)
    named = [found for found in spoilt if found.causes]
    right = sum(bool(f.causes & set(SPOILS[f.label][0])) for f in named)
    return [
        f"The error is above {HARM:.0%} and above {FAR:g} times that without the fault",
        f"for {len(words)} estimates: {words.count('use')} of them are `use`,",
        f"{words.count('use with care')} `use with care`, {words.count('do not use')}",
        f"`do not use`. Of those `use with care`, {real} are of real arms, and",
        f"{stated} name the fault, or state it",
        "as one of the causes that the log does not separate (`gain or unit`,",
        "`nominal model`, `hidden factor`). A cause is named for",
        f"{len(named)} logs; for {right} of them it is among those of the fault.",
    ]


def kept(file: Path | None) -> dict[str, Outcome]:
    """Return what an earlier run has written."""
    lines = file.read_text().splitlines() if file and file.exists() else ()
    records: list[dict[str, Any]] = [json.loads(line) for line in lines]
    return {record["name"]: Outcome(**record) for record in records}


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--only", nargs="+", metavar="PART", default=[""])
    parser.add_argument(
        "--quick", action="store_true", help="estimate only where no fault is found"
    )
    parser.add_argument("--results", type=Path, help="lines of JSON, to resume from")
    parser.add_argument("--write", type=Path, help="write the page here")
    options = parser.parse_args()
    found = kept(options.results)
    with tempfile.TemporaryDirectory() as where:
        folder = Path(where)
        robots = arms(Path(os.environ["CONSISTENT_ID_DATASETS"]), folder)
        for label in SPOILS:
            for robot in robots:
                name = f"{robot.name}/{label}"
                if name in found or name in UNKNOWN:
                    continue
                if not any(part in name for part in options.only):
                    continue
                found[name] = outcome(robot, folder, label, quick=options.quick)
                if options.results:
                    with options.results.open("a") as stream:
                        print(json.dumps(asdict(found[name])), file=stream)
                print(found[name], flush=True)
    if options.write:
        before = options.write.read_text() if options.write.exists() else ""
        _, heading, rest = before.partition(f"\n{EVIDENCE}\n")
        options.write.write_text(page(found) + heading + rest)


if __name__ == "__main__":
    main()

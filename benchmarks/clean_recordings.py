"""What is said of real robots' recordings, with default models: none is faulty.

``python benchmarks/clean_recordings.py [--only ur10e] [--write docs/clean-recordings.md]``
drafts a problem of each recording of ``$CONSISTENT_ID_DATASETS`` and works it through,
as ``consistent-id identify robot.urdf log.parquet`` does: columns, gains and joints are
stated, the rest is default.  Where drives report no torque, it is that of their PD
control, ``kp (q_des - q) - kd dq``.

A default model may be too simple for a robot, and its verdict says so.  But no finding
may call a recording faulty: nothing is wrong with these.
"""

import argparse
import json
import os
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits
from tqdm import tqdm

import consistent_id as ci
from consistent_id.estimation.verdict import percent
from consistent_id.problems.draft import Draft
from consistent_id.problems.drafting import draft_problem
from consistent_id.robot.chains import Selection

MEASURED = {"position": "q{number}", "velocity": "dq{number}", "torque": "tau{number}"}
POSITIONS = {"position": "q{number}", "torque": "tau{number}"}
CURRENTS = {**MEASURED, "torque": "current{number}"}


@dataclass(frozen=True)
class Robot:
    """A robot of the data sets, and what a user would state of its recordings."""

    name: str
    model: str
    columns: dict[str, str]
    selection: Selection = field(default_factory=Selection)
    torque_joints: tuple[str, ...] = ()
    gains: tuple[float, ...] = ()
    commanded: bool = False


@dataclass(frozen=True)
class Answer:
    """What was said of a recording."""

    recording: str
    word: str
    error: float | None
    expected: float | None
    faults: tuple[str, ...]
    warnings: tuple[str, ...]
    reasons: tuple[str, ...]
    seconds: float


def robots(folder: Path) -> tuple[Robot, ...]:
    """Return the robots; what their owners measured is in ``meta.json``."""

    def meta(name: str) -> dict[str, Any]:
        return dict(json.loads((folder / name / "meta.json").read_text()))

    gains = meta("ur10e")["drive_gains_Nm_per_A"]["identified_by_authors"]
    tiago = meta("tiago")["joints"]
    return (
        Robot("ur10e", "ur10e.urdf", CURRENTS, gains=tuple(gains)),
        Robot("kuka_kr300", "kr300.urdf", MEASURED),
        Robot("staubli_tx40", "tx40.urdf", POSITIONS),
        # The recorded velocity lags, and only four joints report their torque.
        Robot(
            "tiago",
            "tiago.urdf",
            POSITIONS,
            Selection(joints=tiago),
            tuple(name for name in tiago if name[:5] == "arm_" and name[4] < "5"),
        ),
        Robot(
            "unitree_go2", "go2.xml", MEASURED, Selection(base="base"), commanded=True
        ),
        Robot("unitree_z1", "z1.xml", MEASURED, commanded=True),
    )


def recordings(folder: Path, robot: Robot) -> Iterator[Path]:
    """Yield a robot's recordings in which it moves."""
    for path in sorted((folder / robot.name).rglob("*.parquet")):
        if path.parent.name != "static_tail":
            yield path


def commanded(path: Path, folder: Path, into: Path) -> Path:
    """Write a recording with the torque of its drives' PD control."""
    import pandas as pd

    table = pd.read_parquet(path)
    meta = json.loads((folder / path.parent.name / "meta.json").read_text())
    for i, (kp, kd) in enumerate(zip(meta["kp"], meta["kd"], strict=True), start=1):
        wanted = table[f"qdes{i}"] - table[f"q{i}"]
        table[f"tau{i}"] = kp * wanted - kd * table[f"dq{i}"]
    written = into / path.name
    table.to_parquet(written)
    return written


def draft_of(robot: Robot, folder: Path, path: Path) -> Draft:
    """Return the draft of a recording's problem."""
    return draft_problem(
        folder / robot.name / robot.model,
        path,
        columns=robot.columns,
        torque_joints=robot.torque_joints,
        selection=robot.selection,
        torque_gain=robot.gains,
    )


def answer(robot: Robot, folder: Path, path: Path) -> Answer:
    """Work one recording through."""
    name = f"{robot.name}/{path.stem}"
    started = process_time()
    with tempfile.TemporaryDirectory() as into:
        log = commanded(path, folder, Path(into)) if robot.commanded else path
        try:
            study = ci.run_study(draft_of(robot, folder, log).problem())
            verdict = study.verdict
        except ci.ConsistentIdError as refusal:
            seconds = process_time() - started
            said = (str(refusal).partition(". ")[0],)
            return Answer(name, "refused", None, None, (), (), said, seconds)
        expected = study.recommendation.expected
    kinds: dict[str, tuple[str, ...]] = {
        severity: tuple(
            dict.fromkeys(f.kind for f in study.findings if f.severity == severity)
        )
        for severity in ("fault", "warning")
    }
    reasons = tuple(f"{r.kind}: {r.statement}" for r in verdict.grounds)
    seconds = process_time() - started
    return Answer(
        name,
        verdict.word,
        verdict.held_out,
        expected,
        kinds["fault"],
        kinds["warning"],
        reasons,
        seconds,
    )


def page(answers: list[Answer]) -> str:
    """Return the page for the documentation."""
    faulty = [a for a in answers if a.faults or a.word == "refused"]
    words = {word: sum(a.word == word for a in answers) for word in (*ci_words(),)}
    counts = ", ".join(f"{n} `{word}`" for word, n in words.items() if n)
    rows = [
        f"| {a.recording} | {a.word} | {_share(a.error)} | {_share(a.expected)} | "
        f"{', '.join(dict.fromkeys(r.partition(':')[0] for r in a.reasons)) or '-'} |"
        for a in answers
    ]
    cpu = np.median([a.seconds for a in answers])
    return "\n".join(
        [
            "# What is said of clean recordings",
            "",
            "Measured by `python benchmarks/clean_recordings.py`: every recording of six",
            "real robots, drafted and worked through with the default model. Nothing is",
            "wrong with these recordings. A default model may be too simple, and then the",
            "verdict says so; but no finding may call a recording faulty.",
            "",
            f"{len(answers)} recordings: {counts}. Called faulty: {len(faulty)}.",
            f"Median {cpu:.2g} s of computing each.",
            "",
            "| recording | verdict | held-out error | expected beforehand | because of |",
            "|---|---|---:|---:|---|",
            *rows,
            "",
        ]
    )


def ci_words() -> tuple[str, ...]:
    """Return the words of verdicts, and that of an error."""
    from consistent_id.estimation.verdict import WORDS

    return (*WORDS, "refused")


def _share(value: float | None) -> str:
    return "-" if value is None else percent(value)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--only", help="recordings whose name contains this")
    parser.add_argument("--write", type=Path, help="write the page here")
    options = parser.parse_args()
    folder = Path(os.environ["CONSISTENT_ID_DATASETS"])
    cases = [
        (robot, path)
        for robot in robots(folder)
        for path in recordings(folder, robot)
        if options.only is None or options.only in f"{robot.name}/{path.stem}"
    ]
    answers = []
    with threadpool_limits(1):
        for robot, path in tqdm(cases, file=sys.stderr, disable=None):
            found = answer(robot, folder, path)
            answers.append(found)
            print(
                f"{found.recording}: {found.word}, {_share(found.error)}, "
                f"{found.seconds:.1f} s",
                flush=True,
            )
            for kind, said in (
                ("faults", found.faults),
                ("warnings", found.warnings),
                ("reasons", found.reasons),
            ):
                if said:
                    print(f"  {kind}: {'; '.join(said)}", flush=True)
    text = page(answers)
    if options.write is not None:
        options.write.write_text(text)
    if any(a.faults or a.word == "refused" for a in answers):
        sys.exit(1)


if __name__ == "__main__":
    main()

"""Verdicts on faulty logs of 89 kinds, on five robots that no threshold was set on.

``python benchmarks/faults.py [--seeds 1 3] [--shell] [--write docs/faults.md]`` draws a
robot and a log (`faults_robots`), puts one fault into the URDF or the log
(`faults_catalogue`), and does what a user would: `draft_problem`, `run_study`, or
``consistent-id identify`` with ``--shell``.  The estimate then predicts another motion
of the robot as it is.

Odd seeds are for development.  Even seeds are run once, for the page.
"""

import argparse
import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from time import process_time

import numpy as np
from faults_catalogue import CATALOGUE, CLEAN
from faults_experiment import Experiment, experiment
from faults_robots import loaded, robots
from threadpoolctl import threadpool_limits
from tqdm import tqdm

import consistent_id as ci
from consistent_id.diagnosis import LogFinding
from consistent_id.diagnosis.one_log import signal_findings

SEEN = (2, 4)
"""Even seeds of which some logs were looked at, and rules were mended afterwards."""

UNNAMED = ("model does not explain",)
"""Kinds that say that something is wrong, and not what."""

WRONG = 0.05  # held-out error, over the torque, from which on an estimate is wrong
_TIMES = 1.5  # times the error from the clean log: a fault that does no harm is none


@dataclass(frozen=True)
class Trial:
    """One log to be worked through."""

    robot: str
    label: str
    seed: int

    @property
    def clean(self) -> bool:
        """Whether nothing is wrong with it."""
        return self.label in CLEAN


@dataclass(frozen=True)
class Outcome:
    """What was said of it.

    Parameters
    ----------
    trial : Trial
    said : str
        The verdict, or ``refused`` where there was an error of the package's own.
    kinds : tuple of str
        Of the findings that are faults or warnings.
    named : tuple of str
        Of the findings that are faults.
    error : float
        Of the recommended estimate on another motion, over the torque.
    words : str
        The first reasons, to be read.
    seconds : float
        Of the processor.
    """

    trial: Trial
    said: str
    kinds: tuple[str, ...]
    named: tuple[str, ...]
    error: float
    words: str
    seconds: float = 0.0

    @property
    def causes(self) -> tuple[str, ...]:
        """What is named as the cause."""
        return tuple(kind for kind in self.named if kind not in UNNAMED)

    @property
    def right(self) -> bool:
        """Whether each cause that is named is one that it may be called."""
        kinds = () if self.trial.clean else CATALOGUE[self.trial.label][0]
        return set(self.causes) <= set(kinds)


def case_of(trial: Trial) -> Experiment:
    """Return an experiment with its fault; the same for the same trial."""
    names = list(robots())
    rng = np.random.default_rng([trial.seed, names.index(trial.robot)])
    clean = experiment(robots()[trial.robot], rng, loaded)
    fault = CLEAN.get(trial.label) or CATALOGUE[trial.label][1]
    place = [*CLEAN, *CATALOGUE].index(trial.label)
    return fault(clean, np.random.default_rng([trial.seed, place]))


def written(case: Experiment, folder: Path) -> tuple[Path, Path]:
    """Write what a user has: a URDF and a CSV file."""
    model, log = folder / "robot.urdf", folder / "log.csv"
    model.write_text(case.text)
    channels = {
        "time": case.log.time[:, None],
        "q": case.log.position,
        "dq": case.log.velocity,
        "tau": case.log.torque,
    }
    kept = {name: values for name, values in channels.items() if values is not None}
    header = [
        "time" if name == "time" else f"{name}_{joint}"
        for name in kept
        for joint in (("",) if name == "time" else case.log.joints)
    ]
    rows = np.hstack(list(kept.values()))
    np.savetxt(log, rows, "%.9g", ",", header=",".join(header), comments="")
    return model, log


def worked(trial: Trial, *, quick: bool = False) -> Outcome:
    """Work a trial through in Python; without an estimate if `quick` and one is found.

    With a finding that is no note, the verdict is not `use`.
    """
    case = case_of(trial)
    with tempfile.TemporaryDirectory() as folder, threadpool_limits(1):
        model, log = written(case, Path(folder))
        try:
            if quick and (faults := seen_at_once(model, log)):
                return found_faulty(trial, faults, faults)
            study = ci.Study(ci.draft_problem(model, log).problem())
            found = study.diagnosis
            if found.suspicious and quick:
                return found_faulty(trial, found.suspicious, found.faults)
            verdict = study.verdict
        except ci.ConsistentIdError as refusal:
            return Outcome(trial, "refused", (), (), np.nan, str(refusal)[:300])
    hidden = case.hidden(np.random.default_rng([trial.seed, 99]))
    estimate = study.recommended.estimate
    states = hidden.of(estimate.model.robot.joint_names)
    predicted = estimate.predict(states)
    measured = states.of(estimate.model.torque_joints).torque
    error = float(np.linalg.norm(predicted - measured) / np.linalg.norm(measured))
    reasons = (f"{r.kind}: {r.statement}" for r in verdict.reasons[:3])
    said = "; ".join(reasons)[:600]
    kinds, named = kinds_of(found.suspicious), kinds_of(found.faults)
    return Outcome(trial, verdict.word, kinds, named, error, said)


def timed(trial: Trial, *, quick: bool) -> Outcome:
    """Work a trial through, and say how long it took."""
    started = process_time()
    return replace(worked(trial, quick=quick), seconds=process_time() - started)


def seen_at_once(model: Path, log: Path) -> list[LogFinding]:
    """Return the faults that signals show by themselves, whatever the model will be."""
    problem = ci.draft_problem(model, log, select=False).problem()
    logs = [*problem.logs("training"), *problem.logs("validation")]
    joints = problem.model.robot.joint_names
    found = [f for log in logs for f in signal_findings(problem.model, log.of(joints))]
    return [f for f in found if f.severity == "fault"]


def found_faulty(
    trial: Trial, suspicious: Sequence[LogFinding], faults: Sequence[LogFinding]
) -> Outcome:
    """Return the outcome of a log with findings, of which no estimate was made."""
    word = "do not use" if faults else "use with care"
    said = "; ".join(f"{f.kind}: {f.statement}" for f in suspicious)[:600]
    return Outcome(trial, word, kinds_of(suspicious), kinds_of(faults), np.nan, said)


def kinds_of(findings: Sequence[LogFinding]) -> tuple[str, ...]:
    """Return the kinds of findings, each once."""
    return tuple(dict.fromkeys(f.kind for f in findings))


def shelled(trial: Trial) -> int:
    """Return the exit code of the shell tool."""
    with tempfile.TemporaryDirectory() as folder:
        files = written(case_of(trial), Path(folder))
        tool = [sys.executable, "-m", "consistent_id", "identify", *map(str, files)]
        return subprocess.run(tool, capture_output=True, check=False).returncode


def baselines(outcomes: Sequence[Outcome]) -> dict[tuple[str, int], float]:
    """Return the error from each robot's clean log, by robot and seed."""
    return {
        (o.trial.robot, o.trial.seed): o.error
        for o in outcomes
        if o.trial.label == "clean"
    }


def silent(outcome: Outcome, clean: dict[tuple[str, int], float]) -> bool:
    """Whether a wrong estimate is handed out with the verdict `use`."""
    trial = outcome.trial
    least = max(WRONG, _TIMES * clean[trial.robot, trial.seed])
    return not trial.clean and outcome.said == "use" and outcome.error > least


def kept(file: Path | None) -> dict[Trial, Outcome]:
    """Return the outcomes that an earlier run has written."""
    lines = file.read_text().splitlines() if file and file.exists() else ()
    found = {}
    for line in lines:
        values = json.loads(line)
        trial = Trial(**values.pop("trial"))
        kinds, named = (tuple(values.pop(name)) for name in ("kinds", "named"))
        found[trial] = Outcome(trial, kinds=kinds, named=named, **values)
    return found


def work_through(
    every: Sequence[Trial], pool: ProcessPoolExecutor, file: Path | None, *, quick: bool
) -> list[Outcome]:
    """Work the trials through that `file` does not hold, and append them to it.

    They are taken at random, so that what is done of a run is a fair share of it.
    """
    work = partial(timed, quick=quick)
    done = kept(file)
    missing = [trial for trial in every if trial not in done]
    np.random.default_rng(0).shuffle(missing)
    missing.sort(key=lambda trial: not trial.clean)  # others are compared with these
    for outcome in tqdm(pool.map(work, missing), total=len(missing)):
        done[outcome.trial] = outcome
        if file:
            with file.open("a") as stream:
                print(json.dumps(asdict(outcome)), file=stream)
    return [done[trial] for trial in every]


def row(label: str, outcomes: Sequence[Outcome], wrong: int) -> str:
    """Return a fault's line of the table."""
    said = [o.said for o in outcomes]
    named = [o for o in outcomes if o.causes]
    counts = [said.count(w) for w in ("use", "use with care", "do not use", "refused")]
    known = [o.error for o in outcomes if np.isfinite(o.error)]
    error = f"{np.median(known):.1%}" if known else "-"
    right = f"{sum(o.right for o in named)} of {len(named)}" if named else "-"
    cells = [label, *counts, error, right, wrong]
    return f"| {' | '.join(map(str, cells))} |"


def page(outcomes: Sequence[Outcome], seeds: Sequence[int], stride: int = 1) -> str:
    """Return what is published."""
    clean = baselines(outcomes)
    labels = list(dict.fromkeys(o.trial.label for o in outcomes))
    faulty = [o for o in outcomes if not o.trial.clean]
    whole = [o for o in outcomes if o.trial.clean]
    named = [o for o in faulty if o.causes]
    quiet = [o for o in faulty if silent(o, clean)]
    numbers = " ".join(map(str, seeds))
    names = dict.fromkeys(o.trial.robot for o in outcomes)
    share = f" --stride {stride}" if stride > 1 else ""
    planned = -(-len(CATALOGUE) * len(names) * len(seeds) // stride)
    chosen = f"at random, of the {planned} that are every {stride}th" if share else ""
    seen = [k for k in seeds if k in SEEN]
    lines = [
        "# Verdicts on faulty logs",
        "",
        f"Measured by `python benchmarks/faults.py --quick --seeds {numbers}{share}`:",
        f"{len(faulty)} faulty logs ({len(labels) - len(CLEAN)} of {len(CATALOGUE)} "
        "faults,",
        f"{chosen or 'at random'}) of {', '.join(names)}.",
        "Their torque has Stribeck and load friction, which the default model lacks.",
        "Odd seeds are for development.",
        *(f"Seed {k} was looked at before, and is not held out." for k in seen),
        "If a fault is found, the verdict is not `use`, and no estimate is computed",
        "(no error is shown).",
        "",
        f"- Silently wrong (verdict `use`, error above {WRONG:.0%} and {_TIMES:g}",
        f"  times that of the clean log): {len(quiet)} of {len(faulty)}.",
        f"- Causes named correctly: {sum(o.right for o in named)} of {len(named)} logs",
        "  with a named cause.",
        f"- Clean logs with a fault or a warning: {sum(bool(o.kinds) for o in whole)}",
        f"  of {len(whole)}; not `use`: {sum(o.said != 'use' for o in whole)}.",
        "",
        "The error is the median torque error on another motion of the true robot,",
        "divided by the torque.",
        "",
        "| fault | use | with care | do not use | refused | error | named rightly "
        "| silently wrong |",
        "|---|---:|---:|---:|---:|---:|---:|---:|",
    ]
    for label in labels:
        of_label = [o for o in outcomes if o.trial.label == label]
        lines.append(row(label, of_label, sum(silent(o, clean) for o in of_label)))
    return "\n".join(lines) + "\n"


def trials(
    labels: Sequence[str], names: Sequence[str], seeds: Sequence[int], stride: int = 1
) -> Iterator[Trial]:
    """Yield every `stride`-th trial, and the clean ones of every robot and seed."""
    faulty = [
        Trial(name, label, seed)
        for label in labels
        if label not in CLEAN
        for name in names
        for seed in seeds
    ]
    whole = dict.fromkeys(["clean", *(label for label in labels if label in CLEAN)])
    yield from (Trial(name, k, seed) for k in whole for name in names for seed in seeds)
    yield from faulty[::stride]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 3])
    parser.add_argument("--faults", nargs="+", default=[*CLEAN, *CATALOGUE])
    parser.add_argument("--robots", nargs="+", default=list(robots()))
    parser.add_argument(
        "--stride", type=int, default=1, help="every so many-th of faults times robots"
    )
    parser.add_argument("--shell", action="store_true", help="exit codes of the shell")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--show", action="store_true", help="every log in words")
    parser.add_argument(
        "--quick", action="store_true", help="estimate only where nothing is found"
    )
    parser.add_argument("--results", type=Path, help="lines of JSON, to resume from")
    parser.add_argument(
        "--done", action="store_true", help="count what --results holds, run nothing"
    )
    parser.add_argument("--write", type=Path)
    options = parser.parse_args()
    every = list(trials(options.faults, options.robots, options.seeds, options.stride))
    if options.done:
        every = [trial for trial in every if trial in kept(options.results)]
    with ProcessPoolExecutor(options.workers) as pool:
        outcomes = work_through(every, pool, options.results, quick=options.quick)
        codes = list(pool.map(shelled, every)) if options.shell else []
    clean = baselines(outcomes)
    for outcome in outcomes:
        wrong = silent(outcome, clean) or not outcome.right
        alarm = outcome.trial.clean and (outcome.kinds or outcome.said != "use")
        if options.show or wrong or alarm:
            print(json.dumps([str(outcome.trial), outcome.said, *outcome.named]))
            print(f"    {outcome.error:.1%}  {outcome.words}", flush=True)
    text = page(outcomes, options.seeds, options.stride)
    for outcome, code in zip(outcomes, codes, strict=False):
        if silent(outcome, clean) or (code == 0) != outcome.said.startswith("use"):
            print(f"shell: {outcome.trial}: exit code {code}, {outcome.said}")
    print(text)
    spent = [outcome.seconds for outcome in outcomes]
    print(f"CPU s per log: median {np.median(spent):.1f}, most {max(spent):.1f}")
    if options.write:
        options.write.write_text(text)


if __name__ == "__main__":
    main()

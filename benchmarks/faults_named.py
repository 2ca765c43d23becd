"""How many faults of `faults_catalogue` the detective finds, and names rightly.

``python benchmarks/faults_named.py [--seeds 1 3] [--faults LABEL ...]`` puts each fault
into a log of each robot and looks at it as ``consistent-id check`` does.  Odd seeds are
for choosing thresholds; a published count takes even ones.
"""

import argparse
import time
import warnings
import zlib
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass

import numpy as np
from faults import UNNAMED
from faults_catalogue import CATALOGUE, CLEAN
from faults_experiment import experiment
from faults_robots import loaded, robots

import consistent_id as ci
from consistent_id.diagnosis import diagnose
from consistent_id.problems.file import PreparationTable
from consistent_id.problems.preparation import Log
from consistent_id.problems.stated_model import DEFAULT_DRIVE


@dataclass(frozen=True)
class Trial:
    """A fault of a robot's log, and what was said of it."""

    label: str
    robot: str
    seed: int
    kinds: tuple[str, ...] = ()
    words: str = ""
    seconds: float = 0.0

    @property
    def named(self) -> tuple[str, ...]:
        """The causes that were named, as faults or warnings."""
        return tuple(k for k in self.kinds if k not in UNNAMED)

    @property
    def wrong(self) -> tuple[str, ...]:
        """The causes that were named and are not the fault."""
        allowed = CATALOGUE[self.label][0] if self.label in CATALOGUE else ()
        return tuple(k for k in self.named if k not in allowed)


def prepared(raw: ci.Recording) -> ci.Recording:
    """Make a log uniform, low-pass and differentiate it."""
    table = PreparationTable(resample=raw.rate, motion_cutoff=10.0, torque_cutoff=10.0)
    (part,) = Log(raw, table).prepared()
    return part


def judged(trial: Trial) -> Trial:
    """Put the fault in, and look."""
    warnings.simplefilter("ignore")
    label, robot = trial.label, robots()[trial.robot]
    fault = CLEAN[label] if label in CLEAN else CATALOGUE[label][1]
    rng = np.random.default_rng([zlib.crc32(label.encode()), trial.seed])
    case = fault(experiment(robot, rng, loaded), rng)
    start = time.process_time()
    try:
        model = ci.TorqueModel(loaded(case.text), DEFAULT_DRIVE.terms)
        found = diagnose(model, case.log, prepare=prepared).suspicious
    except ci.ConsistentIdError as error:
        kind = f"refused: {type(error).__name__}"
        return Trial(label, robot.name, trial.seed, (kind,), str(error)[:150])
    seconds = time.process_time() - start
    words = "; ".join(
        f"{f.severity} {f.kind} ({f.where}, {f.score:.2f}): {f.statement[:230]}"
        for f in found
    )
    kinds = tuple(dict.fromkeys(f.kind for f in found))
    return Trial(label, robot.name, trial.seed, kinds, words, seconds)


def row(label: str, trials: Sequence[Trial]) -> str:
    """Return a fault's line of the table."""
    found = sum(bool(t.kinds) for t in trials)
    named = sum(bool(t.named) for t in trials)
    wrong = sum(bool(t.wrong) for t in trials)
    right = sum(bool(set(t.named) - set(t.wrong)) for t in trials)
    return f"| {label} | {len(trials)} | {found} | {named} | {right} | {wrong} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 3])
    parser.add_argument("--robots", nargs="+", default=list(robots()))
    parser.add_argument("--faults", nargs="+", default=[*CLEAN, *CATALOGUE])
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--words", action="store_true", help="what was said, of all")
    options = parser.parse_args()
    trials = [
        Trial(label, name, seed)
        for label in options.faults
        for seed in options.seeds
        for name in options.robots
    ]
    with ProcessPoolExecutor(options.workers) as pool:
        done = list(pool.map(judged, trials, chunksize=2))
    for t in done:
        if options.words or t.wrong or not t.kinds:
            print(f"{t.label}, {t.robot}, {t.seed}: {t.words or 'nothing'}")
    print("\n| fault | logs | found | named | rightly | wrongly |")
    print("|---|---:|---:|---:|---:|---:|")
    for label in options.faults:
        print(row(label, [t for t in done if t.label == label]))
    faulty = [t for t in done if t.label in CATALOGUE]
    print(row("all", faulty))
    causes = [k for t in faulty for k in t.named]
    wrong = [k for t in faulty for k in t.wrong]
    print(f"\ncauses named: {len(causes)}, of which wrong: {len(wrong)}")
    seconds = [t.seconds for t in done]
    print(f"CPU s per log: median {np.median(seconds):.2f}, most {max(seconds):.2f}")


if __name__ == "__main__":
    main()

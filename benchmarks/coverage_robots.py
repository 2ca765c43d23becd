"""How recordings of real robots agree: the second half of `coverage.py`."""

import os
from collections import Counter
from dataclasses import dataclass, replace
from itertools import combinations, pairwise

import numpy as np
from scipy import stats

import consistent_id as ci
from consistent_id.estimation.estimate import Estimate
from consistent_id.estimation.uncertainties.beyond_noise import ScatterCauses
from consistent_id.estimation.uncertainties.block_scatter import recording_scatter
from consistent_id.estimation.uncertainties.intervals import consistent_intervals
from consistent_id.regression.residual_noise import joint_noise, unconstrained_fit
from consistent_id.regression.segments import merged

UR10E = (
    "identification/ur-20_02_05-20sec_12harm.parquet",
    "identification/ur-20_02_06-20sec_10harm.parquet",
    "identification/ur-20_02_06-20sec_5harm.parquet",
    "identification/ur-20_02_10-20sec_7harm.parquet",
    "identification/ur-20_02_10-30sec_12harm.parquet",
    "identification/ur-20_02_12-40sec_12harm.parquet",
    "identification/ur-20_02_12-50sec_12harm.parquet",
    "identification/ur-20_02_19_14harm50sec.parquet",
    "identification/ur-20_02_19_15harm50sec.parquet",
    "validation/ur-20_02_05-20sec_8harm.parquet",
)
KUKA = ("FF_A.csv", "FF_B.csv")
KUKA_SPAN = (1.8, 8.2)  # s: the rest is standstill
TX40 = "identification/seg_0.0-4.5s.parquet"
TX40_BLOCKS = 2
TIAGO = ("identification/first60.parquet", "validation/last40.parquet")
PROBLEMS = ("ur10e", "kuka_kr300", "staubli_tx40", "tiago")
PARTS = (2, 4)  # of one recording
HELD = 0.88  # share of differences within 1.96 that is asked for
WIDEST = 1.3  # of the UR10e's intervals, over the width that holds 95 %
SPLITS = 5  # of the UR10e's recordings into two halves
MOVING = 0.02  # rad/s: slower than this at both ends is standstill


@dataclass(frozen=True)
class Agreement:
    """How recordings of one robot agree."""

    robot: str
    recordings: int
    z: tuple[float, ...]
    white_z: tuple[float, ...]
    pairs: int
    disjoint: int
    apart: tuple[str, ...]

    @property
    def row(self) -> str:
        """A row of the page's table."""
        within, white = _within(self.z), _within(self.white_z)
        return (
            f"| {self.robot} | {self.recordings} | {len(self.z)} | {white:.1%} | "
            f"{within:.1%} | {self.disjoint} of {self.pairs} |"
        )

    @property
    def missed(self) -> list[str]:
        """The targets that the recordings miss."""
        lines, within = [], _within(self.z)
        if within < HELD:
            lines.append(f"{self.robot}: {within:.1%}, target 88 % or more")
        if self.disjoint > 0.01 * self.pairs:
            share = self.disjoint / self.pairs
            names = ", ".join(f"{n} ({k})" for n, k in Counter(self.apart).items())
            lines.append(
                f"{self.robot}: {share:.1%} disjoint, target 1 % or less: {names}"
            )
        return lines


def _within(z: tuple[float, ...]) -> float:
    """Return the share of differences within 1.96 standard errors."""
    return float(np.mean(np.abs(z) <= stats.norm.ppf(0.975)))


@dataclass(frozen=True)
class Parts:
    """How halves or quarters of single recordings agree.

    Parameters
    ----------
    z, noise_z : tuple of float
        Differences over their standard errors: all of them, and those by noise alone.
    """

    robot: str
    recordings: int
    count: int
    z: tuple[float, ...]
    noise_z: tuple[float, ...]

    @property
    def width(self) -> float:
        """Width of intervals over the width that would contain 95 %."""
        needed = np.quantile(np.abs(self.z), 0.95)
        return float(stats.norm.ppf(0.975) / needed)

    @property
    def row(self) -> str:
        """A row of the page's table."""
        return (
            f"| {self.robot} | {self.recordings} | {self.count} | {len(self.z)} | "
            f"{_within(self.noise_z):.1%} | {_within(self.z):.1%} | {self.width:.2f} |"
        )

    @property
    def missed(self) -> list[str]:
        """The targets that the parts miss."""
        where, lines = f"{self.robot}, {self.count} parts", []
        if _within(self.z) < HELD:
            lines.append(f"{where}: {_within(self.z):.1%}, target {HELD:.0%} or more")
        if self.robot == "ur10e" and self.width > WIDEST:
            lines.append(f"{where}: {self.width:.2f} times as wide as needed")
        return lines


@dataclass(frozen=True)
class RealRobots:
    """What recordings of real robots show; nothing without them."""

    agreements: tuple[Agreement, ...] = ()
    halves: tuple[str, ...] = ()
    parts: tuple[Parts, ...] = ()

    @property
    def missed(self) -> list[str]:
        """All targets that are missed."""
        return [m for found in (*self.agreements, *self.parts) for m in found.missed]


def real_robots() -> RealRobots:
    """Return how recordings of real robots, halves and quarters of them agree."""
    if "CONSISTENT_ID_DATASETS" not in os.environ:
        return RealRobots()
    ur10e, kuka, tx40, tiago = (ci.load_problem(f"problems/{n}") for n in PROBLEMS)
    arm_logs = [_moving(ur10e.prepare(ur10e.read(file))) for file in UR10E]
    both = [kuka.prepare(kuka.read(file)) for file in KUKA]
    start, stop = KUKA_SPAN
    spans = [r.samples((r.time >= start) & (r.time <= stop)) for r in both]
    one = tx40.prepare(tx40.read(TX40))
    whole = (
        (ur10e, arm_logs),
        (kuka, spans),
        (tx40, [one]),
        (tiago, [tiago.prepare(tiago.read(file)) for file in TIAGO]),
    )
    return RealRobots(
        (
            agreement(ur10e, arm_logs),
            agreement(kuka, spans),
            agreement(tx40, cut(one, TX40_BLOCKS)),
        ),
        tuple(halves(ur10e, arm_logs, effect) for effect in (False, True)),
        tuple(
            parts(problem, logs, count) for problem, logs in whole for count in PARTS
        ),
    )


def cut(recording: ci.Recording, count: int) -> list[ci.Recording]:
    """Return equal parts of a recording, in the order of time."""
    ends = np.linspace(0, len(recording), count + 1).astype(int).tolist()
    return [recording.samples(slice(a, b)) for a, b in pairwise(ends)]


def parts(problem: ci.Problem, recordings: list[ci.Recording], count: int) -> Parts:
    """Compare estimates from parts of the same recording, pair by pair."""
    model, z, by_noise = problem.model, [], []
    base = ci.regression.base_parameters(model)
    for recording in recordings:
        regressions = [ci.build_regression(model, p) for p in cut(recording, count)]
        bare = [replace(r, noise=replace(r.noise, beyond=1.0)) for r in regressions]
        for own, found in ((regressions, z), (bare, by_noise)):
            found += _z(
                [ci.estimation.weighted_least_squares(model, r, base=base) for r in own]
            )
    return Parts(problem.name, len(recordings), count, tuple(z), tuple(by_noise))


def _moving(recording: ci.Recording) -> ci.Recording:
    """Cut the standstill off at both ends."""
    fast = np.flatnonzero((abs(recording.velocity) > MOVING).any(axis=1))
    return recording.samples(slice(int(fast[0]), int(fast[-1]) + 1))


def agreement(problem: ci.Problem, recordings: list[ci.Recording]) -> Agreement:
    """Compare estimates and intervals of recordings of one robot, pair by pair."""
    model = problem.model
    base = ci.regression.base_parameters(model)
    regressions = [ci.build_regression(model, r) for r in recordings]
    plain = [
        ci.estimation.weighted_least_squares(model, r, base=base) for r in regressions
    ]
    bare = [replace(r, noise=None) for r in regressions]
    white = [ci.estimation.weighted_least_squares(model, r, base=base) for r in bare]
    intervals = [
        consistent_intervals(
            model,
            r.weighted(estimate.sigma),
            constraints=problem.constraints,
            base=base,
        ).bounds
        for r, estimate in zip(regressions, plain, strict=True)
    ]
    pairs, apart = 0, []
    for a, b in combinations(intervals, 2):
        compared, disjoint = _apart(a, b)
        pairs += int(compared.sum())
        apart += [model.layout.names[i] for i in np.flatnonzero(disjoint)]
    return Agreement(
        problem.name,
        len(recordings),
        _z(plain),
        _z(white),
        pairs,
        len(apart),
        tuple(apart),
    )


def _z(estimates: list[Estimate]) -> tuple[float, ...]:
    """Return differences of base parameters over their standard errors."""
    found: list[float] = []
    for a, b in combinations(estimates, 2):
        error = np.hypot(a.standard_errors, b.standard_errors)
        z = (a.base_values - b.base_values) / error
        found.extend(z[np.isfinite(z) & (error > 0.0)].tolist())
    return tuple(found)


def halves(
    problem: ci.Problem, recordings: list[ci.Recording], random_effect: bool
) -> str:
    """Compare what halves of a robot's recordings say; return a row of the table."""
    model = problem.model
    base = ci.regression.base_parameters(model)
    parts = [ci.build_regression(model, r) for r in recordings]
    rng = np.random.default_rng(0)
    held, pairs, disjoint = [], 0, 0
    for _ in range(SPLITS):
        dealt = rng.permutation(len(parts))
        found = []
        for half in (dealt[::2], dealt[1::2]):
            own = [parts[k] for k in half]
            sigma = joint_noise(model, merged(own), base=base)
            own = [part.weighted(sigma) for part in own]
            whole = merged(own)
            noise = unconstrained_fit(whole, base).noise
            scatter = recording_scatter(model, own, base) if random_effect else None
            noise = noise if scatter is None else scatter.added_to(noise, own, base)
            estimate = ci.least_squares(model, whole, base=base)
            t = stats.t.ppf(0.975, noise.freedoms(np.eye(len(base))))
            variance = np.diag(noise.steps @ noise.scatter @ noise.steps.T)
            bounds = consistent_intervals(
                model,
                whole,
                constraints=problem.constraints,
                base=base,
                causes=ScatterCauses(noise),
            ).bounds
            found.append((estimate.base_values, t * np.sqrt(variance), bounds))
        (x, dx, a), (y, dy, b) = found
        held += (abs(x - y) <= np.hypot(dx, dy)).tolist()
        compared, beyond = _apart(a, b)
        pairs, disjoint = pairs + int(compared.sum()), disjoint + int(beyond.sum())
    kind = "with" if random_effect else "without"
    return f"| {kind} | {np.mean(held):.1%} | {disjoint} of {pairs} |"


def _apart(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return which pairs of intervals are compared, and which of them are disjoint."""
    bounded = np.isfinite(a).all(axis=1) & np.isfinite(b).all(axis=1)
    # An equality's value, the same in both, is no interval.
    compared = bounded & (a[:, 1] > a[:, 0]) & (b[:, 1] > b[:, 0])
    beyond = np.maximum(a[:, 0], b[:, 0]) > np.minimum(a[:, 1], b[:, 1])
    return compared, compared & beyond

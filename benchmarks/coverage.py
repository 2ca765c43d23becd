"""How often intervals hold the truth: simulated noise of five kinds, and real robots.

``python benchmarks/coverage.py [--replicates N] [--write docs/coverage.md]`` makes the
whole page, the tables of `coverage_methods`, `coverage_filtered` and `coverage_robots`
included; real recordings are read from ``CONSISTENT_ID_DATASETS``.
"""

import argparse
import sys
from dataclasses import replace
from pathlib import Path
from time import process_time

import numpy as np
from scipy import stats

sys.path.insert(0, str(Path(__file__).parent))
import coverage_filtered
import coverage_logs
import coverage_methods
from coverage_arm import DURATION, KINDS, LEVEL, arm, motion, noise
from coverage_methods import BEGIN, END, section, table
from coverage_robots import HELD, PROBLEMS, SPLITS, WIDEST, real_robots
from pages import measured

import consistent_id as ci
from consistent_id.estimation.estimate import Estimate
from consistent_id.estimation.uncertainties.intervals import consistent_intervals
from consistent_id.regression.residual_noise import unconstrained_fit

STATIONARY = KINDS[:3]
METHODS = ("least squares", "weighted least squares", "Huber", "constrained")


def covered(
    model: ci.TorqueModel, truth: np.ndarray, kind: str, replicates: int, few: int
) -> dict[str, tuple[float, float]]:
    """Return, by method, the share of intervals that hold the truth, and its error.

    Intervals of one data set hang together; the error is that of the mean over sets.
    """
    base = ci.regression.base_parameters(model)
    clean = ci.simulate_torque(model, truth, motion(model))
    size = LEVEL * clean.torque.std(axis=0)
    rng = np.random.default_rng(1)
    found: dict[str, list[float]] = {method: [] for method in METHODS}
    for k in range(replicates):
        shaken = clean.torque + size * noise(kind, clean, rng)
        log = replace(clean, torque=shaken)
        regression = ci.build_regression(model, log)
        estimates = [
            ci.least_squares(model, regression, base=base),
            ci.estimation.weighted_least_squares(model, regression, base=base),
        ]
        if k < few:
            estimates.append(ci.huber(model, log, base=base))
        for method, estimate in zip(METHODS, estimates, strict=False):
            weighed = method == "weighted least squares"
            own = regression.weighted(estimate.sigma) if weighed else regression
            width = (
                stats.norm.ppf(0.975)
                if method == "Huber"
                else unconstrained_fit(own, base).noise.quantiles
            )
            found[method].append(_share(estimate, base.projection @ truth, width))
        if k < few:
            weighted = regression.weighted(estimates[1].sigma)
            low, high = consistent_intervals(model, weighted, base=base).bounds.T
            bounded = np.isfinite(low) & np.isfinite(high) & (high > low)
            inside = (low <= truth) & (truth <= high)
            found["constrained"].append(float(np.mean(inside[bounded])))
    return {
        method: (float(np.mean(s)), float(np.std(s, ddof=1) / np.sqrt(len(s))))
        for method, s in found.items()
    }


def _share(estimate: Estimate, truth: np.ndarray, width: np.ndarray | float) -> float:
    error = abs(estimate.base_values - truth)
    return float(np.mean(error <= width * estimate.standard_errors))


def page(replicates: int, few: int, others: int, logs: int, before: str = "") -> str:
    """Measure everything; return the page.

    Tables of other estimates and of raw logs are those of the page before where the
    number of their data sets is zero.
    """
    started = process_time()
    rows, missed = simulated(replicates, few)
    found = real_robots()
    methods = _between(before, BEGIN, END)
    if others:
        methods = section(table(others))
    raw = _between(before, coverage_logs.BEGIN, coverage_logs.END)
    if logs:
        raw = coverage_logs.section(logs)
    missed += found.missed
    missed += coverage_logs.missed(raw) + coverage_methods.missed(methods)
    said = "\n".join(f"- {line}" for line in missed) or "Every target is met."
    script = (
        f"coverage.py --replicates {replicates} --few {few} --others {others} "
        f"--logs {logs}"
    )
    return TEMPLATE.format(
        measured=measured(PROBLEMS if found.agreements else (), script=script),
        replicates=replicates,
        few=few,
        others=others,
        filtered=coverage_filtered.section(replicates),
        logs=raw,
        methods=methods,
        simulated="\n".join(rows),
        real="\n".join(r.row for r in found.agreements) or "| not measured | | | | | |",
        parts="\n".join(p.row for p in found.parts) or "| not measured | | | | | | |",
        missed=said,
        halved="\n".join(found.halves) or "| not measured | | |",
        splits=SPLITS,
        held=f"{HELD:.0%}",
        widest=WIDEST,
        level=f"{LEVEL:.0%}",
        duration=f"{DURATION:.0f}",
        seconds=f"{process_time() - started:.0f}",
    )


def _between(page: str, begin: str, end: str) -> str:
    """Return the part of a page between two marks, marks included."""
    _, _, rest = page.partition(begin)
    return f"{begin}{rest.partition(end)[0]}{end}"


def simulated(replicates: int, few: int) -> tuple[list[str], list[str]]:
    """Return the table's rows of simulated arms, and the targets that they miss."""
    rows, missed = [], []
    for joints in (2, 3, 6):
        model, truth = arm(joints)
        for kind in KINDS:
            shares = covered(model, truth, kind, replicates, few)
            cells = (f"{s:.1%} ± {e:.1%}" for s, e in shares.values())
            rows.append(f"| {joints} joints | {kind} | {' | '.join(cells)} |")
            if kind in STATIONARY:
                missed += _missed(f"{joints} joints, {kind}", shares)
    return rows, missed


def _missed(where: str, shares: dict[str, tuple[float, float]]) -> list[str]:
    """Return the targets that shares of intervals miss under stationary noise."""
    missed = [
        f"{where}, {method}: {shares[method][0]:.1%}, target 93 to 97 %"
        for method in METHODS[:2]
        if abs(shares[method][0] - 0.95) > 0.02
    ]
    constrained = shares["constrained"][0]
    if constrained < 0.93:
        missed.append(f"{where}, constrained: {constrained:.1%}, target 93 % or more")
    return missed


TEMPLATE = """# How often intervals contain the truth

{measured}.
The run took {seconds} CPU seconds.

## Simulated noise

Arms of two, three and six joints move for {duration} s; noise is {level} of each
torque. For least squares (equal weights and by joint), the figure is the share of base
parameters whose 95 % interval contains the truth, with Student's quantile for the
[degrees of freedom](uncertainty.md) of the noise's spectrum: the median is 2.1 to 2.4
standard errors either way. For Huber's estimate it is the share within 1.96 standard
errors. For the constrained fit, it is the share of bounded 95 % intervals by profile likelihood
that contain the true standard parameter. There are {replicates} data sets for least
squares, and {few} for Huber's estimate and the constrained fit. Parameters of one set
are correlated, so the error of each figure is computed from the means of the sets.

Targets: least squares 93 to 97 % under stationary noise (the first three kinds),
constrained 93 % or more.

| arm | noise | least squares | weighted | Huber | constrained |
|---|---|---:|---:|---:|---:|
{simulated}

Outliers are 1 % of samples, twenty deviations high. Unmodelled friction is a Stribeck
peak of five deviations that the model does not have: its error is not noise.
[Errors of the model](uncertainty.md#errors-of-the-model-within-a-recording) widen
intervals of least squares and of consistent robots, but where such friction takes most
of the misfit, they are still too narrow. Huber's standard errors are for noise alone.

## Raw logs

Published arms with other bodies than the file's, friction, rotor inertias and offsets
move at random. Positions are read in steps of 2^-19 turns, torque has noise of 2 %.
`draft_problem` finds velocities, cut-offs and drive terms, and trains on 7.7 s of a log
of 20 s and on 3.5 s of one of 5 s. The table counts 95 % intervals of base parameters
of weighted least squares, and of the standard parameters of the constrained estimate
that have one. The target is 93 to 97 %. Pink noise has most of its power in the motion's
slowest harmonics, where a log of 20 s shows it in a few periods only. So the noise's
spectrum is uncertain there, and intervals are wider than 1.96 standard errors: the
sentence on standard errors states by how much. A standard error of the constrained
estimate knows the constraints that are active. In a log of 5 s, noise would often move
the estimate to others, so that its intervals are too wide; those of `--uncertainty`, by
profile likelihood, know all constraints.

{logs}

## Filtered torque

The arm of three joints and a UR10 with dry friction that changes its sign within 0.02
rad/s; speeds are about 1 rad/s. Torque passes `low_passed`, and `build_regression`
filters the rows alike. Base parameters are those of weighted least squares. The target
is 93 to 97 %.

{filtered}

## Other estimates

The arm of three joints, in raw logs: positions in steps of 2^-19 turns, torque with
noise. A draft is made for every twentieth log, and all are prepared as it says, as
[above](#raw-logs). A payload of 2 kg has its ten parameters. Instruments are the exact
motion, prepared as the log is, whose encoders have steps of 2^-16 turns. A spring is
sought in motion up to 3.6 Hz, prepared as `rollout` does before it chooses a cut-off (10
Hz); a cut-off within the motion's band makes springs
[wrong](rollout.md#the-problem-file). The zero of a joint is off by 15°, the base leans by
12°, clock and gains are off by the factor 1.4, and bodies differ from the nominal ones by
their usual errors. Torque by commands is computed from positions in steps, before both
are filtered; delays of commands count beside their mean over the logs. Blocks of a motion
are those of `rollout`: parameters of drives, and the same of one later block. A fleet has
four robots, one of them with a load. A walking robot has its base measured, and the
contact forces are taken out; the radius of its feet is stated 0.4 mm too large. The
errors that designs predict belong to no log: they are for white noise, or for the
correlation that is stated, for sensors by `Aim(correlation_time=)`, and for feet by the
rate, since noise correlated over `n` samples is white at a rate `n` times lower. AR(1)
0.9 is stated as 19 samples. Both columns should be 93 to 97 %; the last one is the
parameter that is farthest off.

Some rows miss that, as the [end of this page](#missed-targets) lists. Why:

- Pink noise. No log shows noise that is slower than itself. During a walk of 12 s it moves
  parameters whose torque hardly changes, such as a hip's first moment or the radius of a
  foot, by more than their errors say. Gains, delays and loads have errors that allow for
  an uncertain spectrum, and are rather too large.
- Bounds. Fleets and loads are physically consistent, and their errors know only the
  constraints that are active, as above: they are too large where noise would move an
  estimate to others.
- Designs. Noise that a design is told as white noise of a lower rate is less than that at
  the frequencies of the motion.
- Slopes on nominal torque have errors from 20 segments of the log, too few where noise is
  correlated over much of a segment.

{methods}

## Figures with ±

| figure | printed by | measured |
|---|---|---|
| base and standard parameters, `small (± %)` | tables, report, JSON, notes of exports | simulated noise, raw logs, real robots, parts of a recording |
| intervals of consistent robots | `--uncertainty` | simulated noise, real robots |
| scatter between recordings | `--uncertainty` | [uncertainty](uncertainty.md#several-recordings) |
| load | `payload` | payload; [what is it carrying?](payload.md#how-well-it-is-weighed) |
| gains between currents and torque | `gains`, `payload --known-mass` | drive gains |
| zero, gain of a joint, clock, lean | findings | the rows of these names |
| slope on nominal gravity or inertial torque | findings | slope on nominal torque; bodies other than nominal are not in its error |
| delay between two channels | findings, drafts | delay |
| delay of commands, scales of torque, encoder biases | `rollout`, problem files | delay of commands, drive calibration |
| stiffness of a gear | problem files | spring of a gear |
| parameters of drives beside blocks of a motion | `rollout` | blocks of a motion; [rollout](rollout.md) |
| shared and carried bodies | `fleet` | fleet |
| robot on its feet, radius of feet, delay of its torque | `identify` | robot on its feet, radius of feet |
| errors that a design predicts | `excite`, `rehearse` | design on feet, design on a wrist sensor; [rehearsal](rehearsal.md) |

Five figures are not measured here. The delay in `rollout` has the scatter between blocks
of the motion, and not errors of the model. The drift of a residual counts independent
samples alone. The share that a choice of `select` takes off has the standard error over
blocks, but it was chosen because it is large. Parameters of a [servo](servos.md) are
measured [on its page](servos.md#do-the-intervals-hold): their intervals are too wide for
plain friction, and too narrow for friction near rest. Gains that the model's bodies imply
assume usual errors of these bodies, which a log cannot show.

## Real robots

Each recording (for the TX40, each half of its only one) is fitted by weighted least
squares. Differences of base parameters between two recordings are divided by their
standard errors; 95 % should be within 1.96. The column of white noise is for
comparison. The last column counts pairs of 95 % intervals of one standard parameter
that have no value in common.

Targets: 88 % or more within 1.96; 1 % or less disjoint.

| robot | recordings | differences | within 1.96, white noise | within 1.96 | disjoint |
|---|---:|---:|---:|---:|---:|
{real}

## Parts of one recording

Each recording is cut into two halves or four quarters of equal length, each of which is
fitted by itself. Differences of base parameters between two parts of one recording are
divided by their standard errors, by noise alone and with
[errors of the model](uncertainty.md#errors-of-the-model-within-a-recording). The last
column is the width of intervals over the width that would contain 95 % of the differences.

Targets: {held} or more within 1.96; the UR10e's width {widest} or less.

| robot | recordings | parts | differences | within 1.96, noise | within 1.96 | width |
|---|---:|---:|---:|---:|---:|---:|
{parts}

## Halves of ten recordings

The UR10e's ten recordings are divided into two halves, {splits} times. The table
counts the base parameters whose difference is within the combined 95 % intervals of
both halves (errors assumed independent), without and with scatter between recordings
as a [random effect](uncertainty.md).

| scatter between recordings | differences within | disjoint |
|---|---:|---:|
{halved}

## Missed targets

{missed}

Single recordings differ mostly in friction and in parameters that compensate for it.
A recording depends on its own temperature and motion, and does not show how much
another one would differ. Only several recordings show this.
"""  # noqa: E501


def main() -> None:
    """Measure, and print or write the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--replicates", type=int, default=200)
    parser.add_argument("--few", type=int, default=20)
    parser.add_argument("--write", type=Path)
    parser.add_argument("--others", type=int, default=200, help="0: as on the page")
    parser.add_argument("--logs", type=int, default=200, help="0: as on the page")
    options = parser.parse_args()
    before = options.write.read_text() if options.write else ""
    counts = options.replicates, options.few, options.others, options.logs
    text = page(*counts, before)
    if options.write is None:
        print(text)
    else:
        options.write.write_text(text)


if __name__ == "__main__":
    main()

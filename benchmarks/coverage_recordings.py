"""How often intervals with scatter between recordings hold the truth.

``python benchmarks/coverage_recordings.py [--replicates 200]
[--write docs/uncertainty.md]``

The three-jointed arm of `coverage` records two, three or six motions.  Its friction
differs between recordings: each parameter on its own, or all by one factor, as with
temperature.  A standard error is for the parameters' mean over recordings.
"""

import argparse
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy import stats

sys.path.insert(0, str(Path(__file__).parent))
from coverage import LEVEL, arm
from coverage_methods import noise

import consistent_id as ci
from consistent_id.estimation.uncertainties.block_scatter import recording_scatter
from consistent_id.regression.residual_noise import joint_noise, unconstrained_fit
from consistent_id.regression.segments import merged
from consistent_id.regression.torque_along import predicted_torque

COUNTS = (2, 3, 6)
CHANGES = ("each its own", "all by one factor", "none")
KINDS = ("white", "AR(1) 0.9")
CHANGE = 0.15  # standard deviation of friction between recordings, over its value
RATE, DURATION = 100, 15.0  # Hz, s
_BEGIN, _END = "<!-- recordings: begin -->", "<!-- recordings: end -->"


def motion(model: ci.TorqueModel, rng: np.random.Generator) -> ci.Recording:
    """Return sums of sines of up to half a hertz, with exact derivatives."""
    n, time = len(model.robot), np.arange(round(RATE * DURATION)) / RATE
    rates = 2 * np.pi * np.arange(1, 6) / 10
    sizes = rng.normal(size=(n, 5)) / np.arange(1, 6)
    angles = np.outer(time, rates)[None] + rng.uniform(0, 6, (n, 1, 5))
    state = (np.sin(angles), rates * np.cos(angles), -(rates**2) * np.sin(angles))
    parts = (np.einsum("jtk,jk->tj", part, sizes) for part in state)
    return ci.Recording(model.robot.joint_names, time, *parts)


def errors(
    count: int, change: str, kind: str, replicates: int
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield errors of base parameters over half their 95 % intervals, and widths.

    The widths are relative to half the interval of noise alone.
    """
    model, truth = arm(3)
    base = ci.regression.base_parameters(model)
    bodies = model.layout.inertial_size
    rng = np.random.default_rng(count)
    for _ in range(replicates):
        parts = []
        for _ in range(count):
            own = truth.copy()
            drives = len(truth) - bodies
            if change == "each its own":
                own[bodies:] *= 1.0 + CHANGE * rng.normal(size=drives)
            elif change == "all by one factor":
                own[bodies:] *= 1.0 + CHANGE * rng.normal()
            states = motion(model, rng)
            exact = predicted_torque(model, own, states)
            shaken = LEVEL * exact.std(axis=0) * noise(kind, exact.shape, rng)
            log = replace(states, torque=exact + shaken)
            parts.append(ci.build_regression(model, log))
        sigma = joint_noise(model, merged(parts), base=base)
        parts = [part.weighted(sigma) for part in parts]
        whole = merged(parts)
        alone = unconstrained_fit(whole, base)
        scatter = recording_scatter(model, parts, base)
        assert scatter is not None
        full = scatter.added_to(alone.noise, parts, base)
        off = alone.solution.x - base.projection @ truth
        each = np.eye(len(base))
        size, bare = (
            stats.t.ppf(0.975, n.freedoms(each))
            * np.sqrt(np.diag(n.steps @ n.scatter @ n.steps.T))
            for n in (full, replace(alone.noise, between=()))
        )
        yield off / size, size / bare


def rows(replicates: int) -> Iterator[str]:
    """Yield the rows of the table."""
    model, _ = arm(3)
    base = ci.regression.base_parameters(model)
    friction = np.array(base.independent) >= model.layout.inertial_size
    for change in CHANGES:
        for kind in KINDS:
            for count in COUNTS:
                found = list(errors(count, change, kind, replicates))
                z, width = (np.array(part) for part in zip(*found, strict=True))
                cells = []
                for own in (friction, ~friction):
                    inside = np.mean(abs(z[:, own]) <= 1.0, axis=1)
                    error = inside.std(ddof=1) / np.sqrt(len(inside))
                    cells.append(f"{inside.mean():.1%} ± {error:.1%}")
                    cells.append(f"{np.median(width[:, own]):.1f}")
                yield f"| {count} | {change} | {kind} | {' | '.join(cells)} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--replicates", type=int, default=200)
    parser.add_argument("--write", type=Path, help="a page with marks for the table")
    options = parser.parse_args()
    lines = [
        "| recordings | friction changes | noise "
        "| friction | width | inertial | width |",
        "|--:|---|---|--:|--:|--:|--:|",
    ]
    for row in rows(options.replicates):
        lines.append(row)
        print(row, flush=True)
    if options.write:
        before, _, rest = options.write.read_text().partition(_BEGIN)
        _, _, after = rest.partition(_END)
        said = f"{options.replicates} data sets for each row."
        table = "\n".join([said, "", *lines])
        options.write.write_text(f"{before}{_BEGIN}\n\n{table}\n\n{_END}{after}")


if __name__ == "__main__":
    main()

"""Staubli TX40: five blocks of its one recording, held out in turn.

Settings are those of ``problems/staubli_tx40``, but for the velocity scale of friction,
which each fold chooses anew from the problem's series on its training data.
"""

from dataclasses import dataclass, replace

from pairs import stacked_error

import consistent_id as ci

FILE = "identification/seg_0.0-4.5s.parquet"
COUNT = 5
GUARD = 0.1  # s: four periods of the cut-off, 44 Hz
SCALES = (0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5)  # rad/s


@dataclass(frozen=True, slots=True, eq=False)
class Blocks:
    """What each method makes of blocks that it has not seen.

    Parameters
    ----------
    spans : tuple of (float, float), [s]
        From when to when each block lasts.
    scales : tuple of float, [rad/s]
        Velocity scale that each fold chose.
    errors : dict of str to list of float
        By method, stacked error on each block.
    overall : dict of str to float
        Stacked error over all blocks.
    bodies : dict of str to int
        Physically consistent links, over all folds.
    links : int
        Their number.
    """

    spans: tuple[tuple[float, float], ...]
    scales: tuple[float, ...]
    errors: dict[str, list[float]]
    overall: dict[str, float]
    bodies: dict[str, int]
    links: int


def measure() -> Blocks:
    """Hold out one block after another."""
    problem = ci.load_problem("problems/staubli_tx40")
    recording = problem.prepare(problem.read(FILE))
    folds = ci.signals.blocked_folds(recording, COUNT, guard=GUARD)
    scales, tested, fits, bodies = [], [], {}, {}
    for fold in folds:
        scale, model = chosen(problem.model, fold.training)
        scales.append(scale)
        tested.append(ci.build_regression(model, fold.held_out))
        shaped = replace(problem, model=model)
        for estimate in ci.Study(shaped, recordings=(fold.training, ())).estimates:
            x, method = estimate.parameters, estimate.method
            fits.setdefault(method, []).append(x)
            good = sum(
                link.consistent for link in ci.constraints.link_conditions(model, x)
            )
            bodies[method] = bodies.get(method, 0) + good
    return Blocks(
        spans=tuple((f.held_out.time[0], f.held_out.time[-1]) for f in folds),
        scales=tuple(scales),
        errors={
            method: [stacked_error([r], [x]) for r, x in zip(tested, xs, strict=True)]
            for method, xs in fits.items()
        },
        overall={method: stacked_error(tested, xs) for method, xs in fits.items()},
        bodies=bodies,
        links=COUNT * len(problem.model.robot),
    )


def chosen(
    model: ci.TorqueModel, training: tuple[ci.Recording, ...]
) -> tuple[float, ci.TorqueModel]:
    """Return the velocity scale with the least training error of least squares."""

    def error(scale: float) -> float:
        shaped = scaled(model, scale)
        regression = ci.build_regression(shaped, training)
        x = ci.least_squares(shaped, regression).parameters
        return stacked_error([regression], [x])

    best = min(SCALES, key=error)
    return best, scaled(model, best)


def scaled(model: ci.TorqueModel, scale: float) -> ci.TorqueModel:
    """Return the model with one velocity scale for all joints and couplings."""
    return ci.regression.with_shapes(
        model, {shape.name: scale for shape in ci.regression.shapes_of(model)}
    )


def section(found: Blocks, shown: dict[str, str]) -> list[str]:
    """Return the page's section on blocks; methods as shown, by name."""
    spans = [f"{start:.1f} to {stop:.1f} s" for start, stop in found.spans]
    rows = [
        f"| {label} | {found.overall[m]:.2%} "
        f"| {' | '.join(f'{error:.2%}' for error in found.errors[m])} "
        f"| {found.bodies[m]} of {found.links} |"
        for m, label in shown.items()
    ]
    return [
        f"## staubli_tx40, {COUNT} blocks",
        "",
        f"Its only recording is divided into {COUNT} blocks; each is predicted after",
        f"training on all others. {GUARD} s on either side of the block are not used",
        "for training; within this time, the response of the filters (50 Hz,",
        "zero-phase) to the block decays to six parts in a million. Each fold",
        "cross-validates its prior's weight and chooses the",
        "velocity scale of friction on its training data:",
        f"{', '.join(f'{scale:g}' for scale in found.scales)} rad/s.",
        "",
        f"| method | all blocks | {' | '.join(spans)} | consistent links |",
        "|---|" + "---:|" * (len(spans) + 2),
        *rows,
        "",
    ]

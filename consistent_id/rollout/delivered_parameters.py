"""Parameters that a rollout delivers: values, intervals, scatter of the motion."""

from consistent_id._support.tables import Table
from consistent_id.estimation.estimate import Estimate
from consistent_id.estimation.estimate_file import finite_or_none
from consistent_id.estimation.uncertainties.block_scatter import BlockScatter

_DIGITS = (4, 2, 2)  # of a value and its errors


def delivered_parameters(
    estimate: Estimate, scatter: BlockScatter
) -> dict[str, dict[str, float | None]]:
    """Return values and errors of the parameters that are not fixed, by name.

    Parameters
    ----------
    estimate : Estimate
    scatter : BlockScatter
        Of its model's parameters between blocks of the motion.

    Returns
    -------
    dict
        ``value``; ``half_interval``, half of the 95 % interval, None where the data do
        not determine the value; and ``between``, the standard deviation of least
        squares between blocks, beyond noise.
    """
    layout, half = estimate.model.layout, estimate.half_intervals
    found: dict[str, dict[str, float | None]] = {}
    for name, between in zip(scatter.names, scatter.between.tolist(), strict=True):
        place = layout.index(name)
        found[name] = {
            "value": float(estimate.parameters[place]),
            "half_interval": None if half is None else finite_or_none(half[place]),
            "between": between,
        }
    return found


def parameter_table(estimate: Estimate, scatter: BlockScatter) -> Table:
    """Return `delivered_parameters` for people."""
    rows = [
        (
            name,
            *(
                _short(x, digits)
                for x, digits in zip(own.values(), _DIGITS, strict=True)
            ),
        )
        for name, own in delivered_parameters(estimate, scatter).items()
    ]
    inertial = set(estimate.model.layout.names[: estimate.model.layout.inertial_size])
    given = "" if inertial & set(scatter.names) else ", given the file's bodies"
    return Table(
        f"Parameters of the delivered estimate ({estimate.method}){given}",
        ("parameter", "value", "95 % +-", "between blocks"),
        tuple(rows),
        (
            "intervals contain the error of the delay and, after a refinement, how far "
            "it moved the value; -: the data do not determine it",
            f"between {scatter.blocks} blocks of the motion: standard deviation of "
            "least squares, beyond noise; a motion as long as a block may differ so",
        ),
    )


def _short(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}g}"

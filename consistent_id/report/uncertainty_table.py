"""How sure each parameter is, in a table for people."""

import numpy as np

from consistent_id._support.tables import Table
from consistent_id.comparison.parameter_scatter import FEW
from consistent_id.comparison.parameter_uncertainty import (
    ParameterUncertainty,
    Uncertainty,
)
from consistent_id.comparison.recording_scatter import RecordingScatter


def uncertainty_table(found: Uncertainty) -> Table:
    """Return the uncertainty of each parameter of the constrained estimate."""
    resampled, several = found.bootstrap, found.recordings is not None
    return Table(
        "Uncertainty of the constrained estimate",
        (
            "parameter",
            "value",
            "standard error",
            *(["between recordings"] if several else []),
            "bootstrap 95 %",
            "any consistent robot",
            "unit",
            "verdict",
        ),
        tuple(
            (
                p.name,
                f"{p.value:.4g}",
                error_text(p),
                *([between_text(p)] if several else []),
                _interval(p.resampled),
                _interval(p.consistent),
                p.unit,
                p.verdict,
            )
            for p in found.parameters
        ),
        (
            f"bootstrap: {len(resampled.estimates)} estimates from segments drawn "
            f"anew, {resampled.certified} certified, {resampled.failed} failed"
            + ("; interrupted" if resampled.interrupted else ""),
            f"any consistent robot: {found.intervals.meaning}",
            found.scatter,
            *([scatter_text(found.recordings)] if found.recordings else []),
            "the standard error holds scatter and bias by the prior; where a prior "
            "determines a parameter there is none: only the interval shows what is "
            "known",
            "where a link is on the boundary of the consistency cone with a small "
            "multiplier, the standard error is too small; the bootstrap is not",
        ),
    )


def scatter_text(found: RecordingScatter) -> str:
    """Say what the scatter between recordings is, and how well it is known."""
    return (
        f"between recordings: standard deviation from one of {found.recordings} "
        "recordings to another, beyond noise (a random effect); standard errors and "
        "intervals contain it, the bootstrap does not. It has "
        f"{found.freedom:.0f} degrees of freedom"
        + ("; they are few, so that it is rough" if found.freedom < FEW else "")
    )


def between_text(p: ParameterUncertainty) -> str:
    """Return a parameter's scatter between recordings, where it means something."""
    if np.isnan(p.between_recordings):
        return "-"
    return f"{p.between_recordings:.2g}"


def error_text(p: ParameterUncertainty) -> str:
    """Return a standard error for people; a dash where it means nothing."""
    return f"{p.standard_error:.2g}" if np.isfinite(p.standard_error) else "-"


def _interval(ends: tuple[float, float]) -> str:
    return f"{ends[0]:.4g} to {ends[1]:.4g}"

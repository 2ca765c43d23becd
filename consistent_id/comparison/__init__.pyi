from consistent_id.comparison.comparison import Comparison, compare
from consistent_id.comparison.constraint_prices import (
    ShadowPrice,
    constraint_costs,
    shadow_prices,
)
from consistent_id.comparison.feasibility import base_feasibility
from consistent_id.estimation.uncertainties.intervals import (
    ConsistentIntervals,
    consistent_intervals,
)
from consistent_id.estimation.uncertainties.parameter_uncertainty import (
    Uncertainty,
    uncertainty,
)
from consistent_id.estimation.uncertainties.resampling import Bootstrap, bootstrap

__all__ = [
    "Bootstrap",
    "Comparison",
    "ConsistentIntervals",
    "ShadowPrice",
    "Uncertainty",
    "base_feasibility",
    "bootstrap",
    "compare",
    "consistent_intervals",
    "constraint_costs",
    "shadow_prices",
    "uncertainty",
]

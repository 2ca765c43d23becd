"""Values that a rollout delivers, beside the scatter between blocks of the motion."""

from types import SimpleNamespace

import numpy as np

from consistent_id.estimation.uncertainties.block_scatter import BlockScatter
from consistent_id.rollout.delivered_parameters import (
    delivered_parameters,
    parameter_table,
)


def test_delivered_values_and_errors_are_shown():
    """The values are those that are delivered, and not those of the scatter."""
    names, zero = ("link1.m", "joint1.viscous"), [0.0, 0.0]
    known = BlockScatter(names, [7.0, 7.0], zero, [8.0, 0.25], 4, [np.inf] * 2)
    delivered = SimpleNamespace(
        model=SimpleNamespace(layout=list(names)),
        method="constrained",
        parameters=np.array([10.0, 2.5]),
        half_intervals=np.array([np.nan, 0.125]),
    )
    record = delivered_parameters(delivered, known)
    assert record["link1.m"] == {"value": 10.0, "half_interval": None, "between": 8.0}
    assert record["joint1.viscous"]["half_interval"] == 0.125
    shown = parameter_table(delivered, known)
    assert "delivered estimate (constrained)" in shown.title
    assert "between 4 blocks" in shown.notes[1]
    assert shown.rows[0] == ("link1.m", "10", "-", "8")
    assert shown.rows[1] == ("joint1.viscous", "2.5", "0.12", "0.25")
    delivered.half_intervals = None
    assert delivered_parameters(delivered, known)["link1.m"]["half_interval"] is None

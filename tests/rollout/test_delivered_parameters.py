"""Values that a rollout delivers, beside the scatter between blocks of the motion."""

from types import SimpleNamespace

import numpy as np

from consistent_id.estimation.uncertainties.block_scatter import BlockScatter
from consistent_id.rollout.delivered_parameters import (
    delivered_parameters,
    parameter_table,
)


class Layout(list):
    """Names of parameters, of which the first is of a body."""

    names, inertial_size = property(list), 1


def test_delivered_values_and_errors_are_shown():
    """The values are those that are delivered, and not those of the scatter."""
    names, zero = ("link1.m", "joint1.viscous"), [0.0, 0.0]
    known = BlockScatter(names, [7.0, 7.0], zero, [8.0, 0.25], 4, [np.inf] * 2)
    delivered = SimpleNamespace(
        model=SimpleNamespace(layout=Layout(names)),
        method="constrained",
        parameters=np.array([10.0, 2.5]),
        half_intervals=np.array([np.nan, 0.125]),
    )
    record = delivered_parameters(delivered, known)
    assert record["link1.m"] == {"value": 10.0, "half_interval": None, "between": 8.0}
    assert record["joint1.viscous"]["half_interval"] == 0.125
    shown = parameter_table(delivered, known)
    assert shown.title == "Parameters of the delivered estimate (constrained)"
    assert "between 4 blocks" in shown.notes[1]
    assert shown.rows[0] == ("link1.m", "10", "-", "8")
    assert shown.rows[1] == ("joint1.viscous", "2.5", "0.12", "0.25")
    drives = BlockScatter(names[1:], [7.0], [0.0], [0.25], 4, [np.inf])
    assert "given the file's bodies" in parameter_table(delivered, drives).title
    delivered.half_intervals = None
    assert delivered_parameters(delivered, known)["link1.m"]["half_interval"] is None

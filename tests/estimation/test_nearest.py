"""The search for the weight that uses up the slack, on laws written by hand."""

import re

import numpy as np
import pytest
from logged import DRIVE, URDF, moved
from some_fast import some_fast

from consistent_id import (
    FixedMasses,
    PhysicalConsistency,
    TorqueModel,
    build_regression,
    constrained_least_squares,
    differentiated,
)
from consistent_id.constraints import PointToSet
from consistent_id.estimation.nearest import _WeightSearch
from consistent_id.robot import load_urdf


def tries(law, start=0.0, most=30, share=0.95, **options):
    """Return how many weights are tried until a share of the slack is used, or all."""
    search = _WeightSearch(start)
    for number in range(1, most + 1):
        used = law(np.exp(search.log_weight))
        if share <= used <= 1.0:
            return number
        search = search.narrowed(used, **options)
    return np.inf


@pytest.mark.parametrize("end", [-15.0, -2.0, 0.0, 3.0, 12.0])
@pytest.mark.parametrize("power", [1.0, 1.5, 2.0])
def test_a_power_law_takes_few_tries_from_either_side(end, power):
    # A small weight moves the estimate in proportion, and the misfit by its square.
    # Steps of a factor of 1000 at the most, a bracket, and one or two more.
    assert tries(lambda w: (w / np.exp(end)) ** power) <= 4 + abs(end) / np.log(1e3)


def test_a_law_that_bends_takes_few_tries():
    # The square of the weight while it is small, then less and less: as of real logs.
    def law(w):
        return 40.0 * w**2 / (1.0 + w) ** 1.5

    assert tries(law, start=-6.0) <= 6
    assert tries(law, start=6.0) <= 6


def test_a_share_that_rests_below_the_slack_is_left_soon():
    # As of few data: the nominal robot almost fits, and beyond it nothing happens long.
    def law(w):
        return 0.63 * w / (w + 1e-8) + 0.5 * w

    assert tries(law, start=-18.0) <= 18  # in steps of like length, 28


def test_what_is_aimed_at_is_used():
    found = tries(lambda w: w**1.5, start=-4.0, share=0.995, aim=0.997)
    assert found <= 6


def test_a_misfit_that_never_uses_up_the_slack_raises_the_weight_without_end():
    search = _WeightSearch(0.0)
    for _ in range(5):
        raised = search.narrowed(0.0)
        assert raised.log_weight > search.log_weight + 1.0
        search = raised


@pytest.mark.parametrize("slack", some_fast([1e-17, None, 1e-300]))
@pytest.mark.parametrize("scale", some_fast([1.0, 1e4]))
def test_a_slack_below_rounding_gives_the_best_fit_and_no_foreign_error(
    tmp_path, slack, scale
):
    """Lengths in other units, and torque without noise, leave hardly any slack."""
    urdf = tmp_path / "arm.urdf"
    urdf.write_text(_lengthened(scale))
    model = TorqueModel(load_urdf(urdf), DRIVE)
    log = differentiated(moved(model) if scale == 1.0 else _moved_elsewhere(tmp_path))
    estimate = constrained_least_squares(
        model,
        build_regression(model, log),
        constraints=[PhysicalConsistency(), FixedMasses({"upper": 4.0, "fore": 2.0})],
        prior=PointToSet(slack=slack),
    )
    assert np.isfinite(estimate.parameters).all()


def _lengthened(scale):
    """Return the arm with lengths in another unit, inertias too."""
    text = re.sub(
        r'origin xyz="([^"]*)"',
        lambda found: 'origin xyz="{}"'.format(
            " ".join(str(scale * float(x)) for x in found[1].split())
        ),
        URDF,
    )
    return re.sub(
        r'(i[xyz][xyz])="([^"]*)"',
        lambda found: f'{found[1]}="{scale**2 * float(found[2])}"',
        text,
    )


def _moved_elsewhere(folder):
    """Return a log of the arm in metres."""
    (folder / "metres.urdf").write_text(URDF)
    return moved(TorqueModel(load_urdf(folder / "metres.urdf"), DRIVE))

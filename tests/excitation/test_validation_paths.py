"""Random paths for the motion that validates an estimate."""

import pytest
from excited import arm, arm_limits

from consistent_id import TorqueModel
from consistent_id.excitation import design_trajectory, validation_trajectory
from consistent_id.excitation import playable as playable_module
from consistent_id.excitation.aims import Aim, PathForm


@pytest.mark.slow
@pytest.mark.parametrize(("allowed", "count"), [(1e9, 24), (0.0, 1)])
def test_as_many_paths_are_drawn_as_their_work_allows(monkeypatch, allowed, count):
    robot = arm(2)
    design = design_trajectory(
        TorqueModel(robot),
        PathForm(4.0, 2),
        Aim(noise=1e-4, refine=None),
        limits=arm_limits(robot),
        starts=1,
        workers=1,
        time_limit=0.5,
    )
    drawn = []

    def counted(path, limits, rng):
        drawn.append(path)
        return start(path, limits, rng)

    start = playable_module.clear_start
    monkeypatch.setattr(playable_module, "clear_start", counted)
    monkeypatch.setattr(playable_module, "_DRAWING", allowed)
    assert validation_trajectory(design).proof.holds
    assert len(drawn) == count

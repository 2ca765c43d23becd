"""Logged commands, replayed in MuJoCo by models of the robot."""

from consistent_id.laboratory.rollout.replay import Replay, replay
from consistent_id.laboratory.rollout.replay_model import ReplayModel, replay_model
from consistent_id.laboratory.rollout.rollout import Rollout, rollout

__all__ = ["Replay", "ReplayModel", "Rollout", "replay", "replay_model", "rollout"]

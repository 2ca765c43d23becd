"""Logged commands, replayed in MuJoCo by models of the robot."""

from consistent_id.rollout.commanded_motion import Replay, replay
from consistent_id.rollout.compared_models import Rollout, rollout
from consistent_id.rollout.problem_rollout import ProblemRollout, rollout_of
from consistent_id.rollout.refine import Refined, refined
from consistent_id.rollout.replay_model import ReplayModel, replay_model
from consistent_id.rollout.rollout_page import rollout_html
from consistent_id.rollout.servo_export import servo_mjcf
from consistent_id.rollout.servo_fit import identify_servos
from consistent_id.rollout.servo_log import ServoLog, read_servo_logs
from consistent_id.rollout.servo_result import JointServo, ServoFit

__all__ = [
    "JointServo",
    "ProblemRollout",
    "Refined",
    "Replay",
    "ReplayModel",
    "Rollout",
    "ServoFit",
    "ServoLog",
    "identify_servos",
    "read_servo_logs",
    "refined",
    "replay",
    "replay_model",
    "rollout",
    "rollout_html",
    "rollout_of",
    "servo_mjcf",
]

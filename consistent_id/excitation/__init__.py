"""Exciting trajectories: motions that make parameters identifiable, within limits."""

from consistent_id._support.face import face

__getattr__, __dir__ = face(__name__)

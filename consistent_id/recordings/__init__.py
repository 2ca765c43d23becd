"""Measured logs and paths to play: readers of files, signals computed from logs."""

from consistent_id._support.face import face

__getattr__, __dir__ = face(__name__)

"""Faults of a log, found before anything is estimated from it."""

from consistent_id._support.face import face

__getattr__, __dir__ = face(__name__)

"""Recordings from logs: tables, arrays, joint states, data frames."""

from consistent_id._support.face import face

__getattr__, __dir__ = face(__name__)

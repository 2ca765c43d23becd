"""The problem file: its tables, their values, and the study of a problem."""

from consistent_id._support.face import face

__getattr__, __dir__ = face(__name__)

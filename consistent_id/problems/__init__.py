"""The problem file: its tables, the values that they stand for, the study of them."""

from consistent_id._support.face import face

__getattr__, __dir__ = face(__name__)

"""The reliability of estimates: held-out errors, uncertainty, shadow prices."""

from consistent_id._support.face import face

__getattr__, __dir__ = face(__name__)

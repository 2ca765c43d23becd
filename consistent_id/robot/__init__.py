"""A robot: its tree of links, their inertial parameters, the files that hold it."""

from consistent_id._support.face import face

__getattr__, __dir__ = face(__name__)

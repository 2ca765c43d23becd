"""A robot: its tree of links, their inertial parameters, its files."""

from consistent_id._support.face import face

__getattr__, __dir__ = face(__name__)

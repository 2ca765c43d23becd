"""Torque as a linear function of the parameters, compressed to triangular factors."""

from consistent_id._support.face import face

__getattr__, __dir__ = face(__name__)

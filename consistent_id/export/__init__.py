"""Identified robots for other programs: files, models and functions."""

from consistent_id._support.face import face

__getattr__, __dir__ = face(__name__)

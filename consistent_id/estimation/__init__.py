"""Estimators: from a regression, constraints and a prior to an estimate."""

from consistent_id._support.face import face

__getattr__, __dir__ = face(__name__)

"""Robot models from their file formats."""

from consistent_id._support.face import face

__getattr__, __dir__ = face(__name__)

"""Robot models from the forms in which people keep them."""

from consistent_id._support.face import face

__getattr__, __dir__ = face(__name__)

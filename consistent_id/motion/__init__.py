"""Motion that robots can play: limits, polynomial pieces, moves from rest to rest."""

from consistent_id._support.face import face

__getattr__, __dir__ = face(__name__)

"""Motion that robots can play: limits, polynomial pieces, moves from rest to rest."""

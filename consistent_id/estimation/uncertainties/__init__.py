"""How far estimated parameters may be from the true ones: errors and intervals."""

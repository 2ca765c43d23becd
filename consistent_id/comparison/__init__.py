"""How far to trust an estimate: comparison, uncertainty, prices of constraints."""

"""How far to trust an estimate: held-out errors, uncertainty, shadow prices."""

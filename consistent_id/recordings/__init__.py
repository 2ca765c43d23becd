"""What was measured, or is to be played: recordings, paths, readers, signals."""

"""Measured logs and paths to play: readers of files, signals made from logs."""

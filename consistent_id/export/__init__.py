"""Identified robots for other programs: files, models and functions."""

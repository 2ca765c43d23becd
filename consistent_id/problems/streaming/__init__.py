"""Logs larger than memory: compressed window by window, by one process or many."""

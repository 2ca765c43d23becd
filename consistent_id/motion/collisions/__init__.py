"""Bodies that must stay apart: scenes, distances, clearance proven for all time."""

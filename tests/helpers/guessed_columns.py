"""Columns that are guessed from the names of a log."""

from consistent_id.recordings.column_guess import guess_columns
from consistent_id.recordings.column_proposals import KnownColumns

SIX = tuple(f"axis_{letter}" for letter in "abcdef")


def numbered(*patterns, first=1, count=6):
    return [p.format(k) for p in patterns for k in range(first, first + count)]


def guessed(folder, names, joints=SIX, **options):
    file = folder / "log.csv"
    file.write_text(",".join(names) + "\n" + ",".join("0" for _ in names) + "\n")
    return guess_columns(file, KnownColumns(tuple(joints), **options))

"""Results for people: tables, figures, and a study as one HTML file."""

from consistent_id._support.face import face

__getattr__, __dir__ = face(__name__)

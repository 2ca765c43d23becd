"""From a raw log to consistent motion and torque.

Each function takes a `Recording` and returns a new one, or a small value.
"""

from consistent_id._support.face import face

__getattr__, __dir__ = face(__name__)

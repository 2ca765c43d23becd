"""Preparation of recordings, under the name by which users know it."""

from consistent_id.recordings.signals import *  # noqa: F403
from consistent_id.recordings.signals import __all__ as __all__

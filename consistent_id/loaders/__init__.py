"""Robot models from the forms in which people keep them."""

from consistent_id.loaders.modified_dh import DHRow, from_modified_dh
from consistent_id.loaders.urdf import load_urdf

__all__ = ["DHRow", "from_modified_dh", "load_urdf"]

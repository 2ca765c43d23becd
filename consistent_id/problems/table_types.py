"""What the tables of a problem file are made of."""

from typing import Annotated

import msgspec
from msgspec import Meta

Positive = Annotated[float, Meta(gt=0.0)]
NonNegative = Annotated[float, Meta(ge=0.0)]
Three = Annotated[list[float], Meta(min_length=3, max_length=3)]
Pair = Annotated[list[float], Meta(min_length=2, max_length=2)]


class Table(msgspec.Struct, forbid_unknown_fields=True, frozen=True, kw_only=True):
    """A table of the file; a key that it does not name is an error."""

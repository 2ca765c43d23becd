"""Libraries that only some uses need, and what to say where they are missing."""

from importlib import import_module
from typing import Any

from consistent_id.errors import ProblemError


def pandas() -> Any:
    """Return pandas.

    Raises
    ------
    ProblemError
        If it is not installed.
    """
    return _needed("pandas")


def xarray() -> Any:
    """Return xarray.

    Raises
    ------
    ProblemError
        If it is not installed.
    """
    return _needed("xarray")


def _needed(library: str) -> Any:
    try:
        return import_module(library)
    except ImportError:
        raise ProblemError(
            f"this needs {library}; pip install 'consistent-id[frames]'"
        ) from None

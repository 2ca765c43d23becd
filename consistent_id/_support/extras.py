"""Libraries that only some uses need, and how to install one that is missing."""

from importlib import import_module
from typing import Any

from consistent_id.errors import ConsistentIdError, ProblemError


def needed(
    library: str,
    extra: str,
    what: str = "this",
    error: type[ConsistentIdError] = ProblemError,
) -> Any:
    """Return a library, or raise an error that says how to install it.

    Parameters
    ----------
    extra : str
        The package's extra that installs it.
    what : str
        The feature that needs the extra: the subject of the message.

    Examples
    --------
    >>> needed("no_such_library", "hdf5", "reading HDF5")
    Traceback (most recent call last):
    consistent_id.errors.ProblemError: reading HDF5 needs no_such_library; install it
    with: pip install 'consistent-id[hdf5]'
    """
    try:
        return import_module(library)
    except ImportError:
        raise error(
            f"{what} needs {library.partition('.')[0]}; install it with: "
            f"pip install 'consistent-id[{extra}]'"
        ) from None


def pandas() -> Any:
    """Return pandas.

    Raises
    ------
    ProblemError
        If it is not installed.
    """
    return needed("pandas", "frames")


def xarray() -> Any:
    """Return xarray.

    Raises
    ------
    ProblemError
        If it is not installed.
    """
    return needed("xarray", "frames")

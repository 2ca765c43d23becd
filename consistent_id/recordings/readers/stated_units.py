"""Units that a file states of its arrays, as attributes of HDF5 datasets do."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

from consistent_id.errors import RecordingError
from consistent_id.recordings.readers.columns import Wanted
from consistent_id.recordings.readers.units import KNOWN, is_other_unit, standard_unit


def in_stated_units(want: Wanted, said: Mapping[str, str], where: str) -> Wanted:
    """Return what is wanted, in the units that the file states where no one else does.

    Parameters
    ----------
    said : mapping of str to str
        Unit by name of an array; words that are no unit are passed over.
    where : str
        The file.

    Raises
    ------
    RecordingError
        If an array is in a unit that its channel cannot have, or in another one than
        its reader states.
    """
    units = dict(want.units)
    for channel, names in _names(want).items():
        found = [_unit(channel, name, said, where) for name in names]
        if not any(found):
            continue
        alone = channel == "time" or channel in want.arrays
        if channel not in units:
            units[channel] = found[0] if alone else tuple(found)
            continue
        given = units[channel]
        each = [given] * len(names) if isinstance(given, str) else list(given)
        for name, own, other in zip(names, found, each, strict=False):
            if own and own != other:
                raise RecordingError(
                    f"{where}: column {name!r} is in {own!r}, says the file, and in "
                    f"{other!r}, say the units of {channel}: leave one of them out"
                )
    for name in want.beside.names:
        if is_other_unit(said.get(name, "")):
            raise RecordingError(
                f"{where}: column {name!r} is in {said[name]!r}, says the file; motion "
                "of a base, contacts and forces are read in SI units. Convert them "
                "first: recording_from takes arrays"
            )
    return replace(want, units=units)


def _names(want: Wanted) -> dict[str, Sequence[str]]:
    arrays = {channel: (name,) for channel, name in want.arrays.items()}
    channels = {"time": (want.time,), **arrays, **want.columns}
    return {c: names for c, names in channels.items() if c in KNOWN}


def _unit(channel: str, name: str, said: Mapping[str, str], where: str) -> str:
    """Return an array's unit as `KNOWN` spells it; empty if none is stated."""
    text = said.get(name, "").strip()
    try:
        return standard_unit(channel, text) if text else ""
    except RecordingError as cause:
        if is_other_unit(text):
            raise RecordingError(f"{where}: column {name!r}: {cause}") from None
        return ""

"""Dynamic-parameter identification of robots, with physically consistent estimates.

Robot -> recording -> regression -> estimate -> comparison -> report, export.  Each
arrow is a function, each noun a frozen value.

Public names are those of ``__init__.pyi`` and of submodules such as
`consistent_id.signals` or `consistent_id.constraints`; what a name stands for is
imported when it is first used.
"""

__version__ = "0.2.0"


def __getattr__(name: str) -> object:
    """Import a public name or a submodule, or list the names as ``__all__``."""
    from importlib import import_module

    from consistent_id._support.face import ROOMS, homes, moved_value, public_value

    if name in ROOMS:
        return import_module(f"{__name__}.{name}")
    if name.startswith("__") or name in homes(__name__):
        value = globals()[name] = public_value(__name__, name)
        return value
    return moved_value(__name__, name)


def __dir__() -> list[str]:
    """List public names and submodules, imported or not."""
    from consistent_id._support.face import ROOMS, homes

    return sorted({*globals(), *homes(__name__), *ROOMS})

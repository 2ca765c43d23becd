"""Dynamic-parameter identification of robots, with physically consistent estimates.

Robot -> recording -> regression -> estimate -> comparison -> report, export.  Each
arrow is a function, each noun a frozen value.

Public names are those of ``__init__.pyi``; a name's module is imported when the name is
first asked for.
"""

__version__ = "0.1.0"


def __getattr__(name: str) -> object:
    """Import a public name, or their list ``__all__``."""
    from consistent_id._face import public_value

    value = globals()[name] = public_value(name)
    return value


def __dir__() -> list[str]:
    """List public names, imported or not."""
    from consistent_id._face import homes

    return sorted({*globals(), *homes()})

"""The package's public names, imported when they are first asked for.

They are listed once, with their modules, in ``__init__.pyi``, as [SPEC1]_ proposes.  No
module of the package has the name of a public function: once imported, it would stand
in the function's place.
"""

import ast
from functools import cache
from importlib import import_module
from pkgutil import get_data

_PACKAGE = "consistent_id"


@cache
def homes() -> dict[str, str]:
    """Return the module of each public name.

    Examples
    --------
    >>> homes()["compare"]
    'consistent_id.comparison.comparison'
    """
    stub = ast.parse(get_data(_PACKAGE, "__init__.pyi") or b"")
    return {
        alias.name: node.module
        for node in stub.body
        if isinstance(node, ast.ImportFrom) and node.module is not None
        for alias in node.names
    }


def public_value(name: str) -> object:
    """Return what a public name of the package stands for.

    Raises
    ------
    AttributeError
        If there is no such name.
    """
    if name == "__all__":
        return sorted(homes())
    if name.startswith("__") or name not in homes():
        raise AttributeError(
            f"module {_PACKAGE!r} has no attribute {name!r}", name=name
        )
    return getattr(import_module(homes()[name]), name)

"""Public names of a package, imported when they are first used.

They are listed once, with their modules, in the package's ``__init__.pyi``, as [SPEC1]_
proposes.  No module has the name of something public in its package: once imported, it
would stand in its place.
"""

import ast
import re
import warnings
from collections.abc import Callable
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from pkgutil import get_data

ROOMS = (
    "robot",
    "recordings",
    "signals",
    "regression",
    "constraints",
    "motion",
    "estimation",
    "export",
    "comparison",
    "diagnosis",
    "problems",
    "report",
    "excitation",
    "rollout",
    "fleet",
    "standing",
    "repair",
    "laboratory",
    "service",
)
"""Submodules of the package that have public names of their own."""


_GONE = {
    "consistent_id.comparison": ("cross_check", "CrossCheck"),
    "consistent_id.estimation": ("smooth_least_squares",),
}
"""Names that were public before the first release: a second search for tests alone."""


@cache
def homes(package: str) -> dict[str, str]:
    """Return the module of each public name of a package.

    Examples
    --------
    >>> homes("consistent_id")["compare"]
    'consistent_id.comparison.comparison'
    """
    stub = ast.parse(get_data(package, "__init__.pyi") or b"")
    return {
        alias.name: node.module
        for node in stub.body
        if isinstance(node, ast.ImportFrom) and node.module not in (None, package)
        for alias in node.names
        if node.module is not None
    }


def public_value(package: str, name: str) -> object:
    """Return the value of a public name of a package.

    Raises
    ------
    AttributeError
        If there is no such name.
    """
    if name == "__all__":
        return sorted(homes(package))
    if name.startswith("__") or name not in homes(package):
        gone = name in _GONE.get(package, ())
        instead = " any more: the certificate of an estimate proves it" if gone else ""
        raise AttributeError(
            f"module {package!r} has no attribute {name!r}{instead}", name=name
        )
    return getattr(import_module(homes(package)[name]), name)


def face(package: str) -> tuple[Callable[[str], object], Callable[[], list[str]]]:
    """Return ``__getattr__`` and ``__dir__`` of a package with public names."""
    module = import_module(package)

    def get(name: str) -> object:
        value = public_value(package, name)
        setattr(module, name, value)
        return value

    return get, lambda: sorted({*vars(module), *homes(package)})


def moved_value(package: str, name: str) -> object:
    """Return the value of a former public name, which a submodule has now.

    Raises
    ------
    AttributeError
        If no submodule has it.
    """
    for room in ROOMS:
        if not _may_offer(f"{package}.{room}", name):
            continue
        module = import_module(f"{package}.{room}")
        if name in module.__all__:
            warnings.warn(
                f"{package}.{name} is {package}.{room}.{name} now; the old name works "
                "until the next release",
                DeprecationWarning,
                stacklevel=3,
            )
            return getattr(module, name)
    return public_value(package, name)  # which says that there is none


def _may_offer(module: str, name: str) -> bool:
    """Return whether the list of a submodule's public names has a name in it.

    The submodule is not imported: pickle asks the package for names of other libraries,
    and an import of all submodules takes longer than a study.
    """
    file = find_spec(module)
    if file is None or file.origin is None:
        return False
    stub = Path(file.origin).with_suffix(".pyi")
    text = (stub if stub.exists() else Path(file.origin)).read_text("utf-8")
    if star := re.search(r"from (\S+) import \*", text):
        return _may_offer(star[1], name)
    return re.search(rf"\b{re.escape(name)}\b", text) is not None

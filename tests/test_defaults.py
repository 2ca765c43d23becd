"""Numbers that a caller does not state: another one changes the results of old code."""

import importlib
import inspect
from pathlib import Path

ROOMS = ("", ".robot", ".constraints", ".estimation", ".recordings", ".regression")
TABLE = dict(
    line.split(": ")
    for line in (Path(__file__).parent / "defaults.txt").read_text().splitlines()
)


def stated(function):
    """Numeric defaults of a function or class, as a line of text."""
    return ", ".join(
        f"{p.name}={p.default}"
        for p in inspect.signature(function).parameters.values()
        if isinstance(p.default, bool | int | float) and p.name != "size"
    )


def public():
    """Public functions, classes and methods of the rooms that decide numbers."""
    for room in ROOMS:
        package = importlib.import_module(f"consistent_id{room}")
        for name in package.__all__:
            value = getattr(package, name)
            called = {name: value} if callable(value) else {}
            if inspect.isclass(value):
                plain = {k: getattr(v, "__func__", v) for k, v in vars(value).items()}
                called |= {
                    f"{name}.{key}": method
                    for key, method in plain.items()
                    if inspect.isfunction(method) and not key.startswith("_")
                }
            yield from called.items()


def test_defaults_of_public_names_stay_as_they_are():
    """A default that is changed on purpose is changed in ``defaults.txt`` as well."""
    assert {name: line for name, f in public() if (line := stated(f))} == TABLE

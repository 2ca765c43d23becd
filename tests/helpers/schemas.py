"""JSON of commands beside the schemas that the documentation publishes."""

import json
from functools import cache
from pathlib import Path
from typing import Any

import pytest

FOLDER = Path(__file__).parents[2] / "docs" / "schemas"


@cache
def _registry() -> Any:
    referencing = pytest.importorskip("referencing")
    resources = (
        referencing.Resource.from_contents(json.loads(path.read_text()))
        for path in FOLDER.glob("*.json")
    )
    return referencing.Registry().with_resources(
        (resource.id(), resource) for resource in resources
    )


def _no_number(word: str) -> Any:
    raise ValueError(f"{word} is not JSON")


def parsed(text: str, name: str | None = None) -> Any:
    """Return what JSON holds, if it is of a schema; by default, of its own format."""
    jsonschema = pytest.importorskip("jsonschema")
    record = json.loads(text, parse_constant=_no_number)
    if name is None:
        name = record["format"].removeprefix("consistent_id ").replace(" ", "-")
    schema = json.loads((FOLDER / f"{name}.json").read_text())
    jsonschema.Draft202012Validator(schema, registry=_registry()).validate(record)
    return record

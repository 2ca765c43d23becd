"""Keys such as [Gautier1991]_ in docstrings and pages, as links to the references."""

import re
from typing import Any

from sphinx.application import Sphinx

_CITED = re.compile(r"\[([A-Z][A-Za-z]+\d{4})\](?:_(?!\w)|(?![\w(\[{_]))")
_LISTED = re.compile(r"^\| ([A-Z][A-Za-z]+\d{4}) \|", re.MULTILINE)


def in_docstring(
    app: Sphinx, what: str, name: str, obj: Any, options: Any, lines: list[str]
) -> None:
    """Link the keys of a docstring."""
    lines[:] = [_CITED.sub(r":ref:`[\1] <\1>`", line) for line in lines]


def in_page(app: Sphinx, page: str, source: list[str]) -> None:
    """Link the keys of a page; on the page of references, mark where they lead."""
    if page == "references":
        source[0] = _LISTED.sub(r"| [\1]{#\1} |", source[0])
    else:
        source[0] = _CITED.sub(r"[\[\1\]](#\1)", source[0])


def setup(app: Sphinx) -> dict[str, bool]:
    """Listen to docstrings and pages as they are read."""
    app.connect("autodoc-process-docstring", in_docstring)
    app.connect("source-read", in_page)
    return {"parallel_read_safe": True, "parallel_write_safe": True}

"""The directive ``public``: a table of names, then each name's documentation."""

import importlib
import inspect
from dataclasses import is_dataclass
from typing import Any

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

TEMPLATE = """```{{eval-rst}}
.. currentmodule:: {module}

.. autosummary::
   :nosignatures:

{table}

{entries}
```
"""


class Public(SphinxDirective):
    """Names of one module, `consistent_id` if it is not the argument."""

    has_content = True
    optional_arguments = 1

    def run(self) -> list[nodes.Node]:
        """Return the table and the entries."""
        module = (self.arguments or ["consistent_id"])[0]
        names = [line.strip() for line in self.content if line.strip()]
        owner = importlib.import_module(module)
        entries = (_entry(name, getattr(owner, name)) for name in names)
        text = TEMPLATE.format(
            module=module,
            table="\n".join(f"   {name}" for name in names),
            entries="\n".join(entries),
        )
        return self.parse_text_to_nodes(text, allow_section_headings=True)


def _entry(name: str, value: Any) -> str:
    if inspect.isclass(value):
        # A value that builds on another one shows all members; an error, its own.
        whole = any(map(is_dataclass, value.__bases__))
        inherited = "   :inherited-members:\n" if whole else ""
        return f".. autoclass:: {name}\n   :members:\n{inherited}"
    kind = "function" if inspect.isfunction(value) else "data"
    return f".. auto{kind}:: {name}\n"


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the directive."""
    app.add_directive("public", Public)
    return {"parallel_read_safe": True, "parallel_write_safe": True}

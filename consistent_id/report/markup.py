"""HTML and SVG as values: whatever is not markup already is escaped on its way in."""

from collections.abc import Iterable
from html import escape

from consistent_id._support.tables import Table

_EMPTY = frozenset({"br", "input", "meta"})  # elements of HTML that have no end tag
_LONG = 40  # letters of a row's name that may be wrapped


class Html(str):
    """Text that is markup; any other text is escaped when it becomes part of one."""

    __slots__ = ()


def text(value: object) -> Html:
    """Return a value as markup: as it is if it is markup, else its escaped text.

    Examples
    --------
    >>> text("<b>")
    '&lt;b&gt;'
    """
    return value if isinstance(value, Html) else Html(escape(str(value)))


def joined(parts: Iterable[object], between: str = "") -> Html:
    """Return several pieces as one."""
    return Html(between.join(text(part) for part in parts))


def tag(name: str, /, *children: object, **attributes: object) -> Html:
    """Return an element.

    Parameters
    ----------
    *children : object
        Markup, or anything with a text, which is escaped.
    **attributes : object
        Underscores become hyphens, a trailing one is dropped (``class_``); ``True`` is
        an attribute without a value; ``None`` and ``False`` leave it out.

    Examples
    --------
    >>> tag("a", "x < y", href="#top", class_="link")
    '<a href="#top" class="link">x &lt; y</a>'
    """
    opened = "".join(
        _attribute(key.rstrip("_").replace("_", "-"), value)
        for key, value in attributes.items()
        if value is not None and value is not False
    )
    if name in _EMPTY:
        return Html(f"<{name}{opened}>")
    return Html(f"<{name}{opened}>{joined(children)}</{name}>")


def _attribute(name: str, value: object) -> str:
    return f" {name}" if value is True else f' {name}="{escape(str(value))}"'


def paragraphs(*sentences: object, class_: str | None = None) -> Html:
    """Return a paragraph for each piece of text."""
    return joined(tag("p", sentence, class_=class_) for sentence in sentences)


def listed(items: Iterable[object], class_: str | None = None) -> Html:
    """Return a list, or nothing for no items."""
    points = [tag("li", item) for item in items]
    return tag("ul", *points, class_=class_) if points else Html()


def folded(summary: object, *content: object, open_: bool = False) -> Html:
    """Return content that is shown on request, and always in print."""
    return tag("details", tag("summary", summary), *content, open=open_)


def grid(
    header: Iterable[object], rows: Iterable[Iterable[object]], class_: str = ""
) -> Html:
    """Return a table that scrolls sideways where it is too wide."""
    names, cells = list(header), [list(row) for row in rows]
    sides = [
        "number" if i and all(_is_number(row[i]) for row in cells) else None
        for i in range(len(names))
    ]
    head = [
        tag("th", name, scope="col", class_=side)
        for name, side in zip(names, sides, strict=True)
    ]
    body = [
        tag("tr", tag("th", row[0], scope="row"), *map(_cell, row[1:], sides[1:]))
        for row in cells
    ]
    table = tag("table", tag("thead", tag("tr", *head)), tag("tbody", *body))
    if any(len(str(row[0])) > _LONG for row in cells):
        class_ += " long"
    # Reachable by keyboard, since it may scroll.
    return tag("div", table, class_=f"scroll {class_}".strip(), tabindex=0)


def _cell(cell: object, side: str | None) -> Html:
    return tag("td", cell, class_=side)


def _is_number(cell: object) -> bool:
    """Return whether a cell is a number, several, or a dash for none."""
    start = str(cell).lstrip("+-< ")
    marked = isinstance(cell, Html) and not start.startswith("<strong>")
    return not marked and (start[:1].isdigit() or start[:3] in ("", "inf", "nan"))


def table_html(table: Table, *, titled: bool = True) -> Html:
    """Return a table with its title and notes."""
    return joined(
        (
            tag("h3", table.title) if titled else "",
            grid(table.header, table.rows) if table.rows else "",
            listed(table.notes, class_="notes"),
        )
    )

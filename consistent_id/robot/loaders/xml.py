"""XML elements with their positions in the text."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from xml.parsers import expat

from consistent_id.errors import ModelError

DEEPEST = 256  # elements within elements; robots have about 40, of nested bodies


class XmlFault(ModelError):
    """Text that is no XML, or XML of a kind that is refused.

    `refused` says that it is XML, which nobody should read.
    """

    def __init__(self, line: int, sentence: str, *, refused: bool = False) -> None:
        super().__init__(f"line {line}: {sentence}")
        self.line, self.sentence, self.refused = line, sentence, refused


@dataclass(slots=True)
class Element:
    """An XML element with the line on which it starts.

    `start` is the byte at which its start tag begins, and `close` that at which its end
    tag begins or, where there is none, at which the element has ended.
    """

    tag: str
    attributes: dict[str, str]
    line: int
    children: list["Element"] = field(default_factory=list)
    start: int = 0
    close: int = 0

    @property
    def name(self) -> str:
        """The attribute ``name``, empty if there is none."""
        return self.attributes.get("name", "")

    def child(self, tag: str) -> "Element | None":
        """Return the first child with a tag."""
        return next((c for c in self.children if c.tag == tag), None)

    def all(self, tag: str) -> Iterator["Element"]:
        """Yield the children with a tag."""
        return (c for c in self.children if c.tag == tag)

    def below(self, without: tuple[str, ...] = ()) -> Iterator["Element"]:
        """Yield all descendants but those in elements whose tag is in `without`."""
        for child in self.children:
            if child.tag not in without:
                yield child
                yield from child.below(without)


def parse(text: bytes) -> Element:
    """Return the root element.

    Raises
    ------
    XmlFault
        If the text is not well-formed or nested too deeply, or has a document type
        declaration: entities can grow without bound, or read other files.
    """
    parser = expat.ParserCreate()
    top = Element("", {}, 0)
    stack = [top]

    def start(tag: str, attributes: dict[str, str]) -> None:
        line, place = parser.CurrentLineNumber, parser.CurrentByteIndex
        if len(stack) > DEEPEST:
            sentence = f"elements are nested deeper than {DEEPEST}; no robot's are"
            raise XmlFault(line, sentence, refused=True)
        element = Element(tag, attributes, line, start=place)
        stack[-1].children.append(element)
        stack.append(element)

    def end(_: str) -> None:
        stack.pop().close = parser.CurrentByteIndex

    def refuse_dtd(*_: object) -> None:
        raise XmlFault(
            parser.CurrentLineNumber,
            "a document type declaration stands here; entities are not expanded, "
            "remove it",
            refused=True,
        )

    parser.StartElementHandler = start
    parser.EndElementHandler = end
    parser.StartDoctypeDeclHandler = refuse_dtd
    try:
        parser.Parse(text, True)
    except expat.ExpatError as cause:
        sentence = f"not well-formed XML: {expat.errors.messages[cause.code]}"
        raise XmlFault(cause.lineno, sentence) from None
    except (LookupError, ValueError) as cause:  # an unknown encoding
        raise XmlFault(1, f"not readable as XML: {cause}") from None
    return top.children[0]

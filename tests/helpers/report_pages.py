"""A page of HTML as a test reads it."""

from html.parser import HTMLParser

EMPTY = {"meta", "input", "br"}


class Page(HTMLParser):
    """What a browser would find: elements that close, sections, texts."""

    def __init__(self, html):
        super().__init__()
        self.open, self.sections, self.texts, self.elements = [], [], [], []
        self.feed(html)
        assert not self.open

    def handle_starttag(self, name, attributes):
        self.elements.append((name, dict(attributes)))
        if name == "section":
            self.sections.append(dict(attributes)["id"])
        if name not in EMPTY:
            self.open.append(name)

    def handle_endtag(self, name):
        assert self.open.pop() == name

    def handle_data(self, data):
        self.texts.append(data)

    @property
    def text(self):
        return " ".join(self.texts)

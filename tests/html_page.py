"""What a reader of an HTML page sees, section by section."""

from __future__ import annotations

from html.parser import HTMLParser

VOID = {"meta", "img", "br", "hr", "link", "input"}


class Page(HTMLParser):
    """Tags with their attributes in order, headings, and by section: rows of text, alternative texts of images, words
    outside tables. The summary and marked texts; `open_tags` is empty if all were closed.
    """

    def __init__(self, source: str) -> None:
        super().__init__()
        self.source = source
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.headings: list[str] = []
        self.rows: dict[str, list[list[str]]] = {}
        self.images: dict[str, list[str]] = {}
        self.words: dict[str, str] = {}
        self.summary: list[str] = []
        self.marked: list[str] = []
        self.open_tags: list[str] = []
        self._section = ""
        self.feed(source)

    @property
    def alternatives(self) -> list[str]:
        return [text for texts in self.images.values() for text in texts]

    def attributes(self, tag: str) -> list[dict[str, str | None]]:
        return [attributes for name, attributes in self.tags if name == tag]

    def of(self, start: str) -> list[list[str]]:
        """The rows of the section whose heading begins with `start`."""
        return next(rows for heading, rows in self.rows.items() if heading.startswith(start) and rows)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open_tags.append(tag)
        if tag in ("h1", "h2"):
            self.headings.append("")
        elif tag == "tr":
            self.rows.setdefault(self._section, []).append([])
        elif tag in ("th", "td"):
            self.rows[self._section][-1].append("")
        elif tag == "img":
            self.images.setdefault(self._section, []).append(dict(attrs)["alt"] or "")
        elif tag == "br":
            self.handle_data("\n")
        elif self.open_tags[-3:] == ["main", "ul", "li"]:
            self.summary.append("")
        elif tag == "mark":
            self.marked.append("")

    def handle_endtag(self, tag: str) -> None:
        assert self.open_tags.pop() == tag
        if tag == "h2":
            self._section = self.headings[-1]
            self.rows.setdefault(self._section, [])

    def handle_data(self, data: str) -> None:
        if {"h1", "h2"} & set(self.open_tags):
            self.headings[-1] += data
        elif {"th", "td"} & set(self.open_tags):
            self.rows[self._section][-1][-1] += data
        elif "style" not in self.open_tags:
            self.words[self._section] = self.words.get(self._section, "") + data
        if self.open_tags[-1:] == ["mark"]:
            self.marked[-1] += data
        if self.open_tags[-3:] == ["main", "ul", "li"]:
            self.summary[-1] += data

"""What a built page would load from elsewhere: nothing, or the page is not whole without a network.

Links that a reader may follow are no concern of this.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path

EXTERNAL = re.compile(r"\s*(?:https?:)?//", re.IGNORECASE)
IN_STYLE = re.compile(r"(?:url\(|@import(?!\s+url))\s*[\"']?(?P<url>[^\"')]+)", re.IGNORECASE)
LOADING = ("src", "srcset", "data", "poster", "background")
"""Attributes whose address is fetched without anybody's doing."""
MERMAID = "mermaid"
"""A class by which the theme's script loads a drawing library from a network of its own choice."""


def external_loads(site: Path) -> Iterator[str]:
    """Each address outside the built site that one of its files would load, with the file."""
    for path in sorted(site.rglob("*")):
        if path.suffix == ".html":
            urls = loads_of_html(path.read_text(encoding="utf-8"))
        elif path.suffix == ".css":
            urls = loads_of_style(path.read_text(encoding="utf-8"))
        else:
            continue
        for url in urls:
            yield f"{path.relative_to(site)}: {url}"


def loads_of_html(html: str) -> list[str]:
    """Addresses outside that a page would load."""
    reader = _Loads()
    reader.feed(html)
    reader.close()
    return reader.found


def loads_of_style(style: str) -> list[str]:
    """Addresses outside that a style sheet would load."""
    urls = (match["url"].strip() for match in IN_STYLE.finditer(style))
    return [url for url in urls if EXTERNAL.match(url)]


class _Loads(HTMLParser):
    def __init__(self) -> None:
        super().__init__()
        self.found: list[str] = []
        self._in_style = False

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self._in_style = tag == "style"
        for name, value in attrs:
            if value is None:
                continue
            if name in LOADING or (tag == "link" and name == "href"):
                self._note(value)
            elif name == "style":
                self.found += loads_of_style(value)
            elif name == "class" and MERMAID in value.split():
                self.found.append(MERMAID)

    def handle_endtag(self, tag: str) -> None:
        self._in_style = self._in_style and tag != "style"

    def handle_data(self, data: str) -> None:
        if self._in_style:
            self.found += loads_of_style(data)

    def _note(self, url: str) -> None:
        if EXTERNAL.match(url):
            self.found.append(url)

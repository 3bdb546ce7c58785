"""Change and check the HTML of built pages: formulas, pictures, and addresses outside the site."""

from __future__ import annotations

import re
from collections.abc import Iterator
from html import unescape
from html.parser import HTMLParser
from pathlib import Path, PurePosixPath

FORMULA = re.compile(
    r'<(?P<tag>div|span) class="arithmatex">\\[\[(](?P<latex>.*?)\\[\])]</(?P=tag)>', re.DOTALL
)
"""The marks of pymdownx.arithmatex: \\[…\\] for blocks, \\(…\\) inside a line."""
SIZED = re.compile(r"\\[Bb]igg?[lr]?\b\s*")
"""Bracket sizes, which MathML chooses itself."""
IMAGE = re.compile(r"<img\b[^>]*?\bsrc=\"([^\"]+)\"[^>]*>")
EXTERNAL = re.compile(r"\s*(?:https?:)?//", re.IGNORECASE)
IN_STYLE = re.compile(r"(?:url\(|@import(?!\s+url))\s*[\"']?(?P<url>[^\"')]+)", re.IGNORECASE)
LOADING = ("src", "srcset", "data", "poster", "background")
"""Attributes whose address a browser fetches."""
MERMAID = "mermaid"
"""A class for which the theme's script loads a library from a CDN."""


def formulas_as_mathml(html: str) -> str:
    """Convert the formulas of a page to MathML, which needs no script."""
    from latex2mathml.converter import convert  # pictures do without

    def converted(match: re.Match[str]) -> str:
        display = "block" if match["tag"] == "div" else "inline"
        return convert(SIZED.sub("", unescape(match["latex"]).strip()), display=display)

    return FORMULA.sub(converted, html)


def dark_variant(path: Path) -> Path:
    """Return the path of a picture's dark variant: flow.dark.png for flow.png."""
    return path.with_suffix(f".dark{path.suffix}")


def show_by_scheme(html: str, *, images: Path) -> str:
    """Show each picture that has a dark variant under `images` in the page's colour scheme.

    The Markdown names the light picture alone, which other readers of the file show.
    """

    def pair(match: re.Match[str]) -> str:
        tag, source = match[0], match[1]
        name = PurePosixPath(source).name
        dark = dark_variant(images / name).name
        if not (images / dark).is_file():
            return tag
        shown_dark = tag.replace(source, source.removesuffix(name) + dark)
        return _with_class(tag, "only-light") + _with_class(shown_dark, "only-dark")

    return IMAGE.sub(pair, html)


def _with_class(tag: str, name: str) -> str:
    return tag.replace("<img", f'<img class="{name}" loading="lazy"', 1)


def external_loads(site: Path) -> Iterator[str]:
    """Yield the addresses outside the built site that its files would load, with the file."""
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
    """Return the addresses outside the site that a page would load."""
    reader = _Loads()
    reader.feed(html)
    reader.close()
    return reader.found


def loads_of_style(style: str) -> list[str]:
    """Return the addresses outside the site that a style sheet would load."""
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
                self.found += [value] if EXTERNAL.match(value) else []
            elif name == "style":
                self.found += loads_of_style(value)
            elif name == "class" and MERMAID in value.split():
                self.found.append(MERMAID)

    def handle_endtag(self, tag: str) -> None:
        self._in_style = self._in_style and tag != "style"

    def handle_data(self, data: str) -> None:
        if self._in_style:
            self.found += loads_of_style(data)

"""Pictures come in pairs, one for light pages and one for dark ones."""

from __future__ import annotations

import re
from pathlib import Path, PurePosixPath

IMAGE = re.compile(r"<img\b[^>]*?\bsrc=\"([^\"]+)\"[^>]*>")


def dark_variant(path: Path) -> Path:
    """Where the dark one of a picture stands: flow.png has flow.dark.png beside it."""
    return path.with_suffix(f".dark{path.suffix}")


def show_by_scheme(html: str, *, images: Path) -> str:
    """HTML in which each picture that has a dark variant under `images` is shown in its scheme.

    The Markdown names the light one alone, which any other reader of the file then shows.
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

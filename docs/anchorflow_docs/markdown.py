"""Markdown out of Python."""

from __future__ import annotations

from collections.abc import Iterable, Sequence


def table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table whose cells may hold line breaks and bars."""
    lines = [heads, ["---"] * len(heads), *rows]
    return "\n".join("| " + " | ".join(map(_cell, line)) + " |" for line in lines)


def code(text: str) -> str:
    """Text as it would be typed."""
    return f"`{text}`"


def _cell(text: str) -> str:
    """On one line; a bar outside of code would end the cell."""
    pieces = " ".join(text.split()).split("`")
    pieces[::2] = [piece.replace("|", r"\|") for piece in pieces[::2]]
    return "`".join(pieces)

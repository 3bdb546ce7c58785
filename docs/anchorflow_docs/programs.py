"""The programs of a page: Python under `<!-- run -->`, and what it prints under `<!-- prints -->`.

Both marks are comments, which no reader of the page sees.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

BLOCK = re.compile(
    r"^<!-- (?P<mark>run|prints) -->\n```(?P<language>\w+)\n(?P<text>.*?)^```$",
    re.DOTALL | re.MULTILINE,
)
LANGUAGES = {"run": "python", "prints": "text"}


@dataclass(frozen=True)
class Program:
    """One block, and where it stands."""

    place: str
    text: str
    prints: str | None
    """None: whatever it prints, its numbers are a machine's own."""


def programs_of(page: Path) -> list[Program]:
    """In the page's order; each sees what those before it have made."""
    text = page.read_text(encoding="utf-8")
    found: list[Program] = []
    for match in BLOCK.finditer(text):
        line = text.count("\n", 0, match.start("text")) + 1
        place = f"{page.name}, line {line}"
        assert match["language"] == LANGUAGES[match["mark"]], place
        if match["mark"] == "run":
            found.append(Program(place, match["text"], None))
        else:
            assert found, place
            before = found.pop()
            found.append(Program(before.place, before.text, match["text"]))
    return found

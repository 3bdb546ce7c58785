"""Read the marked blocks of a page: programs to run, their output, and messages.

The marks are comments, which readers do not see: `<!-- run -->` before Python, `<!-- prints -->`
before its output, `<!-- message: NAME -->` before the text of a message.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

PROGRAM = re.compile(
    r"^<!-- (?P<mark>run|prints) -->\n```(?P<language>\w+)\n(?P<text>.*?)^```$",
    re.DOTALL | re.MULTILINE,
)
MESSAGE = re.compile(
    r"^<!-- message: (?P<name>[\w-]+) -->\n```text\n(?P<text>.*?)\n```$", re.DOTALL | re.MULTILINE
)
LANGUAGES = {"run": "python", "prints": "text"}
VARYING = re.compile(r"[0-9a-f]{64}|…|\d+(?:\.\d+)*")
"""Figures, versions and hashes, which differ between machines."""


@dataclass(frozen=True)
class Program:
    """A block of Python and its place in the page."""

    place: str
    text: str
    prints: str | None
    """Expected output; None if it depends on the machine."""


def programs_of(page: Path) -> list[Program]:
    """Return the programs in the page's order; they share their variables."""
    text = page.read_text(encoding="utf-8")
    found: list[Program] = []
    for match in PROGRAM.finditer(text):
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


def messages_of(page: Path) -> dict[str, str]:
    """Return the messages by name, in the page's order."""
    return {m["name"]: m["text"] for m in MESSAGE.finditer(page.read_text(encoding="utf-8"))}


def wording(message: str) -> str:
    """Return a message with its figures replaced, to compare wordings."""
    return VARYING.sub("#", message)

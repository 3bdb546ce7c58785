"""The messages that a page explains: text blocks under `<!-- message: NAME -->`."""

from __future__ import annotations

import re
from pathlib import Path

BLOCK = re.compile(
    r"^<!-- message: (?P<name>[\w-]+) -->\n```text\n(?P<text>.*?)\n```$", re.DOTALL | re.MULTILINE
)
VARYING = re.compile(r"[0-9a-f]{64}|…|\d+(?:\.\d+)*")
"""Figures, versions and hashes: they are a machine's own."""


def messages_of(page: Path) -> dict[str, str]:
    """By name, in the page's order."""
    return {m["name"]: m["text"] for m in BLOCK.finditer(page.read_text(encoding="utf-8"))}


def wording(message: str) -> str:
    """What two messages have in common that differ in figures alone."""
    return VARYING.sub("#", message)

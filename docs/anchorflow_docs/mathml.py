"""Formulas as MathML, which browsers show by themselves: no script, no font from elsewhere."""

from __future__ import annotations

import re
from html import unescape

from latex2mathml.converter import convert

FORMULA = re.compile(
    r'<(?P<tag>div|span) class="arithmatex">\\[\[(](?P<latex>.*?)\\[\])]</(?P=tag)>', re.DOTALL
)
"""As pymdownx.arithmatex marks them: \\[…\\] on lines of their own, \\(…\\) inside one."""
SIZED = re.compile(r"\\[Bb]igg?[lr]?\b\s*")
"""Sizes of brackets, which MathML finds by itself."""


def formulas_as_mathml(html: str) -> str:
    """The page with each of its formulas converted."""

    def converted(match: re.Match[str]) -> str:
        display = "block" if match["tag"] == "div" else "inline"
        return convert(SIZED.sub("", unescape(match["latex"]).strip()), display=display)

    return FORMULA.sub(converted, html)

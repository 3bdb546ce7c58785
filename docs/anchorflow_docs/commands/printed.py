"""Find the commands that pages and module docstrings print for a reader to copy.

In a page these are the commands of fenced `sh` blocks and those between backticks; in a docstring,
indented lines and those between backticks. Text with words in capitals, brackets or `…` is a
template, not a command.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[3]
PAGES = ("README.md", "CONTRIBUTING.md")
WITHOUT = ("tests", "site", "data", "runs", "bundles", "artefacts")
"""Folders that are not read; hidden ones are not either."""
BLOCK = re.compile(r"^```(?P<language>\w*)\n(?P<text>.*?)^```$", re.DOTALL | re.MULTILINE)
# A command may be a heredoc, or continue after a backslash.
ONE = re.compile(
    r"^[^\n]*<<'(?P<end>\w+)'.*?^(?P=end)$|^(?:[^\n]*\\\n)*[^\n]*\S[^\n]*$",
    re.DOTALL | re.MULTILINE,
)
INLINE = re.compile(r"`([^`\n]+)`")
INDENTED = re.compile(r"^ {4,}(\S.*)$", re.MULTILINE)
PROGRAM = re.compile(
    r"([A-Z_]+=\S+ )*(\.venv/bin/)?(anchorflow|curl|docker|make|pip|pre-commit|python3?"
    r"|serve run|tensorboard|zenohd) "
)
STANDS_FOR = re.compile(
    r"…|\.\.\.|\[[^\]]* |\[--|(?<![\w=.$/'-])[A-Z_]{3,}(?![\w=])|(?<![\w=-])[A-Z]\b"
)
# A command's name in a sentence, such as `anchorflow plan`, `anchorflow bench load`.
NAME = re.compile(r"anchorflow( bench| data)?( [a-z-]+)?")


@dataclass(frozen=True)
class Command:
    """The text for a shell, and its place in a file."""

    place: str
    text: str

    @property
    def name(self) -> str:
        """The first command line without its comment, joined to one line."""
        joined = re.sub(r"\s*\\\n\s*", " ", self.text).partition("\n")[0]
        return re.sub(r"\s+# .*$", "", joined)


@cache
def printed() -> list[Command]:
    """Return all commands in the project's pages and modules."""
    folders = [each for each in ROOT.iterdir() if each.is_dir() and each.name not in WITHOUT]
    files = [ROOT / name for name in PAGES]
    for folder in folders:
        if not folder.name.startswith("."):
            files += [*folder.rglob("*.md"), *folder.rglob("*.py")]
    return [command for path in sorted(files) for command in commands_of(path)]


def printed_texts() -> dict[str, str]:
    """Return the texts of all commands by name."""
    return {command.name: command.text for command in printed()}


def commands_of(file: Path) -> Iterator[Command]:
    """Yield the commands of a page, or of a module's docstring."""
    text = file.read_text(encoding="utf-8")
    if file.suffix == ".py":
        yield from _of_docstring(file, ast.get_docstring(ast.parse(text)) or "")
    else:
        yield from _of_page(file, text)


def _of_page(file: Path, text: str) -> Iterator[Command]:
    for block in BLOCK.finditer(text):
        if block["language"] in ("sh", "bash", "console"):
            for one in ONE.finditer(block["text"]):
                yield Command(_place(file, text, block.start("text") + one.start()), one[0])
    prose = BLOCK.sub(lambda block: "\n" * block[0].count("\n"), text)
    for one in INLINE.finditer(prose):
        if _to_copy(one[1]):
            yield Command(_place(file, prose, one.start()), one[1])


def _of_docstring(file: Path, text: str) -> Iterator[Command]:
    for pattern in (INDENTED, INLINE):
        for one in pattern.finditer(text):
            if _to_copy(one[1]):
                yield Command(_place(file, text, one.start()), one[1])


def _to_copy(text: str) -> bool:
    return (
        PROGRAM.match(text) is not None
        and STANDS_FOR.search(text) is None
        and NAME.fullmatch(text) is None
    )


def _place(file: Path, text: str, at: int) -> str:
    return f"{file.name}, line {text.count(chr(10), 0, at) + 1}"

"""Every program that a page shows runs as it stands, and prints what the page says."""

from __future__ import annotations

from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path
from typing import Any

import pytest

from anchorflow_docs.programs import programs_of

DOCS = Path(__file__).parents[2] / "docs"
ADDRESS = "http://127.0.0.1:8000"
"""That the pages name."""


@pytest.mark.parametrize("name", ["index.md", "clients.md", "planner.md"])
def test_the_programs_of_a_page_run(name: str, url_of_both: str) -> None:
    seen: dict[str, Any] = {"__name__": "__main__"}
    programs = programs_of(DOCS / name)

    assert programs
    for program in programs:
        printed = StringIO()
        code = compile(program.text.replace(ADDRESS, url_of_both), program.place, "exec")
        with redirect_stdout(printed):
            exec(code, seen)
        if program.prints is not None:
            assert printed.getvalue() == program.prints, program.place


def test_a_program_is_what_stands_under_its_mark(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text(
        "```python\nnot = run\n```\n\n<!-- run -->\n```python\nprint(1)\n```\n\n"
        "<!-- prints -->\n```text\n1\n```\n<!-- run -->\n```python\nx = 2\n```\n"
    )

    first, second = programs_of(page)

    assert (first.place, first.text, first.prints) == ("page.md, line 7", "print(1)\n", "1\n")
    assert (second.text, second.prints) == ("x = 2\n", None)

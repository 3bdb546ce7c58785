"""Every program of a page runs unchanged, and prints the page's output."""

from __future__ import annotations

from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from anchorflow_docs.page_blocks import programs_of

DOCS = Path(__file__).parents[2] / "docs"
ADDRESS = "http://127.0.0.1:8000"  # in the pages
ROBOT_RADIUS = 0.25  # m, the default bundle's


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


class Arrived(Exception):
    """The robot has reached its goal."""


def test_the_control_loop_drives_round_the_obstacle_to_its_goal(url_of_both: str) -> None:
    """The loop on the page is too short to arrive, so it is extended."""
    (program,) = programs_of(DOCS / "planner.md")[:1]
    text = program.text.replace(ADDRESS, url_of_both)
    for old, new in (
        ("np.array([12.0, 0.0])", "np.array([4.0, 0.0])"),
        ("range(40)", "range(600)"),
        ("time.sleep(tick_s)", "time.sleep(tick_s); tick(state)"),
    ):
        assert old in text
        text = text.replace(old, new)
    driven: list[np.ndarray] = []

    def tick(state: np.ndarray) -> None:
        driven.append(state[:2].copy())
        if np.linalg.norm(state[:2] - [4.0, 0.0]) < 0.3:
            raise Arrived

    seen: dict[str, Any] = {"__name__": "__main__", "tick": tick}
    with pytest.raises(Arrived):
        exec(compile(text, program.place, "exec"), seen)

    rows, columns = np.nonzero(seen["occupancy"])
    cells = (np.stack([columns, rows], -1) + 0.5) * 0.08 - 5.12
    apart = np.abs(np.array(driven)[:, None] - cells) - 0.04
    assert np.linalg.norm(apart.clip(min=0.0), axis=-1).min() > ROBOT_RADIUS


def test_a_program_is_what_stands_under_its_mark(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text(
        "```python\nnot = run\n```\n\n<!-- run -->\n```python\nprint(1)\n```\n\n"
        "<!-- prints -->\n```text\n1\n```\n<!-- run -->\n```python\nx = 2\n```\n"
    )

    first, second = programs_of(page)

    assert (first.place, first.text, first.prints) == ("page.md, line 7", "print(1)\n", "1\n")
    assert (second.text, second.prints) == ("x = 2\n", None)

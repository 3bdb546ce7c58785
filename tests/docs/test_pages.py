"""What pages say is what the code does: programs, the tree of errors, the bytes of a request."""

from __future__ import annotations

import json
import re
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from anchorflow_client import (
    AnchorFlowError,
    AnchorRequest,
    OipCodec,
    RequestError,
    TransportError,
    UsageError,
)
from anchorflow_docs.page_blocks import programs_of

DOCS = Path(__file__).parents[2] / "docs"
ADDRESS = "http://127.0.0.1:8000"  # in the pages
BRANCH = re.compile(r"^[│├└─ ]*[├└]─ (\w+)", re.MULTILINE)
ROBOT_RADIUS = 0.25  # m, the default bundle's


@pytest.mark.parametrize(
    "name",
    [
        "index.md",
        "clients.md",
        "planner.md",
        "controller.md",
        "nav2.md",
        "people.md",
        "bodies.md",
    ],
)
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


def test_an_obstacle_function_of_ones_own_keeps_anchors_away(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(DOCS.parent)
    (program,) = programs_of(DOCS / "training.md")
    nearest = []
    for scale in ("20.0", "0.0"):
        seen: dict[str, Any] = {}
        text = program.text.replace("scale=20.0", f"scale={scale}")
        exec(compile(text, program.place, "exec"), seen)
        apart = (seen["anchors"].trajectories[..., :2] - seen["DOG"]).norm(dim=-1)
        nearest.append(float(apart.amin(-1).mean()))
        assert seen["anchors"].safe.all()
    assert nearest == pytest.approx([1.26, 0.30], abs=0.1)


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


def test_every_error_hangs_on_the_tree_in_its_place() -> None:
    kinds = (RequestError, TransportError, UsageError)
    expected = [name for kind in kinds for name in (kind, *kind.__subclasses__())]

    drawn = BRANCH.findall((DOCS / "clients.md").read_text(encoding="utf-8"))

    assert drawn == [kind.__name__ for kind in expected]
    assert all(issubclass(kind, AnchorFlowError) for kind in expected)


def test_the_shown_header_is_the_codecs() -> None:
    payload = OipCodec().encode_request(
        AnchorRequest.build(
            cost_map={"data": np.zeros((1, 64, 64)), "resolution": 0.16},
            x_curr=[-3, 0, 0, 0, 0, 0],
            x_goal=[3, 0, 0, 0],
            num_samples=4,
            seed=1,
            sampler={"method": "midpoint", "schedule": [0.0, 0.5, 1.0]},
            budget_ms=80.0,
            request_id="r1",
        )
    )
    page = (DOCS / "wire.md").read_text(encoding="utf-8")
    shown = re.search(r"Content-Length: (\d+)\n\n(\{.*?\})␠.*?\n(<.*>)\n```", page, re.DOTALL)
    assert shown is not None
    length, header, tensors = shown.groups()

    assert payload.header_length == int(length)
    assert json.loads(bytes(payload.body[: int(length)])) == json.loads(header)
    sizes = map(int, re.findall(r"<(\d+) bytes>", tensors))
    assert len(payload.body) == int(length) + sum(sizes)

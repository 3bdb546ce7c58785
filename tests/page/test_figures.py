"""What the page costs, and how it writes numbers.

The costs are the bytes of the first load, and how far the picture is behind the hand. Bytes are
held to their bound; times are measured, printed and kept as figures.json, not judged.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

sync_api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")

expect = sync_api.expect

PATIENCE_MS = 60_000
FIRST_LOAD_BYTES = 300 * 1000
DRAG_S = 1.0
MOVE_MS = 16


def test_the_first_load_with_its_first_answer_is_small(
    open_page: Callable[..., Any], artefacts: Path
) -> None:
    visit = open_page()
    visit.wait_for_anchors()
    finished = [request for request in visit.requests if request.response().ok]
    sizes = {request.url: request.sizes() for request in finished}

    bodies = {url: size["responseBodySize"] for url, size in sizes.items()}
    total = sum(size["responseBodySize"] + size["responseHeadersSize"] for size in sizes.values())
    answers = sum(size for url, size in bodies.items() if url.endswith("/anchors"))

    keep(
        artefacts,
        first_load={"requests": len(sizes), "bytes": total, "of which anchors": answers},
    )
    assert answers > 64 * 64 * 2 * 3 * 4
    assert total < FIRST_LOAD_BYTES


def test_how_far_the_picture_is_behind_a_dragged_goal(visit: Any, artefacts: Path) -> None:
    visit.locate("#sample").select_option("empty")
    visit.page.wait_for_timeout(1000)
    visit.page.evaluate("performance.clearMeasures('anchors-on-screen')")
    begin, end = visit.handle("goal"), visit.at((3.0, 3.0))
    moves = int(1e3 * DRAG_S / MOVE_MS)

    visit.page.mouse.move(*begin)
    visit.page.mouse.down()
    for move in range(moves):
        share = np.sin(4 * np.pi * move / moves) ** 2
        visit.page.mouse.move(*(b + share * (e - b) for b, e in zip(begin, end, strict=True)))
        visit.page.wait_for_timeout(MOVE_MS)
    visit.page.mouse.up()
    visit.page.wait_for_timeout(1000)

    script = "performance.getEntriesByName('anchors-on-screen').map(e => [e.duration, e.detail])"
    seen = visit.page.evaluate(script)
    engine = np.array([detail["engineMs"] for _, detail in seen])
    beyond = np.array([detail["roundTripMs"] for _, detail in seen]) - engine
    behind = np.array([duration for duration, _ in seen])
    keep(
        artefacts,
        drag={
            "answers": len(seen),
            "engine ms": spread(engine),
            "beyond the engine ms": spread(beyond),
            "behind the hand ms": spread(behind),
        },
    )
    assert len(seen) > 1
    assert (beyond > 0).all()


@pytest.mark.parametrize(
    ("value", "scores", "text"),
    [
        (1.84e-11, [1.84e-11, 0.0], "1.8e−11"),
        (0.0, [1.84e-11, 0.0], "0.00"),
        (-0.00456, [-0.00456, 0.001], "−0.0046"),
        (0.00456, [0.00456, -0.01], "0.00"),
        (0.00456, None, "0.00"),
        (-1.234, [-1.234], "−1.23"),
    ],
)
def test_a_number_has_two_significant_digits_where_all_are_tiny(
    call: Callable[..., Any], value: float, scores: list[float] | None, text: str
) -> None:
    assert call("dom", "(m, [value, all]) => m.figure(value, 2, all)", [value, scores]) == text


def test_scores_that_are_all_tiny_are_told_apart(
    open_page: Callable[..., Any], served_driving: Any, artefacts: Path
) -> None:
    """Of GoalFlow on an empty raster."""
    visit = open_page(served_driving.url)
    expect(visit.locate("#summary")).to_contain_text("64 anchors", timeout=PATIENCE_MS)

    tiny = re.compile(r"[1-9]\.\de−\d+")
    expect(visit.locate("#best tbody td:nth-child(2)").first).to_have_text(tiny)
    expect(visit.locate("#anchor-figures")).to_have_text(tiny)
    expect(visit.locate("#birds-eye-legend span").last).to_have_text(tiny)
    visit.page.screenshot(path=artefacts / "tiny-scores.png")


def spread(values: np.ndarray) -> dict[str, float]:
    return {f"p{q}": round(float(np.percentile(values, q)), 1) for q in (50, 95, 100)}


def keep(artefacts: Path, **figures: Any) -> None:
    """Add to figures.json, and print."""
    file = artefacts / "figures.json"
    kept = json.loads(file.read_text()) if file.exists() else {}
    file.write_text(json.dumps(kept | figures, indent=2) + "\n")
    print(json.dumps(figures))  # noqa: T201 - what this test is for

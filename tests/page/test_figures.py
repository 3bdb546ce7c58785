"""The bytes of the first load, and scores that are all tiny."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import pytest

sync_api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
expect = sync_api.expect

PATIENCE_MS = 60_000
FIRST_LOAD_BYTES = 300 * 1000


def test_the_first_load_with_its_first_answer_is_small(open_page: Callable[..., Any]) -> None:
    visit = open_page(own=True)  # with no file at hand
    visit.wait_for_anchors()
    finished = [request for request in visit.requests if request.response().ok]
    sizes = {request.url: request.sizes() for request in finished}

    total = sum(size["responseBodySize"] + size["responseHeadersSize"] for size in sizes.values())
    anchors = next(size for url, size in sizes.items() if url.endswith("/anchors"))

    assert anchors["responseBodySize"] > 64 * 64 * 2 * 3 * 4
    assert total < FIRST_LOAD_BYTES


def test_scores_that_are_all_tiny_are_told_apart(
    open_page: Callable[..., Any], served_all: Any
) -> None:
    """GoalFlow on an empty raster gives such scores."""
    visit = open_page(served_all.url)
    visit.page.route("**/page/samples/*", lambda route: route.fulfill(body=""))
    visit.wait_for_anchors()
    visit.locate("#bundle").select_option("goalflow")
    expect(visit.locate("#summary")).to_contain_text("No sample fits")
    visit.locate("#plan").click()
    expect(visit.locate("#summary")).to_contain_text("64 anchors,", timeout=PATIENCE_MS)

    tiny = re.compile(r"[1-9]\.\de−\d+")
    expect(visit.locate("#best tbody td:nth-child(2)").first).to_have_text(tiny)
    expect(visit.locate("#anchor-figures")).to_have_text(tiny)
    expect(visit.locate("#birds-eye-legend span").last).to_have_text(tiny)
    visit.keep("tiny-scores.png")

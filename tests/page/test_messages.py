"""Messages about refusals and about a service that is away."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from typing import Any

import pytest
from chromium import expect

REFUSED = "status of 422"
UNREACHABLE = "net::ERR_CONNECTION_REFUSED"
SHOWN = "what is shown is its last answer."
"""The end of the summary if the newest request has no response."""


def test_a_goal_in_an_obstacle_is_explained_beside_it(visit: Any) -> None:
    visit.choose_empty_map()
    spot = visit.at((1.0, 1.0))
    visit.drag(spot, spot)

    refused = visit.answer(
        lambda: visit.drag_end("goal", (1.0, 1.0)),
        lambda asked: asked["x_goal"][:2] == pytest.approx([1.0, 1.0], abs=0.05),
    )

    assert refused.status == 422
    bubble = visit.locate("#bubble")
    expect(bubble).to_contain_text("The goal cannot be there.")
    expect(bubble).to_contain_text(refused.answered["error"]["message"])
    expect(bubble).to_contain_text("x_goal: expected a cell of occupancy below 0.5")
    box, goal = bubble.bounding_box(), visit.handle("goal")
    assert abs(box["x"] + box["width"] / 2 - goal[0]) < 60
    assert 0 < goal[1] - (box["y"] + box["height"]) < 60
    # The last answer stays, with its figures faded.
    summary = visit.locate("#summary")
    expect(summary).to_have_text(f"The service refused: {SHOWN}")
    for told in ("#anchor-figures", "#times", "#charts", "#best", "#legend"):
        expect(visit.locate(told)).to_have_css("opacity", "0.4")
    visit.locate("#best tbody tr").nth(3).hover()
    expect(visit.locate("#anchor-name")).to_contain_text(re.compile(r"^Anchor \d+$"))
    expect(summary).to_have_text(f"The service refused: {SHOWN}")
    visit.keep("goal-in-obstacle.png")

    visit.drag_end("goal", (3.0, 1.0))
    expect(bubble).to_be_hidden()
    visit.wait_for_anchors()
    expect(visit.locate("#best")).to_have_css("opacity", "1")
    visit.forget_errors(REFUSED)


def test_a_map_planner_that_refuses_shows_nothing_of_the_one_before(camera: Any) -> None:
    refusal = {"error": {"code": "invalid_request", "message": "seed: no"}}
    camera.page.route("**/anchors", lambda route: route.fulfill(status=422, json=refusal))

    camera.locate("#bundle").select_option("flowmp-small")

    expect(camera.locate("#bubble")).to_contain_text("seed: no")
    expect(camera.locate("#summary")).to_have_text("The service refused.")
    for told in ("#anchor-figures", "#round-trip", "#times", "#charts", "#best tbody"):
        expect(camera.locate(told)).to_be_empty()
    expect(camera.locate("#best thead th")).to_have_count(0)
    expect(camera.locate("#legend")).to_be_hidden()
    camera.keep("refused-at-first.png")
    camera.forget_errors(REFUSED)


def test_a_service_that_stops_is_missed_and_taken_up_again(visit: Any, served: Any) -> None:
    visit.choose_empty_map()
    served.stop()
    try:
        expect(visit.locate("#banner")).to_be_visible()
        expect(visit.locate("#banner-text")).to_contain_text("The service does not answer.")
        expect(visit.locate("#link-text")).to_have_text("Not connected")
        visit.keep("stopped.png")
        visit.drag_end("goal", (-3.0, -3.0))
        back = visit.answer(
            served.start,
            lambda asked: asked["x_goal"][:2] == pytest.approx([-3.0, -3.0], abs=0.05),
        )
    finally:
        served.start()

    assert back.status == 200
    expect(visit.locate("#banner")).to_be_hidden()
    expect(visit.locate("#link")).to_have_attribute("data-state", "up")
    visit.forget_errors(UNREACHABLE, "status of 503")  # while it starts


def test_a_service_that_is_overloaded_is_waited_for(visit: Any) -> None:
    error = {"code": "overloaded", "message": "8 requests wait already; try again in 30 s"}
    visit.page.route(
        "**/anchors",
        lambda route: route.fulfill(
            status=429, headers={"Retry-After": "30"}, json={"error": error}
        ),
    )
    visit.locate("#seed").fill("7")
    visit.page.keyboard.press("Tab")

    banner = visit.locate("#banner-text")
    expect(banner).to_have_text(re.compile(r"^8 requests wait already\. Trying again in \d+ s\.$"))
    expect(visit.locate("#link-text")).to_have_text("Waiting for the service")
    expect(visit.locate("#summary")).to_have_text(f"Waiting for the service: {SHOWN}")
    visit.page.unroute("**/anchors")
    visit.answer(lambda: visit.locate("#retry").click(), lambda asked: asked["seed"] == 7)
    expect(visit.locate("#link-text")).to_contain_text("flowmp-small")
    visit.forget_errors("status of 429")


def test_what_the_service_still_compiles_is_waited_for_and_does_without(
    open_page: Callable[..., Any],
) -> None:
    def not_ready(message: str, field: str | None = None) -> Callable[[Any], None]:
        error = {"code": "not_ready", "message": message, "field": field}
        return lambda route: route.fulfill(status=503, json={"error": error})

    visit = open_page(at_once=False)
    starting = not_ready("the service is starting: it compiles")
    visit.page.route("**/openapi.json", starting)
    visit.page.route("**/v2/health/ready", starting, times=1)
    visit.open()
    banner = visit.locate("#banner-text")
    expect(banner).to_have_text("The service is starting: it compiles. This page waits for it.")
    expect(visit.locate("#retry")).to_be_hidden()
    visit.keep("starting.png")
    # It comes back between two requests, before the page has read what a request may hold.
    visit.page.wait_for_event(
        "response", lambda heard: heard.url.endswith("/health/ready") and heard.ok
    )
    visit.page.unroute("**/openapi.json")
    visit.wait_for_anchors()
    expect(visit.locate("#banner")).to_be_hidden()

    told = not_ready("obstacles: the loops are being compiled, for about 40 s more", "obstacles")
    visit.page.route("**/anchors", told)
    visit.locate("[data-tool=person]").click()
    visit.page.mouse.click(*visit.at((1.0, 1.0)))
    expect(banner).to_contain_text("preparing for people on the map, once on this machine, for ab")
    visit.page.unroute("**/anchors")
    visit.answer(
        lambda: visit.page.keyboard.press("Delete"), lambda asked: "obstacles" not in asked
    )
    expect(visit.locate("#banner")).to_be_hidden()
    visit.forget_errors("status of 503")
    assert visit.errors == []


@pytest.mark.skipif(shutil.which("curl") is None, reason="curl is not installed")
def test_a_service_that_requires_a_token_gets_one_and_copies_read_it_from_the_environment(
    open_page: Callable[..., Any], guarded: Any, copied: Callable[[Any, str], str]
) -> None:
    visit = open_page(guarded.url)
    expect(visit.locate("#token-form")).to_be_visible()
    # While the page waits for a token, a service that was away is taken up again.
    guarded.stop()
    expect(visit.locate("#banner")).to_be_visible()
    guarded.start()
    expect(visit.locate("#banner")).to_be_hidden()
    expect(visit.locate("#link-text")).to_have_text("Connecting")
    visit.locate("#token").fill("wrong")
    visit.page.keyboard.press("Enter")
    expect(visit.locate("#token-why")).to_contain_text("a token that is valid here")
    visit.locate("#token").fill("open\u200b sesame")
    visit.page.keyboard.press("Enter")
    expect(visit.locate("#token-why")).to_have_text(
        "token: expected characters of Latin-1, got U+200B in place 5"
    )

    visit.locate("#token").fill("open sesame")
    visit.page.keyboard.press("Enter")

    visit.wait_for_anchors()
    expect(visit.locate("#token-form")).to_be_hidden()
    visit.forget_errors(UNREACHABLE, "status of 503")  # while it starts
    visit.forget_errors("status of 401")
    assert visit.errors == []
    environment = {**os.environ, "ANCHORFLOW_TOKEN": "open sesame"}
    for button, shell in (("#copy-curl", "bash"), ("#copy-python", sys.executable)):
        text = copied(visit, button)
        assert "open sesame" not in text
        told = subprocess.run(
            [shell, "-c", text], check=True, capture_output=True, env=environment, timeout=120
        )
        assert b"trajectories" in told.stdout or b"anchors are safe" in told.stdout
    expect(visit.locate("#scene-note")).to_contain_text("it takes the token from ANCHORFLOW_TOKEN")

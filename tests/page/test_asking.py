"""Requests about a map: draw, drag, choose, and see the anchors change."""

from __future__ import annotations

import re
from collections.abc import Callable
from itertools import compress, pairwise
from typing import Any

import numpy as np
import pytest
from chromium import expect

from anchorflow_client.contract import OCCUPIED
from anchorflow_client.contract.fields import STYLES


def crosses(trajectory: Any, cost_map: Any) -> bool:
    """Return whether a point of a trajectory is in an obstacle."""
    grid = np.array(cost_map["data"][0]) >= OCCUPIED
    cells = (np.array(trajectory) - cost_map["origin"]) / cost_map["resolution"]
    columns, rows = np.clip(cells.astype(int), 0, np.array(grid.shape) - 1).T
    return bool(grid[rows, columns].any())


def test_it_opens_with_a_map_anchors_and_labels_of_all_controls(visit: Any, served: Any) -> None:
    expect(visit.locate("#best tbody tr")).to_have_count(10)
    expect(visit.locate("#charts svg")).to_have_count(3)
    expect(visit.locate("#link-text")).to_contain_text("flowmp")
    visit.keep("page.png")

    hosts = visit.page.evaluate("performance.getEntriesByType('resource').map(e => e.name)")
    assert hosts
    assert all(url.startswith(served.url) for url in hosts)

    labels = visit.locate("label.field:visible")
    kinds = labels.evaluate_all("labels => labels.map(label => label.control.localName)")
    assert len(kinds) >= 13
    assert set(kinds) == {"input", "select"}

    for role, name in (("slider", "Speed limit"), ("slider", "Anchors"), ("combobox", "Style")):
        expect(visit.locate(".ask").get_by_role(role, name=name)).to_have_count(1)
    visit.locate("label:has(#robot_radius) > span").click()
    expect(visit.locate("#robot_radius")).to_be_focused()


def test_nothing_can_be_chosen_before_a_planner_is_known(open_page: Callable[..., Any]) -> None:
    visit = open_page(at_once=False)
    held: list[Any] = []
    visit.page.route("**/v2/models", lambda route: held.append(route))  # noqa: PLW0108
    visit.open()
    expect(visit.locate("#link-text")).to_have_text("Connecting")

    expect(visit.locate("#layout")).to_have_attribute("inert", "")
    held[0].continue_()

    visit.wait_for_anchors()
    visit.locate("#seed").fill("7")
    visit.answer(lambda: visit.page.keyboard.press("Tab"), lambda asked: asked["seed"] == 7)
    assert visit.errors == []


def test_the_best_anchor_goes_round_risk_that_is_painted(visit: Any) -> None:
    visit.choose_empty_map()
    visit.locate("#layer").select_option("risk")
    expect(visit.locate("#cost")).to_be_visible()
    visit.locate("#brush").fill("1.6")

    answered = visit.answer(
        lambda: visit.drag(visit.at((0.0, -0.6)), visit.at((0.0, 0.6))),
        lambda asked: (
            len(asked["cost_map"]["data"]) == 3 and bool(np.any(asked["cost_map"]["data"][2]))
        ),
    )
    visit.page.wait_for_timeout(300)
    visit.keep("page_risk.png")
    assert not visit.occupied(answered.asked).any()
    assert np.min(answered.asked["cost_map"]["data"][1]) == 1.0

    settled = visit.answer(
        lambda: visit.locate("#cost_penalty").fill("6"), lambda asked: asked["cost_penalty"] == 6
    )
    best = np.argmax(settled.answered["scores"])
    path = np.array(settled.answered["trajectories"][best])
    near = np.hypot(path[:, 0], np.maximum(np.abs(path[:, 1]) - 0.6, 0.0))
    assert near.min() > 0.7


def test_anchors_go_round_a_wall_that_is_drawn(visit: Any) -> None:
    before = visit.choose_empty_map()
    visit.page.wait_for_timeout(300)
    picture = visit.picture()
    wall = visit.at((0.0, 2.0)), visit.at((0.0, -1.0))

    after = visit.answer(
        lambda: visit.drag(*wall, steps=12), lambda asked: visit.occupied(asked)[40:65, 47:49].all()
    )

    assert not visit.occupied(before.asked).any()
    assert all(crosses(path, after.asked["cost_map"]) for path in before.answered["trajectories"])
    safe = [*compress(after.answered["trajectories"], after.answered["safe"])]
    assert len(safe) > 32
    assert not any(crosses(path, after.asked["cost_map"]) for path in safe)
    expect(visit.locate("#summary")).to_have_text(
        re.compile(rf"^{len(safe)} of 64 anchors are safe, \d+\.\d to \d+\.\d s\.$")
    )
    visit.wait_for_another_picture(picture)
    visit.keep("wall.png")


def test_what_was_painted_can_be_undone_and_erased(visit: Any) -> None:
    visit.choose_empty_map()
    line = visit.at((-1.0, 2.0)), visit.at((1.0, 2.0))
    painted = visit.answer(
        lambda: visit.drag(*line), lambda asked: visit.occupied(asked).sum() > 60
    )
    undone = visit.answer(
        lambda: visit.locate("#undo").click(), lambda asked: not visit.occupied(asked).any()
    )
    visit.drag(*line)
    visit.page.keyboard.press("e")
    erased = visit.answer(lambda: visit.drag(*line), lambda asked: not visit.occupied(asked).any())

    assert visit.occupied(painted.asked).any()
    assert undone.asked["cost_map"] == erased.asked["cost_map"]


def test_a_style_is_chosen_by_name_dragged_and_moved_by_keys(visit: Any) -> None:
    name = visit.locate("#style-name")
    expect(name).to_have_value("balanced")
    expect(name.locator("[value=custom]")).to_be_hidden()
    visit.answer(
        lambda: name.select_option("efficient"),
        lambda asked: asked["w_style"] == pytest.approx(STYLES["efficient"]),
    )
    expect(visit.locate("#style-text")).to_have_text("20 · 50 · 30")
    visit.page.wait_for_timeout(300)
    picture = visit.picture()
    box = visit.locate("#triangle").bounding_box()
    energy = box["x"] + 0.1 * box["width"], box["y"] + 0.9 * box["height"]
    knob = visit.locate("#knob").bounding_box()

    dragged = visit.answer(
        lambda: visit.drag((knob["x"] + 8, knob["y"] + 8), energy),
        lambda asked: asked["w_style"][1] > 0.99,
    )
    visit.wait_for_another_picture(picture)
    expect(name).to_have_value("custom")
    visit.locate("#knob").focus()
    by_key = visit.answer(
        lambda: visit.page.keyboard.press("ArrowUp"),
        lambda asked: asked["w_style"][0] > dragged.asked["w_style"][0],
    )

    assert sum(dragged.asked["w_style"]) == pytest.approx(1, abs=2e-3)
    assert by_key.asked["w_style"][1] < dragged.asked["w_style"][1]
    expect(visit.locate("#knob")).to_have_attribute(
        "aria-valuetext", "safety 5 %, energy 95 %, smooth 0 %"
    )


def test_the_form_sets_the_fields_of_the_request(visit: Any) -> None:
    visit.locate("#num_samples").fill("16")
    visit.locate("#sampler-method").select_option("heun")
    visit.locate("#sampler-schedule-uniform").fill("3")
    visit.locate("#sampler-schedule-uniform").press("Enter")
    visit.locate("#refine-safety_margin").fill("0.2")
    visit.locate("#refine-guidance").fill("0.5")
    visit.locate("#refine-certified_margin").fill("0.1")
    answered = visit.answer(
        lambda: visit.locate("#refine-barrier").check(), lambda asked: asked["refine"]["barrier"]
    )

    assert answered.status == 200
    assert answered.asked["num_samples"] == 16
    assert answered.asked["sampler"] == {"method": "heun", "schedule": {"uniform": 3}}
    assert answered.asked["refine"] == {
        "smooth": True,
        "project": True,
        "safety_margin": 0.2,
        "guidance": 0.5,
        "barrier": True,
        "certified_margin": 0.1,
    }
    safe, clearance = (np.array(answered.answered[name]) for name in ("safe", "clearance"))
    assert safe.any()
    assert (clearance[safe] >= 0.1).all()
    own = visit.answer(
        lambda: visit.locate("#sampler-method").select_option(""),
        lambda asked: "sampler" not in asked,
    )
    assert len(own.answered["trajectories"]) == 16
    expect(visit.locate("#sampler-schedule-uniform")).to_be_disabled()


def test_the_robot_has_the_limits_of_the_card(visit: Any) -> None:
    own_times = re.compile(r"anchors are safe, \d+\.\d to \d+\.\d s\.$")
    expect(visit.locate("#summary")).to_have_text(own_times)
    expect(visit.locate("#v_max-hint")).to_contain_text("0.2 to 6 m/s.")
    expect(visit.locate("#v_max")).to_have_attribute("max", "6")
    visit.locate("#v_max").fill("0.5")
    visit.locate("#a_max").fill("2.5")
    visit.locate("#robot_radius").fill("0.2")
    visit.locate("#horizon_s").fill("25")

    answered = visit.answer(
        lambda: visit.page.keyboard.press("Tab"), lambda asked: asked.get("horizon_s") == 25
    )

    names = ("v_max", "a_max", "robot_radius")
    assert [answered.asked[name] for name in names] == [0.5, 2.5, 0.2]
    charts = visit.locate("#charts")
    expect(charts).to_contain_text("25.0 s")
    expect(charts).to_contain_text("limit 0.5")
    visit.locate("#refine-guidance").scroll_into_view_if_needed()
    visit.keep("another-robot.png")
    visit.locate("#horizon_s").fill("")
    free = visit.answer(
        lambda: visit.page.keyboard.press("Tab"), lambda asked: "horizon_s" not in asked
    )
    assert free.status == 200


def test_a_field_that_is_added_to_the_schema_gets_a_row_and_is_sent(
    open_page: Callable[..., Any],
) -> None:
    visit = open_page(at_once=False)
    field = {"type": "number", "minimum": 0, "maximum": 4, "default": None, "x-unit": "m"}

    def answer(route: Any) -> None:
        told = route.fetch()
        schema = told.json()
        body = schema["paths"]["/anchors"]["post"]["requestBody"]["content"]["application/json"]
        name = body["schema"]["$ref"].rpartition("/")[2]
        added = {"wheel_base": field | {"description": "Distance between axles."}}
        schema["components"]["schemas"][name]["properties"] |= added
        route.fulfill(response=told, json=schema)

    visit.page.route("**/openapi.json", answer)
    visit.open()
    visit.wait_for_anchors()
    row = visit.locate(".row:has(#wheel_base)")
    expect(row).to_contain_text("Wheel base")
    expect(row).to_contain_text("Distance between axles. 0 to 4 m.")

    visit.locate("#wheel_base").fill("2.5")
    asked = visit.answer(
        lambda: visit.page.keyboard.press("Tab"), lambda asked: "wheel_base" in asked
    )

    assert asked.asked["wheel_base"] == 2.5
    expect(visit.locate("#bubble")).to_contain_text("wheel_base")
    visit.forget_errors("status of 422")


def test_while_the_goal_is_dragged_one_request_is_out_and_the_newest_wins(visit: Any) -> None:
    visit.choose_empty_map()
    visit.page.evaluate("performance.clearResourceTimings()")
    moves = 60

    last = visit.answer(
        lambda: visit.drag(visit.handle("goal"), visit.at((2.0, 3.0)), steps=moves),
        lambda asked: asked["x_goal"][:2] == pytest.approx([2.0, 3.0], abs=0.03),
    )

    assert last.status == 200
    visit.page.wait_for_timeout(500)
    spans = visit.page.evaluate(
        "performance.getEntriesByType('resource').filter(e => e.name.endsWith('/anchors'))"
        ".map(e => [e.startTime, e.responseEnd])"
    )
    assert 1 <= len(spans) < moves
    assert all(ended <= begun for (_, ended), (begun, _) in pairwise(spans))


@pytest.mark.parametrize(
    ("name", "edge", "key"),
    [
        ("goal", (4.8, 4.8), None),
        ("start", (-4.8, 0.0), "Shift+ArrowLeft"),
    ],
)
def test_an_end_comes_back_from_the_edge(
    visit: Any, name: str, edge: tuple[float, float], key: str | None
) -> None:
    visit.choose_empty_map()
    field = {"start": "x_curr", "goal": "x_goal"}[name]
    away = visit.answer(
        lambda: visit.drag_end(name, edge),
        lambda asked: asked[field][:2] == pytest.approx(edge, abs=0.06),
    )
    if key:
        visit.locate(f"[data-handle={name}-velocity]").focus()
        away = visit.answer(
            lambda: visit.page.keyboard.press(key), lambda asked: asked[field][2] != 0
        )
    visit.keep(f"{name}-at-the-edge.png")

    back = visit.answer(
        lambda: visit.drag_end(name, (1.0, 2.0)), lambda asked: asked[field] != away.asked[field]
    )

    assert back.asked[field][:2] != away.asked[field][:2]
    assert back.asked[field][2:4] == away.asked[field][2:4]

"""Zoom and pan of the map, and places as numbers."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from chromium import expect

MAP_M = 9.6
WHEEL = 600.0
LARGER = float(np.exp(0.0016 * WHEEL))


def read(visit: Any) -> tuple[float, float, str]:
    """The place under the cursor, and what is there."""
    place, _, ground = visit.locate("#cursor").inner_text().replace("−", "-").partition(" m · ")
    x, y = map(float, place.split(", "))
    return x, y, ground


def test_what_is_drawn_and_dragged_on_a_larger_map_is_where_it_is_shown(visit: Any) -> None:
    visit.choose_empty_map()
    metre = visit.locate("#canvas").bounding_box()["width"] / MAP_M
    mouse = visit.page.mouse
    spot = visit.at((3.73, 1.02))
    mouse.move(*spot)
    mouse.wheel(0, -WHEEL)
    expect(visit.locate("#zoom-all")).to_be_enabled()
    mouse.move(spot[0] + 1, spot[1])
    mouse.move(*spot)
    assert read(visit)[:2] == pytest.approx([3.73, 1.02], abs=0.02)

    left = (spot[0] - LARGER * metre, spot[1])
    told = visit.answer(lambda: visit.drag(left, left), lambda asked: visit.occupied(asked).any())
    rows, columns = np.nonzero(visit.occupied(told.asked))
    middle = [0.1 * (cells.mean() + 0.5) - MAP_M / 2 for cells in (columns, rows)]
    assert middle == pytest.approx([2.73, 1.02], abs=0.06)
    assert read(visit)[2] == "obstacle"

    goal = visit.handle("goal")
    up = (goal[0], goal[1] - LARGER * metre)
    told = visit.answer(
        lambda: visit.drag(goal, up),
        lambda asked: asked["x_goal"][1] == pytest.approx(1.0, abs=0.03),
    )
    assert told.asked["x_goal"][0] == pytest.approx(4.0, abs=0.03)
    # The start is beyond the part that is shown; dragged with the middle button, it comes back.
    expect(visit.locate("[data-handle=start]")).to_be_hidden()
    visit.keep("larger.png")
    mouse.move(*spot)
    mouse.down(button="middle")
    mouse.move(spot[0] + 3000, spot[1], steps=3)
    mouse.up(button="middle")
    expect(visit.locate("[data-handle=start]")).to_be_visible()
    asked = visit.occupied(visit.answer(lambda: visit.locate("#reseed").click(), bool).asked)
    assert asked.sum() == len(rows)

    visit.page.keyboard.press("0")
    expect(visit.locate("#zoom-all")).to_be_disabled()
    assert visit.handle("goal") == pytest.approx(visit.at(told.asked["x_goal"][:2]), abs=2)


def test_ends_are_typed_in_step_with_their_handles(visit: Any) -> None:
    visit.choose_empty_map()
    goal = visit.locate("[data-end=goal][data-part=x]")
    expect(goal).to_have_value("4")
    goal.fill("1.25")
    told = visit.answer(
        lambda: visit.page.keyboard.press("Enter"), lambda asked: asked["x_goal"][0] == 1.25
    )
    assert told.status == 200
    assert visit.handle("goal") == pytest.approx(visit.at((1.25, 0.0)), abs=3)
    # Off the map is at its edge; a heading appears with a shape.
    goal.fill("40")
    visit.page.keyboard.press("Tab")
    expect(goal).to_have_value("4.75")
    heading = visit.locate("[data-end=start][data-part=heading]")
    expect(heading).to_be_hidden()
    visit.locate("#shape").select_option("rectangle")
    heading.fill("90")
    told = visit.answer(
        lambda: visit.page.keyboard.press("Tab"),
        lambda asked: asked["x_curr"][2] == pytest.approx(np.pi / 2, abs=1e-3),
    )
    assert told.status == 200

"""A robot with an outline and wheels: chosen, turned, sent, saved and driven."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from chromium import expect


@pytest.fixture
def cart(visit: Any) -> Any:
    """The empty map with a rectangle on a differential drive; the exchange about both."""
    visit.choose_empty_map()
    visit.locate("#shape").select_option("rectangle")
    visit.exchange = visit.answer(
        lambda: visit.locate("#kinematics-kind").select_option("differential"),
        lambda asked: asked.get("kinematics", {}).get("kind") == "differential",
    )
    return visit


def turned(asked: Any, heading: float) -> bool:
    """Return whether the start of a request has a heading."""
    return asked["x_curr"][2] == pytest.approx(heading, abs=0.05)


def test_a_rectangle_on_wheels_is_sent_turned_and_a_disc_again(cart: Any) -> None:
    asked, answered = cart.exchange.asked, cart.exchange.answered

    assert cart.exchange.status == 200
    outline = np.array(asked["footprint"])
    assert np.abs(outline).max(axis=0) == pytest.approx([0.45, 0.31])
    assert "sampler" not in asked
    assert np.shape(answered["trajectories"]) == (64, 64, 3)
    assert all(answered["safe"])
    expect(cart.locate("#replay")).to_be_disabled()
    expect(cart.locate("#sampler-method")).to_be_hidden()
    expect(cart.locate("#kinematics-reverse")).to_be_visible()
    cart.keep("body.png")

    x, y = cart.at((-4.0, 0.0))
    backwards = (x - 26, y)
    moved = cart.answer(
        lambda: cart.drag(cart.handle("start-velocity"), backwards),
        lambda asked: turned(asked, np.pi),
    )
    assert moved.asked["x_curr"][3:5] == pytest.approx([0, 0], abs=0.05)
    tip = cart.locate("[data-handle=start-velocity]")
    expect(tip).to_have_attribute("aria-label", "Start heading 180°, speed 0.00 m/s")

    cart.answer(
        lambda: cart.page.keyboard.press("Shift+ArrowRight"),
        lambda asked: turned(asked, np.pi - 5 * np.pi / 36),
    )
    fast = cart.answer(
        lambda: cart.page.keyboard.press("Shift+ArrowUp"),
        lambda asked: np.hypot(*asked["x_curr"][3:5]) > 0.4,
    )
    heading, velocity = fast.asked["x_curr"][2], fast.asked["x_curr"][3:5]
    assert np.arctan2(velocity[1], velocity[0]) == pytest.approx(heading, abs=1e-3)

    cart.locate("#kinematics-kind").select_option("")
    disc = cart.answer(
        lambda: cart.locate("#shape").select_option("disc"),
        lambda asked: "footprint" not in asked and len(asked["x_curr"]) == 6,
    )
    assert "kinematics" not in disc.asked
    assert "sampler" in disc.asked
    expect(cart.locate("#kinematics-omega_max")).to_be_hidden()


def test_a_body_is_saved_opened_and_copied(
    cart: Any, tmp_path: Path, copied: Callable[[Any, str], str]
) -> None:
    with cart.page.expect_download() as caught:
        cart.locate("#save").click()
    saved = tmp_path / "scene.json"
    caught.value.save_as(saved)
    scene = json.loads(saved.read_text())
    assert scene["kinematics"]["kind"] == "differential"
    assert len(scene["footprint"]) == 4
    assert len(scene["x_curr"]) == 9
    assert "footprint=[[0.45, 0.31]" in copied(cart, "#copy-python")

    scene["footprint"] = [[0.5, 0], [-0.2, 0.3], [-0.2, -0.3]]
    saved.write_text(json.dumps(scene))
    opened = cart.answer(
        lambda: cart.locate("#files").set_input_files(saved),
        lambda asked: len(asked.get("footprint", [])) == 3,
    )
    assert opened.status == 200
    expect(cart.locate("#shape")).to_have_value("polygon")
    expect(cart.locate("#scene-note")).to_have_text("scene.json is open.")


def test_the_robot_drives_along_its_heading(cart: Any) -> None:
    cart.locate("#drive").click()
    states: list[np.ndarray] = []

    def moves(asked: Any) -> bool:
        states.append(np.array(asked["x_curr"]))
        return states[-1][0] > 0.0

    driven = cart.answer(lambda: None, moves)
    assert "warm_start" not in driven.asked
    for state in states:
        sideways = state[4] * np.cos(state[2]) - state[3] * np.sin(state[2])
        assert abs(sideways) < 0.05
    assert driven.asked["x_goal"][2] == pytest.approx(0.0, abs=0.02)
    cart.keep("body-drive.png")
    cart.locate("#drive").click()
    expect(cart.locate("#drive")).to_have_text("Drive")

"""People on the map: put, sent, moved and removed, on the time bar and while the robot drives."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from chromium import expect

ROBOT_RADIUS = 0.25  # m, the default bundle's


def people_in(asked: Any) -> np.ndarray:
    """Return [M, 5] position, velocity and radius of a request."""
    obstacles = asked.get("obstacles")
    if obstacles is None:
        return np.zeros((0, 5))
    parts = (obstacles["position"], obstacles["velocity"], np.c_[obstacles["radius"]])
    return np.concatenate([*map(np.asarray, parts)], axis=1)


@pytest.fixture
def crossing(visit: Any) -> Any:
    """The empty map with a person who crosses the straight way; the exchange about both."""
    visit.choose_empty_map()
    visit.locate("[data-tool=person]").click()
    # Shorter drags on the way to the end of this one give less than 1.3 m/s.
    visit.exchange = visit.answer(
        lambda: visit.drag(visit.at((0.0, -3.0)), visit.at((0.0, -2.0))),
        lambda asked: len(people_in(asked)) == 1 and people_in(asked)[0, 3] > 1.3,
    )
    return visit


def test_anchors_keep_clear_of_a_person_who_walks_on_the_time_bar_and_is_saved(
    crossing: Any, copied: Callable[[Any, str], str]
) -> None:
    (person,) = people_in(crossing.exchange.asked)
    answered = crossing.exchange.answered

    assert person[[0, 1, 4]] == pytest.approx([0.0, -3.0, 0.3], abs=0.05)
    assert person[2] == pytest.approx(0.0, abs=0.05)
    assert sum(answered["safe"]) > 32
    paths, dts = np.array(answered["trajectories"]), np.broadcast_to(answered["dt"], 64)
    times = np.arange(paths.shape[1]) * dts[:, None]
    apart = np.hypot(*(paths - person[:2] - times[..., None] * person[2:4]).transpose(2, 0, 1))
    assert apart[answered["safe"]].min() > person[4] + ROBOT_RADIUS
    crossing.keep("people.png")

    longest = max(crossing.exchange.answered["dt"]) * 63
    expect(crossing.locate("#walk-text")).to_have_text("0.0 s")
    assert float(crossing.locate("#walk-time").get_attribute("max")) == pytest.approx(
        longest, abs=0.05
    )
    crossing.page.wait_for_timeout(300)
    now = crossing.picture()

    crossing.locate("#walk-time").fill("2")
    expect(crossing.locate("#walk-text")).to_have_text("2.0 s")
    crossing.wait_for_another_picture(now)
    crossing.keep("people_later.png")

    crossing.locate("#walk-play").click()
    expect(crossing.locate("#walk-play")).to_have_attribute("aria-label", "Stop")
    # It ends with the longest anchor.
    expect(crossing.locate("#walk-text")).to_have_text(f"{longest:.1f} s")
    expect(crossing.locate("#walk-play")).to_have_attribute("aria-label", "Play")
    expect(crossing.locate("#replay")).to_be_disabled()

    with crossing.page.expect_download() as download:
        crossing.locate("#save").click()
    text = download.value.path().read_text()
    saved = people_in(json.loads(text))
    assert saved == pytest.approx(people_in(crossing.exchange.asked))
    assert "obstacles={" in copied(crossing, "#copy-python")

    crossing.answer(
        lambda: crossing.locate("#another").click(), lambda asked: not len(people_in(asked))
    )
    scene = {"name": "scene.json", "mimeType": "application/json", "buffer": text.encode()}
    opened = crossing.answer(
        lambda: crossing.locate("#files").set_input_files(scene),
        lambda asked: len(people_in(asked)),
    )
    assert people_in(opened.asked) == pytest.approx(saved)


def test_a_person_is_moved_and_removed_by_keyboard(crossing: Any) -> None:
    expect(crossing.locate("[data-handle=person-1]")).to_be_focused()
    moved = crossing.answer(
        lambda: crossing.page.keyboard.press("Shift+ArrowRight"),
        lambda asked: people_in(asked)[0, 0] > 0.3,
    )
    assert people_in(moved.asked)[0, 0] == pytest.approx(0.5, abs=0.05)

    crossing.locate("[data-handle=person-1-velocity]").focus()
    crossing.answer(
        lambda: crossing.page.keyboard.press("Shift+ArrowLeft"),
        lambda asked: people_in(asked)[0, 2] < -0.4,
    )
    crossing.answer(
        lambda: crossing.page.keyboard.press("Delete"), lambda asked: not len(people_in(asked))
    )
    expect(crossing.locate("#walk")).to_be_hidden()
    crossing.answer(lambda: crossing.locate("#undo").click(), lambda asked: len(people_in(asked)))


def test_people_are_put_by_keyboard_and_erased(visit: Any) -> None:
    visit.choose_empty_map()
    visit.locate("#canvas").focus()
    visit.page.keyboard.press("p")
    visit.page.keyboard.press("Shift+ArrowUp")
    put = visit.answer(
        lambda: visit.page.keyboard.press("Space"), lambda asked: len(people_in(asked))
    )
    assert people_in(put.asked)[0] == pytest.approx([-4.0, 0.5, 0, 0, 0.3], abs=0.05)

    visit.page.keyboard.press("e")
    above, below = visit.at((-4.0, 1.5)), visit.at((-4.0, 0.3))
    visit.answer(lambda: visit.drag(above, below), lambda asked: not len(people_in(asked)))


def test_people_walk_while_the_robot_drives(crossing: Any) -> None:
    pace = people_in(crossing.exchange.asked)[0, 3]
    first = crossing.answer(
        lambda: crossing.locate("#drive").click(), lambda asked: people_in(asked)[0, 1] > -2.9
    )
    later = crossing.answer(lambda: None, lambda asked: people_in(asked)[0, 1] > 0.0)
    expect(crossing.locate("#walk")).to_be_hidden()
    # At the map's edge they turn back.
    back = crossing.answer(lambda: None, lambda asked: people_in(asked)[0, 3] < 0.0)

    assert people_in(first.asked)[0, 3] == people_in(later.asked)[0, 3] == pace
    assert later.asked["x_curr"][0] > -4.0
    assert people_in(back.asked)[0, 1] < 4.8
    crossing.locate("#drive").click()
    expect(crossing.locate("#walk")).to_be_visible()

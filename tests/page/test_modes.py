"""Looking at anchors, the replay and the robot, also by keyboard and on a phone."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from chromium import expect

PATIENCE_MS = 60_000
PHONE = {"has_touch": True, "is_mobile": True, "device_scale_factor": 2}


def test_anchors_are_looked_at_coloured_and_replayed(visit: Any) -> None:
    expect(visit.locate("#anchor-name")).to_have_text("Best anchor")
    second = visit.locate("#best tbody button").nth(1)
    number = second.inner_text()
    second.focus()
    expect(visit.locate("#anchor-name")).to_have_text(f"Anchor {number}")
    visit.page.keyboard.press("Tab")
    expect(visit.locate("#anchor-name")).not_to_have_text(f"Anchor {number}")

    for by in ("speed", "clearance"):
        visit.page.wait_for_timeout(300)
        picture = visit.picture()
        visit.page.get_by_text(by.capitalize(), exact=True).first.click()
        expect(visit.locate("#legend")).to_have_attribute("data-by", by)
        visit.wait_for_another_picture(picture)

    visit.page.wait_for_timeout(300)
    finished = visit.picture()
    flow = visit.answer(
        lambda: visit.locate("#replay").click(), lambda asked: asked["seed"] == 0, to="/page/flow"
    )
    assert flow.answered["times"] == [0.0, 0.5, 1.0]
    assert np.array(flow.answered["positions"]).shape == (3, 64, 64, 2)
    expect(visit.locate("#scrub")).to_be_visible()
    visit.locate("#flow-time").fill("0")
    expect(visit.locate("#flow-text")).to_have_text("t = 0.00")
    visit.wait_for_another_picture(finished)
    visit.keep("flow.png")
    visit.page.keyboard.press("Escape")
    expect(visit.locate("#scrub")).to_be_hidden()


@pytest.mark.parametrize("open_by_then", [True, False])
def test_an_answer_ends_the_replay_of_the_one_before(visit: Any, open_by_then: bool) -> None:
    flows: list[Any] = []
    answers: list[Any] = []

    def let_go(held: list[Any]) -> None:
        while not held:
            visit.page.wait_for_timeout(20)
        held[0].continue_()

    visit.page.route("**/page/flow", lambda route: flows.append(route))  # noqa: PLW0108
    visit.page.route("**/anchors", lambda route: answers.append(route))  # noqa: PLW0108
    visit.locate("#num_samples").fill("16")
    visit.locate("#replay").click()
    if open_by_then:
        let_go(flows)
        expect(visit.locate("#scrub")).to_be_visible()

    let_go(answers)

    expect(visit.locate("#summary")).to_contain_text("of 16 anchors are safe")
    if not open_by_then:
        with visit.page.expect_response("**/page/flow"):
            let_go(flows)
        visit.page.wait_for_timeout(300)
    expect(visit.locate("#scrub")).to_be_hidden()
    expect(visit.locate("#replay")).to_have_attribute("aria-pressed", "false")
    expect(visit.locate("#replay")).to_have_text("Replay the flow")


def test_a_robot_drives_and_plans_again(visit: Any) -> None:
    visit.choose_empty_map()
    visit.locate("#num_samples").fill("16")

    first = visit.answer(
        lambda: visit.locate("#drive").click(), lambda asked: asked["num_samples"] == 16
    )
    # On its way, the last plan is the warm start, and the robot's own state is the start.
    later = visit.answer(
        lambda: None, lambda asked: "warm_start" in asked and asked["x_curr"][0] > -3.5
    )
    visit.keep("drive.png")

    assert first.asked["x_curr"][:2] == pytest.approx([-4.0, 0.0], abs=0.1)
    assert later.asked["x_curr"][2] > 0.1
    assert np.array(later.asked["warm_start"]["trajectory"]).shape == (64, 6)
    # A wall in its way is a new scene, for which the plan was not made.
    wall = visit.at((2.0, 1.0)), visit.at((2.0, -1.0))
    walled = visit.answer(
        lambda: visit.drag(*wall),
        lambda asked: visit.occupied(asked).any() and "warm_start" not in asked,
    )
    assert walled.answered["safe"].count(True) > 0
    visit.locate("#drive").click()
    expect(visit.locate("#drive-note")).to_be_hidden()


@pytest.fixture
def way(visit: Any) -> Callable[[], np.ndarray]:
    """Return a function for [K, 3] s, m, m: time and place of the robot in each frame."""
    visit.choose_empty_map()
    visit.locate("#num_samples").fill("16")
    visit.locate("[data-handle=start]").evaluate("""handle => {
        window.way = [[0, NaN, NaN]];
        const note = () => {
            const [x, y] = handle.ariaLabel.match(/-?\\d+\\.\\d+/g).map(Number);
            window.way.push([performance.now() / 1e3, x, y]);
        };
        new MutationObserver(note).observe(handle, { attributeFilter: ["aria-label"] });
    }""")
    return lambda: np.array(visit.page.evaluate("window.way.slice(1)"))


def wait_until_it_is(visit: Any, where: Callable[[float], bool]) -> None:
    """Wait until the x of the robot satisfies a condition."""
    for _ in range(PATIENCE_MS // 50):
        if where(visit.page.evaluate("window.way.at(-1)[1]")):
            return
        visit.page.wait_for_timeout(50)
    pytest.fail("the robot does not get there")


def test_a_robot_never_jumps_however_late_answers_are(
    visit: Any, way: Callable[[], np.ndarray]
) -> None:
    def delay(route: Any) -> None:
        visit.page.wait_for_timeout(1200)
        route.continue_()

    visit.page.route("**/anchors", delay)
    visit.locate("#drive").click()
    wait_until_it_is(visit, lambda x: x > -3.0)
    visit.locate("[data-handle=goal]").focus()
    for _ in range(4):
        visit.page.keyboard.press("Shift+ArrowUp")
    wait_until_it_is(visit, lambda x: x > -1.0)

    visit.page.unroute_all(behavior="wait")
    time, *place = way().T
    v_max = float(visit.locate("#v_max").input_value())
    gone = np.hypot(*np.diff(place))
    assert (gone - 1.05 * v_max * np.diff(time)).max() < 0.1


def test_a_robot_that_was_made_slower_drives_on_from_rest(
    visit: Any, way: Callable[[], np.ndarray]
) -> None:
    visit.locate("#drive").click()
    wait_until_it_is(visit, lambda x: x > -1.0)
    visit.locate("#v_max").fill("0.6")

    visit.page.wait_for_timeout(500)
    wait_until_it_is(visit, lambda x: x > 2.0)

    x = way()[:, 1]
    back = np.maximum.accumulate(x) - x
    assert back.max() < 0.03


def test_the_pointer_shows_a_line_and_the_keyboard_is_enough(visit: Any) -> None:
    visit.choose_empty_map()
    visit.page.mouse.move(*visit.at((0.0, 3.5)))
    expect(visit.locate("#anchor-name")).to_have_text("Best anchor")
    visit.page.mouse.move(*visit.at((0.0, 0.0)))
    expect(visit.locate("#charts .now")).to_have_count(3)
    expect(visit.locate("#anchor-name")).not_to_have_text("Best anchor")

    visit.locate("[data-handle=goal]").focus()
    moved = visit.answer(
        lambda: visit.page.keyboard.press("Shift+ArrowDown"),
        lambda asked: asked["x_goal"][1] < -0.4,
    )
    assert moved.asked["x_goal"][1] == pytest.approx(-0.5, abs=0.05)

    visit.locate("[data-handle=goal-velocity]").focus()
    faster = visit.answer(
        lambda: visit.page.keyboard.press("Shift+ArrowRight"), lambda asked: asked["x_goal"][2] > 0
    )
    assert faster.asked["x_goal"][2:] == pytest.approx([0.5, 0.0])

    visit.locate("#canvas").focus()
    for key in ("ArrowUp", "Shift+ArrowUp", "Shift+ArrowUp"):
        visit.page.keyboard.press(key)
    painted = visit.answer(
        lambda: visit.page.keyboard.press("Space"), lambda asked: visit.occupied(asked).any()
    )
    rows, columns = np.nonzero(visit.occupied(painted.asked))
    assert (rows.mean(), columns.mean()) == pytest.approx((58.5, 7.5), abs=0.6)


def test_every_tool_is_in_reach(visit: Any) -> None:
    hit = """button => {
        const { x, y, width, height } = button.getBoundingClientRect();
        return button.contains(document.elementFromPoint(x + width / 2, y + height / 2));
    }"""
    sizes = ((1366, 768), (1366, 650), (1536, 730), (1600, 780), (1180, 640), (1024, 768))
    for width, height in (*sizes, (800, 600)):
        visit.page.set_viewport_size({"width": width, "height": height})
        for name in ("[data-tool=person]", "#another", "#undo", "#drive", "#replay"):
            assert visit.locate(name).evaluate(hit), (name, width, height)
        tops = [visit.locate(name).bounding_box()["y"] for name in ("#another", "#undo")]
        assert tops[0] == tops[1]


def test_a_phone_is_enough(open_page: Callable[..., Any]) -> None:
    visit = open_page(viewport={"width": 390, "height": 844}, color_scheme="dark", **PHONE)
    visit.wait_for_anchors()
    width = visit.page.evaluate("document.documentElement.scrollWidth")

    tapped = visit.answer(
        lambda: visit.page.touchscreen.tap(*visit.at((2.0, -3.0))),
        lambda asked: visit.occupied(asked)[18, 68],
    )

    assert width == 390
    assert visit.occupied(tapped.asked)[18, 68]
    visit.keep("phone.png", full_page=True)
    assert visit.errors == []


@pytest.fixture
def phone(open_page: Callable[..., Any]) -> Any:
    """The page on a phone with the empty map."""
    visit = open_page(viewport={"width": 390, "height": 844}, **PHONE)
    visit.wait_for_anchors()
    visit.answer(
        lambda: visit.locate("#sample").select_option("empty"),
        lambda asked: not visit.occupied(asked).any(),
    )
    return visit


@pytest.fixture
def touch(phone: Any) -> Callable[..., None]:
    """Return a function that sends a touch event with fingers at points in m."""
    session = phone.page.context.new_cdp_session(phone.page)

    def send(kind: str, *points: tuple[float, float]) -> None:
        places = [phone.at(point) for point in points]
        fingers = [{"x": x, "y": y, "id": number} for number, (x, y) in enumerate(places)]
        session.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": fingers})

    return send


def test_two_fingers_paint_nothing(phone: Any, touch: Callable[..., None]) -> None:
    touch("touchStart", (-1.0, 0.0))
    touch("touchMove", (-1.5, 0.0))
    expect(phone.locate("#undo")).to_be_enabled()
    touch("touchStart", (-1.5, 0.0), (1.0, 0.0))
    touch("touchMove", (-2.0, 0.0), (2.0, 0.0))
    touch("touchEnd")

    expect(phone.locate("#undo")).to_be_disabled()
    phone.locate("#seed").fill("7")
    after = phone.answer(
        lambda: phone.locate("#seed").press("Tab"), lambda asked: asked["seed"] == 7
    )
    assert not phone.occupied(after.asked).any()


def test_a_finger_pushes_an_obstacle_up(phone: Any, touch: Callable[..., None]) -> None:
    spot = phone.at((1.0, 0.0))
    dot = phone.answer(
        lambda: phone.page.touchscreen.tap(*spot), lambda asked: phone.occupied(asked).any()
    )
    phone.locate("[data-tool=move]").click()

    touch("touchStart", (1.0, 0.0))
    for y in np.linspace(0.1, 1.9, 7):
        touch("touchMove", (1.0, y))
        phone.page.wait_for_timeout(30)
    pushed = phone.answer(
        lambda: touch("touchMove", (1.0, 2.0)), lambda asked: phone.occupied(asked)[68, 58]
    )
    touch("touchEnd")

    np.testing.assert_array_equal(
        np.roll(phone.occupied(dot.asked), 20, 0), phone.occupied(pushed.asked)
    )


def test_a_phone_that_is_held_across_shows_the_whole_board(open_page: Callable[..., Any]) -> None:
    visit = open_page(viewport={"width": 667, "height": 375}, **PHONE)
    visit.wait_for_anchors()
    tools, board, deck = (
        visit.locate(part).bounding_box() for part in (".toolbar", "#board", ".deck:visible")
    )

    assert deck["y"] + deck["height"] - tools["y"] < 375
    assert board["width"] == pytest.approx(board["height"])
    assert board["x"] > 100

"""The BEV raster of a made-up street: every channel where it belongs, and nothing of the route."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from anchorflow_driving.sensors.bev import BEV, BevGrid, draw_bev, draw_boxes
from anchorflow_driving.window import REAR_AXLE, Window

LENGTH, WIDTH = 5.0, 2.0  # of the street's boxes
AXLE = REAR_AXLE * LENGTH  # the ego's middle lies this far ahead of the frame

Street = Callable[..., Window]


def channel(window: Window, name: str, grid: BevGrid = BEV) -> np.ndarray:
    return draw_bev(window.view, grid)[grid.channels.index(name)]


def at(raster: np.ndarray, x: float, y: float) -> int:
    """Return the cell at a position of the ego's frame."""
    row = int((BEV.extent[1] - x) / BEV.cell)
    column = int((BEV.extent[3] - y) / BEV.cell)
    return int(raster[row, column])


def covered(raster: np.ndarray) -> float:
    """m² that are covered."""
    return float(raster.sum()) / 255 * BEV.cell**2


def middle(raster: np.ndarray) -> tuple[float, float]:
    """x and y of what is covered, in the mean."""
    rows, columns = (np.arange(count) + 0.5 for count in raster.shape)
    share = raster / raster.sum()
    x = BEV.extent[1] - BEV.cell * (share.sum(1) @ rows)
    return float(x), float(BEV.extent[3] - BEV.cell * (share.sum(0) @ columns))


def test_it_reaches_as_far_as_it_says(on_street: Street) -> None:
    assert draw_bev(on_street().view).shape == BEV.shape == (20, 192, 128)
    assert draw_bev(on_street().view).dtype == np.uint8
    assert BEV.extent == (-16.0, 80.0, -32.0, 32.0)


def test_a_box_ahead_to_the_left_lies_up_and_left(on_street: Street, other: Any) -> None:
    boxes = channel(on_street(other(30.0, 4.0)), "vehicles")

    assert at(boxes, 30.0 + AXLE, 4.0) == 255
    assert at(boxes, 30.0 + AXLE, -4.0) == 0
    rows, columns = np.nonzero(boxes)
    assert rows.max() < (80 - 20) / BEV.cell
    assert columns.max() < 32 / BEV.cell
    assert covered(boxes) == pytest.approx(LENGTH * WIDTH, rel=0.1)


@pytest.mark.parametrize(
    ("length", "width", "too_large"), [(4.6, 1.9, 0.02), (1.8, 0.6, 0.06), (0.6, 0.6, 0.08)]
)
def test_boxes_lie_where_they_are_and_are_as_large(
    length: float, width: float, too_large: float
) -> None:
    """The mean of many random boxes: each is rounded to cells of an eighth of a metre."""
    rng = np.random.default_rng(0)
    size = np.array([[length, width]])
    places = rng.uniform([10, -20, 0], [60, 20, 2 * np.pi], (400, 3))
    drawn = [draw_boxes(np.array([[*place, 0.0, 0.0]]), size, BEV) for place in places]

    middles = np.array([middle(raster) for raster in drawn])
    np.testing.assert_allclose((middles - places[:, :2]).mean(0), 0.0, atol=0.01)
    area = np.mean([covered(raster) for raster in drawn]) / (length * width)
    assert 1.0 - 0.02 < area < 1.0 + too_large


def test_lines_lie_where_they_are(on_street: Street) -> None:
    apart = []
    for y in np.random.default_rng(0).uniform(-8, 8, 60):
        line = np.array([[-10.0, y], [60.0, y]], np.float32)
        drawn = channel(on_street(line_points=line), "lines")
        apart.append(middle(drawn)[1] - y)

    assert np.mean(apart) == pytest.approx(0.0, abs=0.02)


def test_everybody_has_a_channel_and_the_ego_none(on_street: Street, other: Any) -> None:
    seen = on_street(other(10.0, 4.0), other(20.0, 4.0, kind=1), other(30.0, 4.0, kind=3))

    for name, x in {"vehicles": 10.0, "people": 20.0, "static": 30.0}.items():
        drawn = channel(seen, name)
        assert at(drawn, x + AXLE, 4.0) == 255
        assert covered(drawn) < 1.5 * LENGTH * WIDTH
    assert not channel(on_street(), "vehicles").any()


def test_boxes_are_foretold_at_constant_velocity(on_street: Street, other: Any) -> None:
    window = on_street(other(10.0, 4.0, speed=8.0))

    for seconds in BEV.ahead_s:
        drawn = channel(window, f"occupied_{seconds:.1f}s")
        assert at(drawn, 10.0 + 8.0 * seconds + AXLE, 4.0) == 255
        assert at(drawn, 10.0 + AXLE, 4.0) == (255 if 8.0 * seconds < LENGTH / 2 else 0)
    assert at(channel(window, "vehicles_before"), 2.0 + AXLE, 4.0) == 255


def test_the_future_is_not_in_it(on_street: Street, other: Any) -> None:
    window = on_street(other(10.0, 4.0, speed=8.0))
    told = draw_bev(window.view)
    window.log.track_state[:, window.frame + 1 :] = 7.0
    again = Window(window._scenes, window.index)

    np.testing.assert_array_equal(draw_bev(again.view), told)


def test_the_route_is_not_in_it(on_street: Street) -> None:
    elsewhere = np.array([[-100.0, 4.0], [200.0, 4.0]], np.float32)

    told = draw_bev(on_street().view)
    np.testing.assert_array_equal(draw_bev(on_street(route_points=elsewhere).view), told)


def test_the_road_is_where_one_may_drive(on_street: Street) -> None:
    road = channel(on_street(), "drivable")

    assert at(road, 40.0, 0.0) == at(road, 40.0, 5.9) == 255
    assert at(road, 40.0, -2.4) == at(road, 40.0, 6.4) == 0
    assert covered(road) == pytest.approx(96 * 8, rel=0.02)


def test_lanes_tell_their_direction(on_street: Street) -> None:
    back = np.array([[-100.0, 0.0], [200.0, 0.0], [200.0, 4.0], [-100.0, 4.0]], np.float32)
    window = on_street(centre_points=back)

    ahead, oncoming = channel(window, "lanes_ahead"), channel(window, "lanes_oncoming")
    assert at(ahead, 40.0, -0.1) == 255
    assert at(ahead, 40.0, 3.9) == 0
    assert at(oncoming, 40.0, 3.9) == 255
    assert not channel(window, "lanes_left").any()


def test_a_grid_of_ones_own(on_street: Street) -> None:
    coarse = BevGrid(extent=(0.0, 40.0, -16.0, 16.0), cell=1.0, ahead_s=(1.0, 2.0))

    assert draw_bev(on_street().view, coarse).shape == (13, 40, 32)

"""Natural mistakes: each is refused by a line that names its likely cause."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from anchorflow_client import AnchorRequest, InvalidRequest
from anchorflow_client.contract.hints import place_hint, unit_hint

GRID = np.zeros((64, 64), np.float32)
BODY = {"kinematics": {"kind": "differential"}}
WIDE = {"data": np.zeros((1, 40, 200), np.float32), "resolution": 0.1}


def on(data: np.ndarray, **fields: Any) -> dict[str, Any]:
    return {"cost_map": {"data": data, "resolution": 0.1, **fields}}


MISTAKES: dict[str, tuple[dict[str, Any], str]] = {
    "x and y swapped": (
        {"cost_map": WIDE, "x_curr": [0, 9, 0, 0, 0, 0]},
        "(9, 0) is on it: are x and y swapped?",
    ),
    "no origin": (
        {"x_curr": [5, 5, 0, 0, 0, 0]},
        "it would be on a map whose lower corner, `cost_map.origin`, is (0, 0)",
    ),
    "a start in cm": ({"x_curr": [150, -120, 0, 0, 0, 0]}, "is it in centimetres?"),
    "a start in mm": ({"x_curr": [1500, -1200, 0, 0, 0, 0]}, "is it in millimetres?"),
    "a start in cells": (
        {**on(GRID[None], origin=[10, 10]), "x_curr": [30, 30, 0, 0, 0, 0]},
        "is it in cells? Places are in metres",
    ),
    "a radius in cm": ({"robot_radius": 25}, "is it in centimetres? 25 centimetres are 0.25 m"),
    "a speed in cm/s": ({"v_max": 200}, "is it in cm/s? 200 cm/s are 2 m/s"),
    "a horizon in ms": ({"horizon_s": 8000}, "is it in milliseconds? 8000 milliseconds are 8 s"),
    "a turn in degrees": (
        {"goal_tolerance": {"position": 0.2, "heading": 10}},
        "is it in degrees? 10 degrees are 0.175 rad",
    ),
    "a resolution of 500": (on(GRID[None], resolution=500), "500 centimetres are 5 m/cell"),
    "a resolution of 5": (
        on(GRID[None] + 1, resolution=5),
        "a cell is 5 m wide: is `cost_map.resolution` in centimetres?",
    ),
    "a resolution of 16 where all is free": (
        on(GRID[None], resolution=16),
        "expected cells of at most 4 m for this robot, got 16; a cell is 16 m wide",
    ),
    "a heading in degrees": (
        {"x_curr": [0, 0, 90, *[0] * 6], "x_goal": [1, 0, 0, 0, 0, 0], **BODY},
        "is it in degrees? 90 degrees are 1.57 rad",
    ),
    "per cent": (on(GRID[None] + 50), "as in a ROS OccupancyGrid? CostMap.from_occupancy_grid"),
    "unknown as -1": (on(GRID[None] - 1), "CostMap.from_occupancy_grid reads one"),
    "0 to 254": (on((GRID[None] + 254).astype(np.uint8)), "CostMap.from_nav2 reads the former"),
    "NaN": (on(GRID[None] * np.nan), "layers may mark unknown cells so: choose a value"),
    "no channel": (on(GRID), "a single channel is [grid], [1,H,W]"),
    "channels last": (on(np.zeros((64, 64, 3))), "are the channels last? They come before"),
    "a place for a start": ({"x_curr": [0, 0]}, "after the position comes the velocity and the"),
    "a place for a goal": ({"x_goal": [1, 0]}, "after the position comes the velocity: zeros"),
    "a start without acceleration": ({"x_curr": [0, 0, 0, 0]}, "the acceleration follows"),
}


@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_is_named(name: str) -> None:
    asked, hint = MISTAKES[name]
    sound = {**on(GRID[None]), "x_curr": [0] * 6, "x_goal": [1, 0, 0, 0]}
    AnchorRequest.build(**sound)
    with pytest.raises(InvalidRequest) as refused:
        AnchorRequest.build(**sound | asked)
    assert hint in refused.value.message


def test_where_no_mistake_is_likely_none_is_named() -> None:
    low, high = np.array([-1.0, -2.0]), np.array([1.0, 2.5])
    assert place_hint(1e6, 3e6, low=low, high=high, resolution=0.1) == ""
    assert unit_hint(-1, 0.0, 5.0, "m") == ""
    assert unit_hint(6, 0.0, 5.0, "m") == ""
    assert unit_hint("25", 0.0, 5.0, "m") == ""

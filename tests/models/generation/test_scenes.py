"""What a caller says of a scene, and what is refused."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch

from anchorflow_models import L2Config
from anchorflow_models.generation import Scenes
from anchorflow_trajectory.clearance import clearance_field

CONFIG = L2Config()
X_CURR, X_GOAL = [-1.0, 0, 0, 0, 0, 0], [1.0, 0, 0, 0]


def scenes(**changes: Any) -> Scenes:
    cost_map = np.zeros((1, 40, 60), np.float32)
    cost_map[0, 30, 30] = 1.0
    fields = {"cost_map": cost_map, "x_curr": X_CURR, "x_goal": X_GOAL, "config": CONFIG}
    return Scenes.of(**(fields | changes))


def test_defaults_centre_the_map_and_fill_its_channels() -> None:
    one = scenes()
    np.testing.assert_allclose(one.origin, [[-3.0, -2.0]])
    np.testing.assert_allclose(one.w_style, [[0.4, 0.3, 0.3]])
    assert one.cost_map.shape == (1, 3, 40, 60)
    assert (one.cost_map[0, 1] == 1).all()
    assert not one.cost_map[0, 2].any()
    inputs = one.encode_inputs(torch.device("cpu"))
    torch.testing.assert_close(inputs["map_geometry"], torch.tensor([[-3.0, -2.0, 0.1]]))


def test_resolution_origin_and_radius_are_heeded() -> None:
    other = scenes(resolution=0.2, origin=[-2.0, -3.0], robot_radius=0.4)
    occupied = np.zeros((40, 60), bool)
    occupied[30, 30] = True
    np.testing.assert_allclose(other.clearance[0], clearance_field(occupied, 0.2, 0.4))
    # The goal's cell is where the cost to go is nothing.
    row, column = np.unravel_index(other.cost_to_go[0, 1].argmin(), (40, 60))
    assert (row, column) == (15, 15)


def test_what_has_no_scene_axis_is_the_same_in_every_scene() -> None:
    maps = np.zeros((3, 2, 40, 60), np.float32)
    several = scenes(cost_map=maps, x_goal=torch.tensor(X_GOAL), w_style=[[2, 1, 1]] * 3)
    assert len(several) == 3
    assert several.x_goal.shape == (3, 4)
    np.testing.assert_allclose(several.w_style, [[0.5, 0.25, 0.25]] * 3)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"x_curr": X_CURR[:4]}, r"x_curr: expected \[6\] or \[B, 6\], got \[4\]"),
        ({"x_goal": [*X_GOAL[:3], np.nan]}, "x_goal: expected finite numbers"),
        ({"x_goal": [9.0, 0, 0, 0]}, r"x_goal: expected a point on the map, 6 x 4 m from"),
        ({"x_curr": [0.05, 1.05, 0, 0, 0, 0]}, "x_curr: expected a cell that is not occupied"),
        ({"cost_map": np.zeros((40, 60))}, r"cost_map: expected \[C, H, W\] or \[B, C, H, W\]"),
        ({"cost_map": np.zeros((4, 40, 60))}, "cost_map: expected C from 1 to 3, the model's"),
        ({"cost_map": np.full((1, 40, 60), -0.1)}, r"cost_map: expected values in \[0, 1\]"),
        ({"w_style": [1, -1, 1]}, "w_style: expected weights >= 0, not all 0"),
        ({"w_style": [0, 0, 0]}, "w_style: expected weights >= 0, not all 0"),
        ({"resolution": 0.0}, "resolution: expected m/cell above 0"),
        ({"robot_radius": -0.1}, "robot_radius: expected 0 m or more"),
        ({"origin": [1.0, 2.0, 3.0]}, r"origin: expected \[2\] or \[B, 2\]"),
        ({"x_curr": [X_CURR] * 2, "x_goal": [X_GOAL] * 3}, "x_curr: expected B of 1 or 3, got 2"),
    ],
)
def test_what_is_wrong_is_named(changes: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        scenes(**changes)

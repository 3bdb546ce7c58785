"""A request in arrays or tensors becomes scenes, with the contract's checks."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch

from anchorflow_client.errors import InvalidRequest
from anchorflow_models import L2Config
from anchorflow_models.generation import encode_inputs, requested_scenes
from anchorflow_trajectory.cost.clearance import clearance_field
from anchorflow_trajectory.motion import MotionLimits
from anchorflow_trajectory.scene import Scene

CONFIG = L2Config()
CPU = torch.device("cpu")
X_CURR, X_GOAL = [-1.0, 0, 0, 0, 0, 0], [1.0, 0, 0, 0]


def scenes(**changes: Any) -> list[Scene]:
    """On a map of 6 x 4 m round (0, 0) with an obstacle in one cell."""
    cost_map = np.zeros((1, 40, 60), np.float32)
    cost_map[0, 30, 30] = 1.0
    fields = {"cost_map": cost_map, "x_curr": X_CURR, "x_goal": X_GOAL, "config": CONFIG}
    return requested_scenes(**(fields | changes))


def test_defaults_centre_the_map_and_networks_see_three_channels() -> None:
    (one,) = scenes()
    np.testing.assert_allclose(one.origin, [-3.0, -2.0])
    np.testing.assert_allclose(one.w_style, [0.4, 0.3, 0.3])
    inputs = encode_inputs([one], CPU)
    occupied, traversability, risk = inputs["cost_map"][0]
    assert (occupied.sum(), traversability.min(), risk.max()) == (1.0, 1.0, 0.0)
    torch.testing.assert_close(inputs["map_geometry"], torch.tensor([[-3.0, -2.0, 0.1]]))


def test_resolution_origin_and_radius_are_heeded() -> None:
    (other,) = scenes(resolution=0.2, origin=[-2.0, -3.0], robot_radius=0.4)
    occupied = np.zeros((40, 60), bool)
    occupied[30, 30] = True
    cut = occupied.repeat(2, 0).repeat(2, 1)
    np.testing.assert_allclose(other.clearance_field, clearance_field(cut, 0.1, 0.4))
    np.testing.assert_allclose(other.routes[0].points[[0, -1]], [X_CURR[:2], X_GOAL[:2]])
    np.testing.assert_allclose(other.limits, [2.0, 3.0, 0.4, 0.0], rtol=1e-6)


def test_a_style_may_be_told_by_its_name() -> None:
    (one,) = scenes(w_style="efficient")
    np.testing.assert_allclose(one.w_style, [0.2, 0.5, 0.3])
    with pytest.raises(InvalidRequest, match="conservative, balanced, efficient, comfortable"):
        scenes(w_style="brave")


def test_the_limits_are_the_scenes() -> None:
    (one,) = scenes(motion=MotionLimits(0.5, 0.7, horizon_s=20.0))
    inputs = encode_inputs([one], CPU)
    torch.testing.assert_close(inputs["limits"], torch.tensor([[0.5, 0.7, 0.25, 20.0]]))
    assert "route_states" not in inputs  # of which every anchor gets one


def test_what_has_no_scene_axis_is_the_same_in_every_scene() -> None:
    maps = np.zeros((3, 2, 40, 60), np.float32)
    several = scenes(cost_map=maps, x_goal=torch.tensor(X_GOAL), w_style=[[2, 1, 1]] * 3)
    assert len(several) == 3
    inputs = encode_inputs(several, CPU)
    assert inputs["x_goal"].tolist() == [X_GOAL] * 3
    torch.testing.assert_close(inputs["w_style"], torch.tensor([[0.8, 0.1, 0.1]] * 3))
    assert inputs["cost_map"].shape == (3, 3, 40, 60)


def test_tensors_are_taken_and_gradients_left_behind() -> None:
    given = torch.tensor(X_CURR, requires_grad=True)
    (one,) = scenes(x_curr=given, cost_map=torch.zeros(1, 40, 60))
    np.testing.assert_array_equal(one.x_curr, X_CURR)


@pytest.mark.parametrize(
    ("changes", "field", "message"),
    [
        ({"x_curr": X_CURR[:4]}, "x_curr", r"shape \[6\] or \[B,6\], \[9\] or \[B,9\], got \[4\]"),
        ({"x_curr": [-1.0] * 9, "x_goal": [1.0] * 6}, "x_curr", r"the model has D = 2, got \[9\]"),
        ({"x_curr": [0.05, 1.05, 0, 0, 0, 0]}, "x_curr", "a cell of occupancy below 0.5"),
        ({"cost_map": np.zeros((40, 60))}, "cost_map.data", r"\[C,H,W\] or \[B,C,H,W\]"),
        ({"cost_map": np.zeros((17, 40, 60))}, "cost_map.data", "C from 1 to 16, got 17"),
        ({"origin": [1.0, 2.0, 3.0]}, "cost_map.origin", r"shape \[2\], got \[3\]"),
        ({"x_curr": [X_CURR] * 2, "x_goal": [X_GOAL] * 3}, "x_goal", "B = 2 as in x_curr, got 3"),
    ],
)
def test_what_is_wrong_is_named(changes: dict, field: str, message: str) -> None:
    with pytest.raises(InvalidRequest, match=message) as refusal:
        scenes(**changes)
    assert refusal.value.field == field


def test_maps_of_one_batch_have_one_size() -> None:
    smaller = scenes(cost_map=np.zeros((1, 30, 60), np.float32))
    with pytest.raises(ValueError, match="scenes: expected maps of one size"):
        encode_inputs([*scenes(), *smaller], CPU)

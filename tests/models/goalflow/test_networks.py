"""Picked goals keep apart, the best first; lookups on rasters lie where the raster says."""

from __future__ import annotations

import torch

from anchorflow_models.goalflow.networks import at_places, at_times, pick

EXTENT = (-4.0, 12.0, -4.0, 4.0)  # 8 rows of 2 m, 4 columns


def test_the_best_goals_that_keep_apart() -> None:
    goals = torch.tensor([[0.0, 0.0], [1.0, 0.0], [5.0, 0.0], [9.0, 0.0]])
    scores = torch.tensor([[0.8, 0.9, 0.1, 0.5], [0.9, 0.8, 0.1, 0.5]])

    assert pick(goals, scores, count=3, spacing=2.0).tolist() == [[1, 3, 2], [0, 3, 2]]
    # If no more are apart, those near to the fewest follow, in the order of their scores.
    assert pick(goals, scores, count=4, spacing=100.0).tolist() == [[1, 0, 3, 2], [0, 1, 3, 2]]


def test_where_goals_crowd_those_near_to_fewer_come_first() -> None:
    goals = torch.tensor([[0.0, 0.0], [3.0, 0.0], [1.5, 0.0], [4.5, 0.0]])
    scores = torch.tensor([[0.9, 0.8, 0.7, 0.1]])

    assert pick(goals, scores, count=4, spacing=2.0).tolist() == [[0, 1, 3, 2]]


def test_the_first_row_lies_ahead_and_the_first_column_left() -> None:
    cells = torch.zeros(1, 8, 4, 1)
    cells[0, 0, 0], cells[0, 7, 3] = 1.0, 2.0
    places = torch.tensor([[[11.0, 3.0], [-3.0, -3.0], [3.0, 0.0], [10.0, 3.0]]])

    assert at_places(cells, places, EXTENT)[0, :, 0].tolist() == [1.0, 2.0, 0.0, 0.5]


def test_a_layer_is_asked_at_its_time_and_mixes_with_no_other() -> None:
    layers = torch.zeros(1, 3, 8, 4)
    layers[0, 1] = 1.0
    places = torch.tensor([[[[50.0, 0.0], [-50.0, 0.0], [3.0, 1.0]]]])

    for layer, expected in ((0, 0.0), (1, 1.0), (2, 0.0)):
        found = at_times(layers, places, torch.full((3,), layer), EXTENT)
        torch.testing.assert_close(found, torch.full((1, 1, 3), expected))

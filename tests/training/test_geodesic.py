"""The graph of a map's cells: steps weigh their length times the cost of both ends."""

import numpy as np
import pytest
from scipy.sparse.csgraph import dijkstra

from anchorflow_training.scenes import grid_graph


def test_steps_weigh_their_length_times_the_mean_cost() -> None:
    cost = np.array([[1.0, 3.0], [1.0, 5.0]])
    graph = grid_graph(cost, 0.5).toarray()
    weights = graph + graph.T
    assert weights[0, 1] == pytest.approx(0.5 * 2.0)
    assert weights[0, 2] == pytest.approx(0.5 * 1.0)
    assert weights[0, 3] == pytest.approx(0.5 * np.sqrt(2.0) * 3.0)
    assert weights[1, 2] == pytest.approx(0.5 * np.sqrt(2.0) * 2.0)
    assert np.count_nonzero(graph) == 6  # each pair of neighbours once


def test_open_ground_is_as_far_as_steps_to_eight_neighbours_lead() -> None:
    graph = grid_graph(np.ones((20, 30), np.float32), 0.1)
    far = dijkstra(graph, directed=False, indices=0).reshape(20, 30)
    assert far[0, 29] == pytest.approx(2.9, rel=1e-5)
    assert far[10, 10] == pytest.approx(np.sqrt(2.0), rel=1e-5)
    assert far[4, 9] == pytest.approx(0.5 + 0.4 * np.sqrt(2.0), rel=1e-5)

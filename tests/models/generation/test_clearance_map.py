"""The torch lookup of clearance against the numpy one, gradients too."""

from __future__ import annotations

import numpy as np
import torch

from anchorflow_models.generation import ClearanceMap
from anchorflow_trajectory.cost.clearance import GridField, clearance_field


def test_values_and_gradients_are_those_of_the_service() -> None:
    rng = np.random.default_rng(0)
    maps = [clearance_field(rng.random((30, 20)) < 0.05, 0.2, 0.1) for _ in range(2)]
    geometry = torch.tensor([[-1.0, 2.0, 0.2], [3.0, -4.0, 0.2]])
    corner = geometry[:, None, :2].numpy()
    # Some lie beyond the map on either side.
    points = (corner + rng.uniform([-1, -1], [5, 7], (2, 200, 2))).astype(np.float32)
    x = torch.tensor(points).reshape(2, 10, 20, 2).requires_grad_()
    got = ClearanceMap(torch.from_numpy(np.stack(maps)), geometry)(x)
    (gradient,) = torch.autograd.grad(got.sum(), x)
    for b, values in enumerate(maps):
        field = GridField(values, 0.2, corner[b, 0].astype(np.float64))
        value, *slopes = field.sample_with_gradient(points[b, :, 0], points[b, :, 1])
        np.testing.assert_allclose(got[b].detach().reshape(-1), value, atol=1e-5)
        inside = ((points[b] > corner[b] + 0.1) & (points[b] < corner[b] + (3.9, 5.9))).all(-1)
        slopes_here = gradient[b].reshape(-1, 2)[inside]
        np.testing.assert_allclose(slopes_here.T, np.array(slopes)[:, inside], atol=5e-5)


def test_beyond_the_map_the_way_back_is_uphill() -> None:
    clearance = ClearanceMap(torch.zeros(1, 10, 10), torch.tensor([[0.0, 0.0, 1.0]]))
    x = torch.tensor([[[-1.5, 5.0], [5.0, 12.0]]]).requires_grad_()
    got = clearance(x)
    assert got.tolist() == [[-2.0, -2.5]]
    (gradient,) = torch.autograd.grad(got.sum(), x)
    assert gradient.tolist() == [[[1.0, 0.0], [0.0, -1.0]]]

"""Noise meets data of its own route: nothing else would be a shorter way that can be gone."""

from __future__ import annotations

import numpy as np
import torch

from anchorflow_training.objective import couple, paired


def test_coupling_shortens_the_way() -> None:
    rng = np.random.default_rng(0)
    start, end = (rng.normal(size=(3, 16, 5)).astype(np.float32) for _ in range(2))
    order = couple(start, end, groups=np.zeros((3, 16), int))
    met = np.take_along_axis(end, order[..., None], 1)
    assert np.square(start - met).sum() < 0.8 * np.square(start - end).sum()
    np.testing.assert_array_equal(np.sort(order, 1), np.tile(np.arange(16), (3, 1)))


def test_coupling_stays_within_groups_and_is_the_best_there() -> None:
    """Two groups whose points lie the wrong way round: each keeps its own all the same."""
    rng = np.random.default_rng(1)
    groups = rng.integers(0, 3, (2, 12))
    start = rng.normal(size=(2, 12, 4)).astype(np.float32) + groups[..., None]
    end = rng.normal(size=(2, 12, 4)).astype(np.float32) - groups[..., None]
    order = couple(start, end, groups=groups)
    np.testing.assert_array_equal(np.take_along_axis(groups, order, 1), groups)
    free = couple(start, end, groups=np.zeros_like(groups))
    assert (np.take_along_axis(groups, free, 1) != groups).any()
    for b in range(2):
        for label in np.unique(groups[b]):
            own = np.flatnonzero(groups[b] == label)
            alone = couple(
                start[b : b + 1, own], end[b : b + 1, own], groups=np.zeros((1, len(own)), int)
            )
            np.testing.assert_array_equal(own[alone[0]], order[b, own])


def test_pairs_of_noise_and_data_share_their_route() -> None:
    """Whole states move, told by their positions alone."""
    generator = torch.Generator().manual_seed(0)
    x_0, data = (torch.randn(2, 10, 16, 7, generator=generator) for _ in range(2))
    route = torch.arange(10).expand(2, -1) % 3
    tagged = x_0.clone()
    tagged[..., -1] = route[..., None]  # a log duration that names its route
    met = paired(tagged, data, route, 2)
    assert torch.equal(met[..., -1], route[..., None].expand(-1, -1, 16).float())
    assert not torch.equal(met, tagged)

    def way(x: torch.Tensor) -> torch.Tensor:
        return (x - data)[:, :, ::4, :2].square().sum()

    assert way(met) < way(tagged)
    assert torch.equal(met.flatten().sort().values, tagged.flatten().sort().values)

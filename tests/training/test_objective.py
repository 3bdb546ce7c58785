"""FlowMP's objective: couplings of noise and data, and the covariance of the prior."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from anchorflow_models import L2Config, create_l2_safety_cfm
from anchorflow_models.flow_matching import flow_matching_loss
from anchorflow_models.flowmp.frame import Frame
from anchorflow_training.batches import reflection
from anchorflow_training.config import FlowMatchingConfig
from anchorflow_training.dataset import SceneDataset
from anchorflow_training.objective import (
    FlowObjective,
    couple,
    loss_named,
    paired,
    prior_covariance,
)
from anchorflow_training.settings import ConfigError
from anchorflow_trajectory.spline.basis import Splines, spline_basis


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


MODEL = L2Config(map_size=16, feature_channels=4)
BASIS = spline_basis(64)
FREE = BASIS.free.stop - BASIS.free.start
RANK = 2 * FREE + 1


def drawn_starts(dataset: SceneDataset, factor: np.ndarray, count: int = 400) -> np.ndarray:
    """[S, M, R] in the map's frame [m], of covariance factor factor^T in shares and its axes."""
    ends = (torch.from_numpy(np.array(dataset.arrays[n][:, :2])) for n in ("x_curr", "x_goal"))
    frame = Frame.between(*ends)
    rng = np.random.default_rng(0)
    shares = rng.normal(size=(len(dataset), count, RANK)) @ factor.T
    points = shares[..., :-1].reshape(len(dataset), count, 2, FREE)
    turned = np.einsum("smdf,sed->smef", points, frame.rotation.numpy())
    metres = turned * frame.spread.numpy()[:, None, None, None]
    longer = shares[..., -1:] * (dataset.arrays["limits"][:, 3] <= 0)[:, None, None]
    return np.concatenate([metres.reshape(*shares.shape[:2], -1), longer], -1).astype(np.float32)


def with_starts(dataset: SceneDataset, starts: np.ndarray) -> SceneDataset:
    """As many trajectories a scene as starts; what they are does not matter then."""
    count = starts.shape[1]
    arrays = dict(dataset.arrays)
    for name in ("states", "durations", "route"):
        arrays[name] = np.repeat(arrays[name][:, :1], count, 1)
    return replace(dataset, arrays=arrays | {"starts": starts})


def test_starts_tell_the_covariance(tiny_dataset: SceneDataset) -> None:
    """Residuals in the scene's axes; log durations only of scenes without a horizon."""
    factor = 0.1 * np.random.default_rng(1).normal(size=(RANK, RANK))
    factor[-1, :-1] = factor[:-1, -1] = 0.0
    factor[-1, -1] = 0.2
    dataset = with_starts(tiny_dataset, drawn_starts(tiny_dataset, factor))
    found = prior_covariance(dataset, MODEL, mirrored=False)
    expected = factor @ factor.T
    assert found.shape == (RANK, RANK)
    assert np.abs(found - expected).max() < 0.15 * np.abs(expected).max()
    assert found[-1, -1] == pytest.approx(0.04, rel=0.1)


def test_a_mirrored_covariance_leans_to_no_side(tiny_dataset: SceneDataset) -> None:
    factor = 0.1 * np.random.default_rng(1).normal(size=(RANK, RANK))
    dataset = with_starts(tiny_dataset, drawn_starts(tiny_dataset, factor, count=40))
    plain, mirrored = (prior_covariance(dataset, MODEL, mirrored=m) for m in (False, True))
    signs = np.append(np.repeat(reflection(2), FREE), 1.0)
    np.testing.assert_allclose(mirrored, mirrored * np.outer(signs, signs), atol=1e-9)
    assert not np.allclose(plain, mirrored, atol=1e-3)
    np.testing.assert_allclose(np.diag(mirrored), np.diag(plain), rtol=1e-5)


def test_without_starts_residuals_from_the_own_route_tell_it(tiny_dataset: SceneDataset) -> None:
    """Trajectories that are their route's splines, moved by known control points."""
    rng = np.random.default_rng(2)
    arrays = {name: np.array(array) for name, array in tiny_dataset.arrays.items()}
    moved = rng.normal(0.0, 0.2, (*arrays["route"].shape, 2, FREE)).astype(np.float32)
    longer = rng.normal(0.0, 0.1, arrays["route"].shape) * (arrays["limits"][:, 3:] <= 0)
    for s, own in enumerate(arrays["route_states"]):
        mean = own[arrays["route"][s]]
        control = np.zeros((2, len(mean), BASIS.num_control_points), np.float32)
        control[..., BASIS.free] = moved[s].swapaxes(0, 1)
        duration = np.exp(mean[:, 0, -1] + longer[s])
        of_time = mean[..., :-1] + BASIS.own_time_states(control)
        scale = np.repeat(duration[:, None] ** -np.arange(3.0), 2, 1)
        arrays["states"][s] = of_time * scale[:, None]
        arrays["durations"][s] = duration
    assert "starts" not in arrays
    told = prior_covariance(replace(tiny_dataset, arrays=arrays), MODEL)
    starts = np.concatenate([moved.reshape(*longer.shape, -1), longer[..., None]], -1)
    expected = prior_covariance(
        replace(tiny_dataset, arrays=arrays | {"starts": starts.astype(np.float32)}), MODEL
    )
    np.testing.assert_allclose(told, expected, atol=1e-3 * expected.max())


def test_noise_has_the_covariance_that_it_was_given() -> None:
    factor = 0.1 * np.random.default_rng(1).normal(size=(RANK, RANK)) + 0.1 * np.eye(RANK)
    prior = create_l2_safety_cfm(MODEL).prior
    prior.set_covariance(factor @ factor.T)
    own = prior.factor.numpy().astype(np.float64)
    np.testing.assert_allclose(own.T @ own, factor @ factor.T, rtol=1e-4, atol=1e-5)
    control = np.zeros((2, 1, BASIS.num_control_points), np.float32)
    control[..., BASIS.free] = own[3, :-1].reshape(2, 1, FREE)
    states = prior.disturbed(prior.factor[3:4])[0].numpy()
    expected = BASIS.own_time_states(Splines(control, np.ones(1)).control)[0]
    np.testing.assert_allclose(states[:, :-1], expected, rtol=1e-4, atol=1e-3)
    np.testing.assert_allclose(states[:, -1], own[3, -1], rtol=1e-6)


def own_loss(
    predicted: torch.Tensor, target: torch.Tensor, *_: object, sample_weights: object = None
) -> tuple[torch.Tensor, dict[str, torch.Tensor]]:
    ends = (predicted - target)[:, :, -1].abs().mean()
    return ends, {"ends": ends, "weighted": torch.tensor(float(sample_weights is not None))}


def test_a_loss_is_imported_by_its_name() -> None:
    assert loss_named(None) is flow_matching_loss
    objective = FlowObjective(
        create_l2_safety_cfm(L2Config(map_size=16, layers=1)),
        FlowMatchingConfig(loss=f"{__name__}:own_loss"),
    )
    assert objective.loss is own_loss
    for name, why in (
        ("own_loss", "module .*own_loss"),
        ("no_such_module:loss", "No module named 'no_such_module'"),
        (f"{__name__}:no_such_loss", "no attribute 'no_such_loss'"),
        (f"{__name__}:__name__", "which is no function"),
        (":loss", "Empty module name"),
    ):
        with pytest.raises(
            ConfigError, match=f"flow.loss: expected package.module:function.*{why}"
        ):
            loss_named(name)

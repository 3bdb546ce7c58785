"""The flow-matching loss of FlowMP: flow times, the coupling of noise and data, the prior."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib import import_module
from typing import cast

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from torch import Tensor, nn

from anchorflow_models import L2SafetyCFM
from anchorflow_models.flow_matching import flow_matching_loss, interpolate
from anchorflow_models.flowmp.config import L2Config
from anchorflow_models.flowmp.frame import Frame
from anchorflow_training.batches import reflection
from anchorflow_training.config import FlowMatchingConfig
from anchorflow_training.dataset import SceneDataset, own_time_states
from anchorflow_training.settings import ConfigError


def draw_flow_times(
    config: FlowMatchingConfig, shape: tuple[int, ...], generator: torch.Generator
) -> Tensor:
    """Flow times in [0, 1] of the given shape.

    uniform       every time alike
    logit_normal  sigmoid of a Gaussian: most between the ends (Esser et al., 2024)
    late          density k t^(k - 1), k = `late_power`: near the data, where schedules step most
    """
    if config.flow_time == "logit_normal":
        normal = torch.randn(shape, generator=generator)
        return torch.sigmoid(config.logit_mean + config.logit_std * normal)
    t = torch.rand(shape, generator=generator)
    return t ** (1.0 / config.late_power) if config.flow_time == "late" else t


FloatArray = NDArray[np.float32]


def couple(start: FloatArray, end: FloatArray, *, groups: NDArray[np.integer]) -> NDArray[np.int64]:
    """For each scene, the order of `end` that brings it nearest to `start`: [B, N].

    start, end: [B, N, Q], points to be compared by squared distance.
    groups: [B, N]; pairs form within a group.
    """
    order = np.tile(np.arange(start.shape[1]), (len(start), 1))
    for scene, labels in enumerate(groups):
        for label in np.unique(labels):
            own = np.flatnonzero(labels == label)
            distance = _distance(start[scene, own], end[scene, own])
            order[scene, own] = own[linear_sum_assignment(distance)[1]]
    return order


def _distance(a: FloatArray, b: FloatArray) -> FloatArray:
    return (a**2).sum(-1)[:, None] - 2 * a @ b.T + (b**2).sum(-1)


Loss = Callable[..., tuple[Tensor, dict[str, Tensor]]]
"""(predicted, target, weights, sample_weights=…) -> (loss, terms), as `flow_matching_loss`."""


def loss_named(name: str | None) -> Loss:
    """Import a loss by `package.module:function`; None is the house's own.

    Raises `ConfigError` if there is no such module, or no such function in it.
    """
    if name is None:
        return flow_matching_loss
    module, _, function = name.partition(":")
    said = f"flow.loss: expected package.module:function, got {name!r}"
    try:
        loss = getattr(import_module(module), function)
    except (ImportError, AttributeError, ValueError) as error:
        raise ConfigError(f"{said} ({error})") from error
    if callable(loss):
        return cast("Loss", loss)
    raise ConfigError(f"{said}, which is no function")


class FlowObjective(nn.Module):
    """Loss and its terms on a batch, in the model's normalised units.

    Raises `ConfigError` if there is no loss of the configured name.
    """

    def __init__(self, model: L2SafetyCFM, config: FlowMatchingConfig) -> None:
        super().__init__()
        self.model, self.config = model, config
        self.loss = loss_named(config.loss)

    def draw(self, scenes: int, samples: int, generator: torch.Generator) -> tuple[Tensor, Tensor]:
        """Noise [B, N, R] and flow times [B, N]; on the CPU, so alike on every device."""
        noise = torch.randn(scenes, samples, self.model.prior.rank, generator=generator)
        return noise, draw_flow_times(self.config, (scenes, samples), generator)

    def forward(
        self, batch: Mapping[str, Tensor], noise: Tensor, t: Tensor
    ) -> tuple[Tensor, dict[str, Tensor]]:
        """batch: inputs of encode [B, ...]; states and prior_mean [B, N, T, S], route [B, N];
        starts [B, N, R] and sample_weights [B, N] if any."""
        model, inputs = self.model, dict(batch)
        data, mean, route = (inputs.pop(name) for name in ("states", "prior_mean", "route"))
        starts, sample_weights = (inputs.pop(name, None) for name in ("starts", "sample_weights"))
        context = model.encode(**inputs)
        with torch.no_grad():
            if starts is not None:
                x_0 = mean + model.prior.disturbed(starts)
            else:
                x_0 = model.draw(noise, mean, context)
                if self.config.optimal_transport:
                    x_0 = paired(x_0, data, route, model.config.dim)
            x_t, target = interpolate(x_0, data, t)
            state = model.prior.normalise(x_t - mean, context["units"])
            target = model.prior.normalise(target, context["units"])
        modulation = model.modulate(t, context)
        predicted = model.normalised_field(x_t, state, mean, modulation, context)
        return self.loss(
            predicted.float(), target, self.config.weights, sample_weights=sample_weights
        )


def paired(x_0: Tensor, data: Tensor, route: Tensor, dim: int) -> Tensor:
    """x_0 [B, N, T, S] reordered within each route [B, N] of a scene to lie near the data."""
    points = [x[:, :, ::4, :dim].flatten(2).cpu().numpy() for x in (data, x_0)]
    order = torch.from_numpy(couple(*points, groups=route.cpu().numpy())).to(x_0.device)
    return torch.take_along_dim(x_0, order[..., None, None], 1)


def prior_covariance(
    dataset: SceneDataset, config: L2Config, *, scenes: int = 4000, mirrored: bool = True
) -> np.ndarray:
    """Covariance [R, R] of what trajectories begin with, or differ by from their route's spline.

    Control points in (D, F) order and shares of `Frame.spread`, then log duration. A trajectory
    counts as much as in the loss.

    mirrored: count every scene's reflection too, as in training, so nothing leans to one side
    """
    arrays = dataset.arrays
    quality = np.ones(arrays["states"].shape[:2])
    if dataset.mean_quality is not None:
        quality = arrays["quality"]
    counted = np.flatnonzero(quality.any(1))
    picked = counted[np.linspace(0, len(counted) - 1, min(scenes, len(counted))).astype(int)]
    dataset.check_finite(picked)
    flat = np.concatenate([_residuals(dataset, config, scene) for scene in picked])
    share = quality[picked].reshape(-1)
    # A scene with a horizon says nothing of how durations spread where they are open.
    is_open = np.repeat(arrays["limits"][picked, 3] <= 0, arrays["states"].shape[1])
    open_share = share[is_open].sum() / share.sum()
    if open_share > 0:
        flat[:, -1] /= np.sqrt(open_share)
    if mirrored:
        signs = np.repeat(reflection(config.dim), flat.shape[1] // config.dim)
        flat = np.concatenate([flat, flat * np.append(signs, 1.0)])
        share = np.tile(share, 2)
    return (flat * share[:, None]).T.astype(np.float64) @ flat / share.sum()


def _residuals(dataset: SceneDataset, config: L2Config, scene: np.integer) -> np.ndarray:
    """[M, R] of one scene, in its axes."""
    arrays = {name: array[scene] for name, array in dataset.arrays.items()}
    ends = (torch.from_numpy(arrays[n][None, : config.dim].copy()) for n in ("x_curr", "x_goal"))
    frame = Frame.between(*ends)
    if "starts" in arrays:
        points = arrays["starts"][:, :-1].reshape(len(arrays["starts"]), config.dim, -1)
        longer = arrays["starts"][:, -1:]
    else:
        states = own_time_states(arrays["states"], arrays["durations"])
        residual = states - arrays["route_states"][arrays["route"]]
        points = config.basis.fit_free(residual[..., :-1]).swapaxes(0, 1)
        longer = residual[:, 0, -1:]
    turned = np.einsum("mdf,de->mef", points, frame.rotation[0].numpy())
    shares = turned.reshape(len(points), -1) / frame.spread.item()
    return np.concatenate([shares, longer], -1)

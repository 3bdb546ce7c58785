"""Scenes to generate in: the contract's request in arrays or tensors, as a model's encode wants."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from anchorflow_client.contract import AnchorRequest
from anchorflow_client.errors import InvalidRequest
from anchorflow_models.flowmp.config import L2Config
from anchorflow_models.generation.checks import check
from anchorflow_trajectory.motion import MotionLimits
from anchorflow_trajectory.scene import ROUTE_STATES, SCENE_INPUTS, Scene, with_neutral_channels
from anchorflow_trajectory.spline.basis import SplineBasis, spline_basis

Numbers = ArrayLike | Tensor

ENCODED = tuple(name for name in SCENE_INPUTS if name != ROUTE_STATES)
DEFAULT_RESOLUTION = 0.1  # m/cell
DEFAULT_ROBOT_RADIUS = 0.25  # m
DEFAULT_MOTION = MotionLimits(v_max=2.0, a_max=3.0)


def requested_scenes(
    cost_map: Numbers,
    x_curr: Numbers,
    x_goal: Numbers,
    w_style: Numbers | None = None,
    *,
    config: L2Config,
    resolution: float = DEFAULT_RESOLUTION,
    origin: Numbers | None = None,
    robot_radius: float = DEFAULT_ROBOT_RADIUS,
    motion: MotionLimits = DEFAULT_MOTION,
) -> list[Scene]:
    """What a service is asked, as scenes for a model of this configuration.

    cost_map: [C, H, W], C up to the model's; channels left out are neutral
    x_curr: [3D]; x_goal: [2D]
    w_style: [3], scaled to sum to 1, or a style's name; balanced by default
    origin: [2] m; by default the map's centre is (0, 0)
    motion: what anchors keep, and how long they last where that is given

    Each but the origin may have a B axis; one without is the same in every scene.

    Raises:
        InvalidRequest: a field is not what the contract or the model takes; the message names it.
    """
    request = AnchorRequest.build(
        cost_map={
            "data": as_numpy(cost_map),
            "resolution": resolution,
            "origin": as_numpy(origin),
        },
        x_curr=as_numpy(x_curr),
        x_goal=as_numpy(x_goal),
        w_style=as_numpy(w_style),
        robot_radius=robot_radius,
        v_max=motion.v_max,
        a_max=motion.a_max,
        horizon_s=motion.horizon_s,
    )
    _check_fits(request, config)
    grid = request.cost_map
    return [
        Scene(
            cost_map=with_neutral_channels(grid.data[b], config.map_channels),
            resolution=grid.resolution,
            origin=grid.origin,
            robot_radius=robot_radius,
            x_curr=request.x_curr[b],
            x_goal=request.x_goal[b],
            w_style=request.w_style[b],
            motion=motion,
            basis=basis_of(config),
        )
        for b in range(request.num_scenes)
    ]


def encode_inputs(scenes: Sequence[Scene], device: torch.device) -> dict[str, Tensor]:
    """What a model's encode takes of B scenes, by name; their maps have one size."""
    sizes = {scene.cost_map.shape for scene in scenes}
    check("scenes", len(sizes) == 1, "maps of one size [C, H, W]", sorted(sizes))
    inputs = [scene.inputs(ENCODED) for scene in scenes]
    return {
        name: torch.from_numpy(np.concatenate([one[name] for one in inputs])).to(device)
        for name in ENCODED
    }


def prior_means(scenes: Sequence[Scene], count: int, device: torch.device) -> Tensor:
    """[B, N, T, S]: the routes of each scene, dealt out in turn to N = `count` anchors."""
    dealt = [scene.route_states[dealt_routes(scene, count)] for scene in scenes]
    return torch.from_numpy(np.stack(dealt)).to(device)


def dealt_routes(scene: Scene, count: int) -> NDArray[np.intp]:
    """[N], the place of the route that each anchor begins on."""
    return np.arange(count) % len(scene.route_splines)


def basis_of(config: L2Config) -> SplineBasis:
    """The splines of a model's anchors."""
    return spline_basis(
        config.num_steps, num_control_points=config.num_control_points, degree=config.degree
    )


def as_numpy(value: Any) -> Any:
    """A tensor of any device, as an array; anything else as it is."""
    return value.detach().cpu().numpy() if isinstance(value, Tensor) else value


def _check_fits(request: AnchorRequest, config: L2Config) -> None:
    channels, got = config.map_channels, request.cost_map.data.shape[1]
    if got > channels:
        raise InvalidRequest(
            f"expected C from 1 to {channels}, the model's, got {got}", "cost_map.data"
        )
    if request.on_map.dim != config.dim:
        raise InvalidRequest(
            f"expected [{3 * config.dim}] or [B,{3 * config.dim}], as the model has "
            f"D = {config.dim}, got [{request.x_curr.shape[1]}]",
            "x_curr",
        )

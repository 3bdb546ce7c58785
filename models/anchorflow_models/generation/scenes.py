"""Scenes to generate in: a request in arrays or tensors as inputs of a model's encode."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from anchorflow_client.contract import AnchorRequest, WarmStart
from anchorflow_client.errors import InvalidRequest
from anchorflow_models.checks import check
from anchorflow_models.flowmp.config import L2Config
from anchorflow_service.engine.samplers.flow import renoised
from anchorflow_trajectory.cost.clearance import finer_cells
from anchorflow_trajectory.motion import MotionLimits
from anchorflow_trajectory.scene import COST_PENALTY, ROUTE_STATES, SCENE_INPUTS, Scene

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
    cost_penalty: float = COST_PENALTY,
) -> list[Scene]:
    """Read a request into scenes for a model of this configuration.

    cost_map: [C, H, W]; channels left out are neutral
    x_curr: [3D]; x_goal: [2D]
    w_style: [3], scaled to sum to 1, or a style's name; balanced by default
    origin: [2] m; by default the map's centre is (0, 0)
    motion: limits of the anchors, and their duration if it has a horizon
    cost_penalty: m of detour that one metre through soft cost 1 is worth

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
        cost_penalty=cost_penalty,
    )
    _check_fits(request, config)
    grid = request.cost_map
    cells, finer = finer_cells(grid.data, grid.resolution)
    return [
        Scene(
            cost_map=cells[b],
            resolution=finer,
            origin=grid.origin,
            robot_radius=robot_radius,
            x_curr=request.x_curr[b],
            x_goal=request.x_goal[b],
            w_style=request.w_style[b],
            motion=motion,
            basis=config.basis,
            cost_penalty=cost_penalty,
        )
        for b in range(request.num_scenes)
    ]


def encode_inputs(scenes: Sequence[Scene], device: torch.device) -> dict[str, Tensor]:
    """Return the inputs of a model's encode for B scenes, by name; their maps have one size."""
    return {
        name: torch.from_numpy(each).to(device) for name, each in stacked_inputs(scenes).items()
    }


def stacked_inputs(scenes: Sequence[Scene]) -> dict[str, NDArray[Any]]:
    """Return the same as arrays."""
    sizes = {scene.cost_map.shape for scene in scenes}
    check("scenes", len(sizes) == 1, "maps of one size [C, H, W]", sorted(sizes))
    inputs = [scene.inputs(ENCODED) for scene in scenes]
    return {name: np.concatenate([one[name] for one in inputs]) for name in ENCODED}


def prior_means(scenes: Sequence[Scene], count: int) -> NDArray[np.float32]:
    """Return [B, N, T, S]: the routes of each scene, dealt out in turn to N = `count` anchors."""
    return np.stack([scene.route_states[dealt_routes(scene, count)] for scene in scenes])


def dealt_routes(scene: Scene, count: int) -> NDArray[np.intp]:
    """Return [N], the index of the route that each anchor begins on."""
    return np.arange(count) % len(scene.route_splines)


def warm_started(
    x_0: NDArray[np.float32], warm_start: WarmStart, scenes: Sequence[Scene]
) -> NDArray[np.float32]:
    """Return x_tau = tau x_1 + (1 - tau) x_0 [B, N, T, S]; x_1 is the plan on its own route.

    The plan is the contract's [T', D], [T', 2D] or [T', 3D], of any number of time steps, or
    [B, T', ...] if each scene has its own.

    Raises:
        InvalidRequest: the plan or tau is not that; the message names it.
    """
    given = np.asarray(as_numpy(warm_start.trajectory))
    plans = given if given.ndim == 3 else given[None]
    if len(plans) not in (1, len(scenes)):
        message = f"expected one plan, or {len(scenes)} as there are scenes, got {len(plans)}"
        raise InvalidRequest(message, "warm_start.trajectory")
    fields = {"tau": warm_start.tau, "dt": warm_start.dt}
    each = np.broadcast_to(plans, (len(scenes), *plans.shape[1:]))
    return np.stack(
        [
            _scene_warm_started(x, {**fields, "trajectory": p}, s)
            for x, p, s in zip(x_0, each, scenes, strict=True)
        ]
    )


def _scene_warm_started(
    x_0: NDArray[np.float32], fields: Mapping[str, Any], scene: Scene
) -> NDArray[np.float32]:
    checked = WarmStart.from_fields(fields, dim=len(scene.x_goal) // 2)
    return renoised(checked, x_0, dealt_routes(scene, len(x_0)), scene)


def as_numpy(value: Any) -> Any:
    """Return a tensor of any device as an array; anything else as it is."""
    return value.detach().cpu().numpy() if isinstance(value, Tensor) else value


def _check_fits(request: AnchorRequest, config: L2Config) -> None:
    if request.on_map.dim != config.dim:
        raise InvalidRequest(
            f"expected [{3 * config.dim}] or [B,{3 * config.dim}], as the model has "
            f"D = {config.dim}, got [{request.x_curr.shape[1]}]",
            "x_curr",
        )

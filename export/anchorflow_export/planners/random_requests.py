"""Random requests for the proof of parity, and the inputs of planners that see by sensors.

map_request      cluttered maps, with a start and a goal
sensor_request   camera, LiDAR and a motion that a car may have
street_request   rasters of streets, with routes
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional as F

from anchorflow_client.contract import AnchorRequest, ModelCard, TensorSpec
from anchorflow_client.sensors import LIDAR_BEFORE_S, ROUTE_POINTS, ROUTE_SPACING_M
from anchorflow_export.adapter import F32, Sizes
from anchorflow_export.tracing import random_tensor
from anchorflow_models.goalflow import BevLayout
from anchorflow_models.transfuser import (
    AGENT_STATE,
    FORETOLD_S,
    LIDAR_BEFORE,
    MOTION,
    STATUS,
    TransfuserConfig,
)
from anchorflow_service.bundle.entries import AgentsEntry, GuardEntry, RasterEntry
from anchorflow_trajectory.car.tracking import PLAN_TIMES

CELLS_A_BLOB = 40  # cells of a map for each square obstacle
SENSED = ("camera", "lidar")
COMMANDS = MOTION.start  # of the ego status
GUARD_HORIZON_S = 1.5
NUPLAN_CAR = (5.176, 2.297)  # m, length and width of the car whose sensors these planners take
FASTEST_STATUS = 60.0  # m/s, and m/s²: bounds of a status
STATUS_UNIT = (
    "command left, straight, right, unknown: 0 or 1; velocity x, y: m/s; acceleration x, y: m/s^2"
)
ROUTE = TensorSpec("route", F32, ("B", ROUTE_POINTS, 2), "m", (-1e3, 1e3), optional=True)
FASTEST, SHARPEST = 16.0, 2.0  # m/s and m/s² of cars in random streets
WIDTHS = (6.0, 16.0)  # m, of the streets
BLOCK, TAKEN = 8, 0.05  # cells a side of the blocks beside a street; their share
TURNING = 0.01  # rad more from point to point of random routes, times a normal number


def map_request(card: ModelCard, sizes: Sizes, seed: int) -> AnchorRequest:
    """Return a request for cluttered maps of H x W cells, with about half of the limits set."""
    generator, scenes, shape = np.random.default_rng(seed), sizes["B"], (sizes["H"], sizes["W"])
    resolution = 10.0 / max(shape)  # m/cell: maps of 10 m, whatever their cells
    extent = resolution * np.array(shape[::-1])
    origin = generator.uniform(-20.0, 20.0, 2)
    maps = generator.random((scenes, card.cost_map.channels, *shape), dtype=np.float32)
    maps[:, 0] = [_clutter(shape, generator) for _ in range(scenes)]
    ends = origin + generator.uniform(0.1, 0.9, (scenes, 2, 2)) * extent
    motion = generator.uniform(-1.0, 1.0, (scenes, 3 * card.D))
    headings = generator.uniform(-np.pi, np.pi, (scenes, 2, card.D - 2))
    columns, rows = np.moveaxis(((ends - origin) / resolution).astype(int), -1, 0)
    maps[np.arange(scenes)[:, None], 0, rows, columns] = 0.0
    start, goal = np.concatenate([ends, headings], axis=-1).swapaxes(0, 1)
    at_start, at_goal = np.split(motion, [2 * card.D], axis=1)
    limits: dict[str, Any] = {
        name: float(generator.uniform(*between))
        for name, between in card.cost_map.ranges.items()
        if generator.random() < 0.5
    }
    return AnchorRequest.build(
        cost_map={"data": maps, "resolution": resolution, "origin": origin},
        x_curr=np.concatenate([start, at_start], axis=1),
        x_goal=np.concatenate([goal, at_goal], axis=1),
        w_style=generator.dirichlet(np.ones(3), scenes),
        **limits,
    )


def _clutter(shape: tuple[int, int], generator: np.random.Generator) -> NDArray[np.float32]:
    """Draw occupancy [H,W] with square obstacles of two to five cells."""
    occupancy = np.zeros(shape, np.float32)
    for _ in range(shape[0] * shape[1] // CELLS_A_BLOB):
        row, column = generator.integers(0, shape)
        size = generator.integers(2, 6)
        occupancy[row : row + size, column : column + size] = generator.uniform(0.5, 1.0)
    return occupancy


def sensor_inputs(backbone: TransfuserConfig) -> tuple[TensorSpec, ...]:
    """Return the inputs of a planner with a Transfuser backbone: camera, LiDAR, ego status.

    The earlier LiDAR sweep may be left out, as when the car has only just been switched on.
    """
    sizes, reach = dict(backbone.input_sizes()), backbone.lidar_range
    cells = f"rows x, columns y, both from {-reach:g} to {reach:g} m"
    before = TensorSpec(
        LIDAR_BEFORE,
        F32,
        ("B", *sizes["lidar"]),
        f"as lidar, {LIDAR_BEFORE_S:g} s ago, in the frame of now",
        range=(0.0, 1.0),
        optional=True,
    )
    most = (-FASTEST_STATUS, FASTEST_STATUS)
    return (
        TensorSpec("camera", "uint8", ("B", *sizes["camera"])),
        TensorSpec("lidar", F32, ("B", *sizes["lidar"]), cells, range=(0.0, 1.0)),
        TensorSpec("ego_status", F32, ("B", STATUS), STATUS_UNIT, range=most),
        *([before] if backbone.lidar_before else []),
    )


def perceived(backbone: TransfuserConfig, *, agents: int, classes: int) -> tuple[TensorSpec, ...]:
    """Return the extras of a backbone's perception: agents, and classes on the ground."""
    reach = backbone.lidar_range
    return (
        TensorSpec("agents", F32, ("B", agents, AGENT_STATE), "m, m, rad, m, m"),
        TensorSpec("agent_scores", F32, ("B", agents), range=(0.0, 1.0)),
        TensorSpec(
            "bev_semantics",
            F32,
            ("B", classes, *backbone.semantic_size),
            range=(0.0, 1.0),
            extent=(0.0, reach, -reach, reach),
        ),
    )


def sensor_guard(backbone: TransfuserConfig, *, foretold: bool, lasts_s: float) -> GuardEntry:
    """Return a guard by a backbone's perception.

    foretold: whether encode gives what others will take, every FORETOLD_S
    lasts_s: s from now to the last pose
    """
    reach = backbone.lidar_range
    ahead = (-reach, reach + backbone.far_range, -reach, reach)
    taken = RasterEntry("foretold", ahead, first_s=FORETOLD_S, step_s=FORETOLD_S)
    return GuardEntry(
        horizon_s=min(GUARD_HORIZON_S, lasts_s),
        route_drives=False if foretold and lasts_s == PLAN_TIMES[-1] else None,
        size=NUPLAN_CAR,
        road=RasterEntry("bev_semantics", (0.0, reach, -reach, reach), complement_of=0),
        occupied=taken if foretold else None,
        agents=AgentsEntry("agents", "agent_scores"),
    )


def sensor_request(card: ModelCard, sizes: Sizes, seed: int) -> AnchorRequest:
    """Return a request with random inputs, and a command and a motion that a car may have."""
    generator, B = torch.Generator().manual_seed(seed), sizes["B"]
    inputs = {spec.name: random_tensor(spec, sizes, generator=generator) for spec in card.inputs}
    speed = 15.0 * torch.rand(B, 1, generator=generator)
    rest = torch.randn(B, STATUS - COMMANDS - 1, generator=generator)
    inputs["ego_status"] = torch.cat([_commands(B, generator), speed, rest], -1)
    return _request(inputs)


def street_request(layout: BevLayout, card: ModelCard, sizes: Sizes, seed: int) -> AnchorRequest:
    """Return a request for cars in straight streets of any width, with blocks beside them; for a
    layout of features, in random ones; for sensors, with random pictures and sweeps.
    """
    generator, B = torch.Generator().manual_seed(seed), sizes["B"]
    specs = {spec.name: spec for spec in card.inputs}
    if "bev" in specs:
        drawn = layout.dtype == "uint8"
        seen = {"bev": (_streets if drawn else _features)(layout, B, generator)}
    else:
        names = [name for name in (*SENSED, LIDAR_BEFORE) if name in specs]
        seen = {name: random_tensor(specs[name], sizes, generator=generator) for name in names}
    speed = FASTEST * torch.rand(B, 1, generator=generator)
    pulls = SHARPEST * (2 * torch.rand(B, 2, generator=generator) - 1)
    motion = torch.cat([_commands(B, generator), speed, torch.zeros(B, 1), pulls], -1)
    inputs = {
        **seen,
        "ego_status": motion,
        "vehicle_size": 2 + 3 * torch.rand(B, 2, generator=generator),
        "route": _routes(B, generator),
    }
    own = {name: spec for name, spec in specs.items() if name not in inputs}
    told = (torch.arange(B) < max(1, B - 1))[:, None]  # the last of several scenes has none
    if "goal" in own:
        goals = torch.rand(B, sizes.get("G", 3), 2, generator=generator)
        inputs["goal"] = told[..., None] * (goals * torch.tensor([60.0, 20.0]) - 10.0)
    if "score_weights" in own:
        drawn = 10 * torch.rand(B, int(own["score_weights"].shape[1]), generator=generator)
        inputs["score_weights"] = told * drawn
    return _request(inputs)


def _streets(layout: BevLayout, B: int, generator: torch.Generator) -> Tensor:
    """Draw straight streets of any width as uint8 [B, C, H, W], with blocks beside them."""
    right, left = layout.extent[2:]
    middles = left - (left - right) * (torch.arange(layout.columns) + 0.5) / layout.columns
    width = torch.empty(B, 1).uniform_(*WIDTHS, generator=generator)
    street = (middles.abs() < width / 2)[:, None, None]
    blocks = (B, layout.channels, -(-layout.rows // BLOCK), -(-layout.columns // BLOCK))
    taken = torch.rand(blocks, generator=generator) < TAKEN
    taken = taken.repeat_interleave(BLOCK, -1).repeat_interleave(BLOCK, -2)
    taken = taken[..., : layout.rows, : layout.columns]
    bev = 255 * (taken & ~street).to(torch.uint8)
    bev[:, layout.drivable] = 255 * street[:, 0].to(torch.uint8)
    return bev


def _features(layout: BevLayout, B: int, generator: torch.Generator) -> Tensor:
    return torch.randn(B, layout.channels, layout.rows, layout.columns, generator=generator)


def _routes(B: int, generator: torch.Generator) -> Tensor:
    """Draw routes that bend to either side; the last of several scenes has none."""
    turn = TURNING * torch.randn(B, 1, generator=generator) * torch.linspace(0, 1, ROUTE_POINTS)
    heading = turn.cumsum(-1)
    places = ROUTE_SPACING_M * torch.stack([heading.cos(), heading.sin()], -1).cumsum(1)
    has_route = torch.arange(B) < max(1, B - 1)
    return has_route[:, None, None] * places


def _commands(B: int, generator: torch.Generator) -> Tensor:
    """Draw one-hot commands [B, COMMANDS]."""
    return F.one_hot(torch.randint(COMMANDS, (B,), generator=generator), COMMANDS).float()


def _request(inputs: dict[str, Tensor]) -> AnchorRequest:
    return AnchorRequest.build(inputs={name: tensor.numpy() for name, tensor in inputs.items()})

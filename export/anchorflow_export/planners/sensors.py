"""What planners that see by camera and LiDAR are asked with, and what they tell of it."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional as F

from anchorflow_client.contract import TensorSpec
from anchorflow_client.sensors import LIDAR_BEFORE_S
from anchorflow_export.planners.specs import F32
from anchorflow_export.tracing import random_tensor
from anchorflow_models.transfuser import AGENT_STATE, LIDAR_BEFORE, MOTION, STATUS, TransfuserConfig
from anchorflow_service.bundle import Bundle

COMMANDS = MOTION.start  # of the ego status
FASTEST = 60.0  # m/s, and m/s²: what a status may say
STATUS_UNIT = (
    "command left, straight, right, unknown: 0 or 1; velocity x, y: m/s; acceleration x, y: m/s^2"
)


def sensor_inputs(backbone: TransfuserConfig) -> tuple[TensorSpec, ...]:
    """What a planner with a Transfuser backbone is asked with: camera, LiDAR, ego status.

    The LiDAR of before may be left out, as when the car has only just been switched on.
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
    return (
        TensorSpec("camera", "uint8", ("B", *sizes["camera"])),
        TensorSpec("lidar", F32, ("B", *sizes["lidar"]), cells, range=(0.0, 1.0)),
        TensorSpec(
            "ego_status",
            F32,
            ("B", STATUS),
            STATUS_UNIT,
            range=(-FASTEST, FASTEST),
        ),
        *([before] if backbone.lidar_before else []),
    )


def perceived(backbone: TransfuserConfig, *, agents: int, classes: int) -> tuple[TensorSpec, ...]:
    """Of what such a planner has seen: so many agents, and classes of what is on the ground."""
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


def random_sensors(bundle: Bundle, B: int, generator: torch.Generator) -> dict[str, Tensor]:
    """Of the types and ranges that the bundle says; a command and a motion that a car may have."""
    inputs = {
        spec.name: random_tensor(spec, {"B": B}, generator=generator)
        for spec in bundle.manifest.request.inputs
    }
    command = F.one_hot(torch.randint(COMMANDS, (B,), generator=generator), COMMANDS)
    speed = 15.0 * torch.rand(B, 1, generator=generator)
    rest = torch.randn(B, STATUS - COMMANDS - 1, generator=generator)
    inputs["ego_status"] = torch.cat([command, speed, rest], -1)
    return inputs

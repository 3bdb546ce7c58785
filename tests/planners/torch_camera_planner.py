"""The camera planner of image_planner.py as a torch network, with an adapter of its own: a second
planner for tests of the exporter, the trainer and the registry.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from image_planner import HEIGHT, TIMES, WIDTH, D, K, T
from torch import Tensor, nn

from anchorflow_client.contract import (
    AnchorRequest,
    AnswerSpec,
    ModelCard,
    NoFinish,
    TensorSpec,
    TensorsSpec,
    TimeSpec,
    VocabularySpec,
)
from anchorflow_export.adapter import ExportChoices, PlannerAdapter, PlannerParts, Sizes
from anchorflow_export.bundle import BundleDescription
from anchorflow_export.tracing import random_tensor
from anchorflow_models.registry import Planner
from anchorflow_models.torch_graphs import Role

Outputs = dict[str, Tensor]

NAME = "tiny_camera"
DESCRIPTION = BundleDescription(name="tiny-camera", version="1.0.0", planner=NAME)


@dataclass(frozen=True)
class CameraConfig:
    """size: trajectories of the vocabulary; spread: m/s aside from one to the next"""

    size: int = K
    spread: float = 1.0


class CameraPlanner(nn.Module):
    """aside: [K] m/s; aim: of the brightness, 0 to 1, at a trajectory's number"""

    times: Tensor

    def __init__(self, config: CameraConfig) -> None:
        super().__init__()
        self.config = config
        order = torch.arange(config.size, dtype=torch.float32)
        self.aside = nn.Parameter(config.spread * (order - (config.size - 1) / 2))
        self.aim = nn.Parameter(torch.tensor(config.size - 1.0))
        self.register_buffer("times", torch.from_numpy(TIMES))

    def encode(self, camera: Tensor, ego_status: Tensor) -> Outputs:
        """camera: uint8 [B,3,H,W]; ego_status: [B,4] -> brightness, speed, is_dark [B,1], BEV"""
        bev_semantics = camera.float() / 255
        brightness = bev_semantics.mean((1, 2, 3))[:, None]
        return {
            "brightness": brightness,
            "speed": ego_status[:, :1],
            "bev_semantics": bev_semantics,
            "is_dark": brightness < 0.2,
        }

    def score(self, brightness: Tensor, speed: Tensor) -> Outputs:
        """brightness, speed: [B,1] -> trajectories [B,K,T,D], scores [B,K], goals [B,K,2]"""
        x = (speed * self.times)[:, None].expand(-1, len(self.aside), -1)
        y = (self.aside[:, None] * self.times).expand_as(x)
        heading = (0.1 * self.aside[:, None]).expand_as(x)
        trajectories = torch.stack([x, y, heading], -1)
        order = torch.arange(len(self.aside), dtype=torch.float32)
        scores = -((self.aim * brightness - order) ** 2)
        return {"trajectories": trajectories, "scores": scores, "goals": trajectories[:, :, -1, :2]}


PLANNER = Planner(NAME, CameraConfig, CameraPlanner)

CAMERA = TensorSpec("camera", "uint8", ("B", 3, HEIGHT, WIDTH))
STATUS = TensorSpec(
    "ego_status", "float32", ("B", 4), "m/s, m/s, m/s^2, m/s^2", range=(-60.0, 60.0)
)
GOALS = TensorSpec("goals", "float32", ("B", "N", 2), "m")
BEV = TensorSpec("bev_semantics", "float32", ("B", 3, HEIGHT, WIDTH), range=(0.0, 1.0))


def camera_adapter(model: CameraPlanner, _choices: ExportChoices) -> PlannerAdapter:
    """Adapt a network: two graphs, encode and score, and the best of the vocabulary."""
    return PlannerAdapter(
        parts=PlannerParts(
            inputs=(CAMERA, STATUS),
            conditioning=TensorsSpec(),
            sampler=VocabularySpec(size=model.config.size),
            finish=NoFinish(),
            time=TimeSpec(steps=T, first_s=0.5, dt=0.5),
            answer=AnswerSpec(
                components=("x", "y", "heading")[:D], arrays=("scores",), extras=(GOALS, BEV)
            ),
        ),
        roles={
            "encode": Role(
                model,
                "encode",
                inputs=("camera", "ego_status"),
                outputs=("brightness", "speed", "bev_semantics", "is_dark"),
            ),
            "score": Role(
                model,
                "score",
                inputs=("brightness", "speed"),
                outputs=("trajectories", "scores", "goals"),
            ),
        },
        request=_request,
        trials=({"B": 1}, {"B": 5}),
        scene_inputs=("camera", "ego_status"),
        sample_sizes={"B": 3},
        num_samples=3,
    )


def _request(card: ModelCard, sizes: Sizes, seed: int) -> AnchorRequest:
    """Return pictures each darker than the one before, so that each chooses another trajectory."""
    generator = torch.Generator().manual_seed(seed)
    inputs = {spec.name: random_tensor(spec, sizes, generator=generator) for spec in card.inputs}
    darker = torch.arange(1, sizes["B"] + 1, dtype=torch.uint8)
    inputs["camera"] //= darker[:, None, None, None]
    return AnchorRequest.build(inputs={name: tensor.numpy() for name, tensor in inputs.items()})

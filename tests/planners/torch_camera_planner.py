"""The camera planner of image_planner.py as a torch network, with an adapter of its own: what
stands beside the exporter, the trainer and the registry where they are shown a second planner.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import torch
from image_planner import HEIGHT, TIMES, WIDTH, D, K, T
from torch import Tensor, nn

from anchorflow_client.contract import AnchorRequest, TensorSpec, resolve_for_card
from anchorflow_export.adapter import (
    ExportChoices,
    GraphTrial,
    PlannerParts,
    SampleTrial,
    TracedGraph,
)
from anchorflow_export.tracing import random_tensor, trace
from anchorflow_models.registry import Planner
from anchorflow_service.bundle import Bundle
from anchorflow_service.bundle.manifest import (
    AnswerEntry,
    NoFinishEntry,
    TensorsEntry,
    TimeEntry,
    VocabularyEntry,
)
from anchorflow_service.engine.conditioning.tensors import TensorConditioning
from anchorflow_service.engine.samplers.vocabulary import VocabularySampler

Outputs = dict[str, Tensor]

NAME = "tiny_camera"
TRIALS = (1, 5)  # B; traced at another


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
        return {
            "trajectories": trajectories,
            "scores": scores,
            "goals": trajectories[:, :, -1, :2],
        }


class Encode(nn.Module):
    def __init__(self, model: CameraPlanner) -> None:
        super().__init__()
        self.model = model

    def forward(self, camera: Tensor, ego_status: Tensor) -> tuple[Tensor, ...]:
        return tuple(self.model.encode(camera, ego_status).values())


class Score(nn.Module):
    def __init__(self, model: CameraPlanner) -> None:
        super().__init__()
        self.model = model

    def forward(self, brightness: Tensor, speed: Tensor) -> tuple[Tensor, ...]:
        return tuple(self.model.score(brightness, speed).values())


PLANNER = Planner(NAME, CameraConfig, CameraPlanner)

CAMERA = TensorSpec("camera", "uint8", ("B", 3, HEIGHT, WIDTH))
STATUS = TensorSpec(
    "ego_status", "float32", ("B", 4), "m/s, m/s, m/s^2, m/s^2", range=(-60.0, 60.0)
)
GOALS = TensorSpec("goals", "float32", ("B", "N", 2), "m")
BEV = TensorSpec("bev_semantics", "float32", ("B", 3, HEIGHT, WIDTH), range=(0.0, 1.0))


@dataclass(frozen=True)
class CameraAdapter:
    """Two graphs, encode and score, and the best of the vocabulary."""

    model: CameraPlanner

    @property
    def parts(self) -> PlannerParts:
        """What the manifest says of it."""
        return PlannerParts(
            inputs=(CAMERA, STATUS),
            conditioning=TensorsEntry(),
            sampler=VocabularyEntry(size=self.model.config.size),
            finish=NoFinishEntry(),
            time=TimeEntry(steps=T, first_s=0.5, dt=0.5),
            answer=AnswerEntry(
                components=("x", "y", "heading")[:D], arrays=("scores",), extras=(GOALS, BEV)
            ),
        )

    def trace(self) -> dict[str, TracedGraph]:
        """encode and score."""
        encode = trace(
            Encode(self.model),
            inputs=(CAMERA, STATUS),
            outputs=("brightness", "speed", "bev_semantics", "is_dark"),
        )
        brightness, speed, *_ = encode.outputs
        outputs = ("trajectories", "scores", "goals")
        score = trace(Score(self.model), inputs=(brightness, speed), outputs=outputs)
        return {"encode": encode, "score": score}

    def graph_trials(self, bundle: Bundle) -> Iterator[GraphTrial]:
        """Both graphs at several B."""
        for B in TRIALS:
            inputs = _inputs(bundle, B)
            context = self.model.encode(**inputs)
            yield GraphTrial(f"encode at B={B}", "encode", inputs, context)
            given = {name: context[name] for name in ("brightness", "speed")}
            yield GraphTrial(f"score at B={B}", "score", given, self.model.score(**given))

    def sample_trials(self, bundle: Bundle) -> Iterator[SampleTrial]:
        """The engine's best three of each scene, beside torch's."""
        inputs, count = _inputs(bundle, 3), 3
        request = AnchorRequest.build(
            inputs={name: tensor.numpy() for name, tensor in inputs.items()}, num_samples=count
        )
        sampler = VocabularySampler(bundle, threads=1, provider="cpu")
        scenes = TensorConditioning(bundle.manifest).scenes(resolve_for_card(request, bundle.card))
        context = self.model.encode(**inputs)
        expected = self.model.score(context["brightness"], context["speed"])
        best = expected["scores"].argsort(dim=-1, descending=True, stable=True)[:, :count]
        for b, scene in enumerate(scenes):
            encoded = sampler.encode(scene, threads=1)
            drawn = sampler.sample(scene, encoded, threads=1, check=lambda: None)
            got = {"trajectories": drawn.states, **drawn.arrays}
            for name in ("trajectories", "scores", "goals"):
                of_best = expected[name][b, best[b]].numpy()
                yield SampleTrial(f"sample of scene {b}, {name}", got[name], of_best)


def _inputs(bundle: Bundle, B: int) -> Outputs:
    """Each picture darker than the one before, so that each chooses another trajectory."""
    generator = torch.Generator().manual_seed(B)
    inputs = {
        spec.name: random_tensor(spec, {"B": B}, generator=generator)
        for spec in bundle.manifest.request.inputs
    }
    inputs["camera"] //= torch.arange(1, B + 1, dtype=torch.uint8)[:, None, None, None]
    return inputs


def camera_adapter(model: CameraPlanner, _choices: ExportChoices) -> CameraAdapter:
    """The adapter of a network; it has no use for the choices."""
    return CameraAdapter(model)

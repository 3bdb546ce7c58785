"""V2X-VLM's adapter.

vision   pixels                                             -> features, once a picture
encode   both pictures' features, has_…, tokens             -> trajectories [B,1,T,3]
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor, nn

from anchorflow_client.contract import AnchorRequest, TensorSpec, resolve_for_card
from anchorflow_export.adapter import (
    ExportChoices,
    GraphTrial,
    PlannerParts,
    SampleTrial,
    TracedGraph,
)
from anchorflow_export.errors import ExportError
from anchorflow_export.planners.specs import COMPONENTS, F32
from anchorflow_export.tracing import trace
from anchorflow_models.v2x_vlm import V2XVLM
from anchorflow_models.v2x_vlm.network import poses
from anchorflow_service.bundle import Bundle
from anchorflow_service.bundle.manifest import (
    AnswerEntry,
    NoFinishEntry,
    TimeEntry,
    VisionLanguageEntry,
    VocabularyEntry,
)
from anchorflow_service.engine.conditioning.vision_language import VisionLanguageConditioning
from anchorflow_service.engine.samplers.vocabulary import VocabularySampler

VEHICLE, INFRASTRUCTURE, PROMPT = "vehicle_image", "infrastructure_image", "prompt"
INPUTS = (
    TensorSpec(VEHICLE, "uint8", ("B", 3, "H", "W")),
    TensorSpec(INFRASTRUCTURE, "uint8", ("B", 3, "HI", "WI"), optional=True),
    TensorSpec(PROMPT, "text", ("B",)),
)
TRIALS = ((1, 3), (3, 11))
"""B and L; traced at others."""
WORDS = "The ego vehicle drives at 7.5 m/s."


class Look(nn.Module):
    def __init__(self, model: V2XVLM) -> None:
        super().__init__()
        self.model = model

    def forward(self, pixels: Tensor) -> Tensor:
        return self.model.look(pixels)


class Drive(nn.Module):
    def __init__(self, model: V2XVLM) -> None:
        super().__init__()
        self.model = model

    def forward(
        self, vehicle: Tensor, infrastructure: Tensor, has_infrastructure: Tensor, tokens: Tensor
    ) -> Tensor:
        fused = self.model.fuse(vehicle, infrastructure, has_infrastructure, tokens)
        return poses(self.model.drive(fused))[:, None]


@dataclass(frozen=True)
class V2XAdapter:
    """Two graphs and a tokenizer. Raises `ExportError` where the network has none."""

    model: V2XVLM

    def __post_init__(self) -> None:
        if not self.model.tokenizer:
            raise ExportError("v2x_vlm: expected a network with its tokenizer, got one without")

    @property
    def parts(self) -> PlannerParts:
        """What the manifest says of it."""
        config = self.model.config
        return PlannerParts(
            inputs=INPUTS,
            conditioning=VisionLanguageEntry(
                images=(VEHICLE, INFRASTRUCTURE),
                text=PROMPT,
                image_size=config.image_size,
                max_tokens=config.max_tokens,
            ),
            sampler=VocabularyEntry(size=1),
            finish=NoFinishEntry(),
            time=TimeEntry(steps=config.waypoints, first_s=config.dt, dt=config.dt),
            answer=AnswerEntry(components=COMPONENTS),
            files={"tokenizer": ("tokenizer.json", self.model.tokenizer)},
        )

    def trace(self) -> dict[str, TracedGraph]:
        """vision and encode."""
        vision = trace(Look(self.model), inputs=(self._pixels,), outputs=("features",))
        encode = trace(Drive(self.model), inputs=self._encode_inputs, outputs=("trajectories",))
        return {"vision": vision, "encode": encode}

    def graph_trials(self, bundle: Bundle) -> Iterator[GraphTrial]:  # noqa: ARG002 - the protocol's
        """Both graphs at several B and L, with and without the roadside picture."""
        for B, L in TRIALS:
            generator = torch.Generator().manual_seed(B)
            size = self.model.config.image_size
            pixels = torch.randint(0, 256, (2 * B, 3, size, size), generator=generator)
            features = self.model.look(pixels.to(torch.uint8))
            looked = {"pixels": pixels.to(torch.uint8)}
            yield GraphTrial(f"vision at B={2 * B}", "vision", looked, {"features": features})
            vehicle, infrastructure = features.chunk(2)
            there = torch.arange(B) % 2 == 0
            tokens = torch.randint(self.model.config.vocabulary, (B, L), generator=generator)
            values = (vehicle, infrastructure, there, tokens)
            names = [spec.name for spec in self._encode_inputs]
            expected = Drive(self.model)(*values)
            yield GraphTrial(
                f"encode at B={B}, L={L}",
                "encode",
                dict(zip(names, values, strict=True)),
                {"trajectories": expected},
            )

    def sample_trials(self, bundle: Bundle) -> Iterator[SampleTrial]:
        """The engine's answer to two scenes, and to two without the roadside picture."""
        size = self.model.config.image_size
        rng = np.random.default_rng(0)
        pictures = rng.integers(0, 256, (2, 2, 3, size, size), dtype=np.uint8)
        whole = {VEHICLE: pictures[0], INFRASTRUCTURE: pictures[1], PROMPT: [WORDS, WORDS[:20]]}
        alone = {VEHICLE: pictures[0], PROMPT: whole[PROMPT]}
        for what, inputs in (("both pictures", whole), ("one picture", alone)):
            yield from self._samples(bundle, what, inputs)

    def _samples(self, bundle: Bundle, what: str, inputs: dict) -> Iterator[SampleTrial]:
        request = AnchorRequest.build(inputs=inputs)
        conditioning = VisionLanguageConditioning(bundle)
        sampler = VocabularySampler(bundle, threads=1, provider="cpu")
        for b, scene in enumerate(conditioning.scenes(resolve_for_card(request, bundle.card))):
            encoded = sampler.encode(scene, threads=1)
            drawn = sampler.sample(scene, encoded, threads=1, check=lambda: None)
            vehicle = self.model.look(torch.from_numpy(inputs[VEHICLE][b : b + 1]))
            there = INFRASTRUCTURE in inputs
            second = vehicle
            if there:
                second = self.model.look(torch.from_numpy(inputs[INFRASTRUCTURE][b : b + 1]))
            values = (vehicle, second, torch.tensor([there]), torch.from_numpy(scene.tokens))
            expected = Drive(self.model)(*values)[0].numpy()
            yield SampleTrial(f"sample of scene {b}, {what}", drawn.states, expected)

    @property
    def _pixels(self) -> TensorSpec:
        size = self.model.config.image_size
        return TensorSpec("pixels", "uint8", ("B", 3, size, size))

    @property
    def _encode_inputs(self) -> tuple[TensorSpec, ...]:
        config = self.model.config
        shape = ("B", config.size.embed_dim[-1], config.cells, config.cells)
        return (
            TensorSpec(f"{VEHICLE}_features", F32, shape),
            TensorSpec(f"{INFRASTRUCTURE}_features", F32, shape),
            TensorSpec(f"has_{INFRASTRUCTURE}", "bool", ("B",)),
            TensorSpec("tokens", "int64", ("B", "L"), range=(0, config.vocabulary - 1)),
        )


def v2x_vlm_adapter(model: V2XVLM, _choices: ExportChoices) -> V2XAdapter:
    """The adapter of a network; it has no use for the choices."""
    return V2XAdapter(model)

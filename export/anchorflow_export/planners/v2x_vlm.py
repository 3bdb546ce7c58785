"""V2X-VLM's adapter, with its tokenizer.

vision   pixels                                             -> features, once a picture
encode   both pictures' features, has_…, tokens             -> trajectories [B,1,T,3]
"""

from __future__ import annotations

import numpy as np
from torch import Tensor, nn

from anchorflow_client.contract import (
    AnchorRequest,
    AnswerSpec,
    ModelCard,
    NoFinish,
    TensorSpec,
    TimeSpec,
    VisionLanguageSpec,
    VocabularySpec,
)
from anchorflow_export.adapter import (
    COMPONENTS,
    F32,
    ExportChoices,
    PlannerAdapter,
    PlannerParts,
    Sizes,
)
from anchorflow_export.tracing import ExportError
from anchorflow_models.torch_graphs import Role
from anchorflow_models.v2x_vlm import V2XVLM
from anchorflow_models.v2x_vlm.network import poses
from anchorflow_service.bundle.entries import VisionLanguageEntry

VEHICLE, INFRASTRUCTURE, PROMPT = "vehicle_image", "infrastructure_image", "prompt"
INPUTS = (
    TensorSpec(VEHICLE, "uint8", ("B", 3, "H", "W")),
    TensorSpec(INFRASTRUCTURE, "uint8", ("B", 3, "HI", "WI"), optional=True),
    TensorSpec(PROMPT, "text", ("B",)),
)
ENCODE_INPUTS = (
    f"{VEHICLE}_features",
    f"{INFRASTRUCTURE}_features",
    f"has_{INFRASTRUCTURE}",
    "tokens",
)
TRIALS = ({"B": 1, "L": 3}, {"B": 3, "L": 11})
WORDS = "The ego vehicle drives at 7.5 m/s."


class Graphs(nn.Module):
    """The network cut into its graphs."""

    def __init__(self, model: V2XVLM) -> None:
        super().__init__()
        self.model = model

    def vision(self, pixels: Tensor) -> Tensor:
        """uint8 [B,3,S,S] -> features [B,C,h,h]."""
        return self.model.look(pixels)

    def encode(
        self,
        vehicle_image_features: Tensor,
        infrastructure_image_features: Tensor,
        has_infrastructure_image: Tensor,
        tokens: Tensor,
    ) -> Tensor:
        """Both pictures' features, [B] and [B,L] -> trajectories [B,1,T,3]."""
        fused = self.model.fuse(
            vehicle_image_features, infrastructure_image_features, has_infrastructure_image, tokens
        )
        return poses(self.model.drive(fused))[:, None]


def v2x_vlm_adapter(model: V2XVLM, _choices: ExportChoices) -> PlannerAdapter:
    """Adapt a network; it uses none of the choices. Raises `ExportError` without a tokenizer."""
    if not model.tokenizer:
        raise ExportError("v2x_vlm: expected a network with its tokenizer, got one without")
    config, graphs = model.config, Graphs(model)
    features = ("B", config.size.embed_dim[-1], config.cells, config.cells)
    return PlannerAdapter(
        parts=PlannerParts(
            inputs=INPUTS,
            conditioning=VisionLanguageEntry(
                image_size=config.image_size,
                max_tokens=config.max_tokens,
                images=(VEHICLE, INFRASTRUCTURE),
                text=PROMPT,
            ),
            sampler=VocabularySpec(size=1),
            finish=NoFinish(),
            time=TimeSpec(steps=config.waypoints, first_s=config.dt, dt=config.dt),
            answer=AnswerSpec(components=COMPONENTS),
            files={"tokenizer": ("tokenizer.json", model.tokenizer)},
        ),
        roles={
            "vision": Role(graphs, "vision", inputs=("pixels",), outputs=("features",)),
            "encode": Role(graphs, "encode", inputs=ENCODE_INPUTS, outputs=("trajectories",)),
        },
        own=(
            TensorSpec("pixels", "uint8", ("B", 3, config.image_size, config.image_size)),
            TensorSpec(ENCODE_INPUTS[0], F32, features, range=(-1.0, 1.0)),
            TensorSpec(ENCODE_INPUTS[1], F32, features, range=(-1.0, 1.0)),
            TensorSpec(ENCODE_INPUTS[2], "bool", ("B",)),
            TensorSpec("tokens", "int64", ("B", "L"), range=(0, config.vocabulary - 1)),
        ),
        request=_request,
        trials=TRIALS,
    )


def _request(card: ModelCard, sizes: Sizes, seed: int) -> AnchorRequest:
    """Return pictures of noise, and a text; of two scenes the second's is shorter."""
    assert isinstance(card.conditioning, VisionLanguageSpec)
    size = card.conditioning.image_size
    generator = np.random.default_rng(seed)
    pictures = generator.integers(0, 256, (2, sizes["B"], 3, size, size), dtype=np.uint8)
    texts = [WORDS[: len(WORDS) - 14 * b] for b in range(sizes["B"])]
    return AnchorRequest.build(
        inputs={VEHICLE: pictures[0], INFRASTRUCTURE: pictures[1], PROMPT: texts}
    )

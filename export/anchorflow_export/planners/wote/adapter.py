"""WoTE on its way to a bundle: the sensors in one graph, all anchors in another."""

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
from anchorflow_export.planners.sensors import perceived, random_sensors, sensor_inputs
from anchorflow_export.planners.specs import COMPONENTS, F32
from anchorflow_export.tracing import trace, trace_role
from anchorflow_models.sub_scores import SUB_SCORES
from anchorflow_models.wote import WoTE, WoteConfig
from anchorflow_models.wote.wote import POSE
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

TOLD = ("agents", "agent_scores", "bev_semantics")
SCORED = ("trajectories", "scores", "offsets", "im_rewards", "sim_rewards")
TRIALS = (1, 3)  # B; traced at another


def answer_extras(config: WoteConfig) -> tuple[TensorSpec, ...]:
    """What is sent along where a request asks for it."""
    return (
        TensorSpec("offsets", F32, ("B", "N", config.num_steps, POSE), "m, m, rad"),
        TensorSpec("im_rewards", F32, ("B", "N"), range=(0.0, 1.0)),
        TensorSpec("sim_rewards", F32, ("B", "N", len(SUB_SCORES)), range=(0.0, 1.0)),
        *perceived(config.backbone, agents=config.agents, classes=config.semantic_classes),
    )


class Score(nn.Module):
    """The context -> what SCORED names; the anchors' own encoding is worked out beforehand."""

    anchors: Tensor

    def __init__(self, model: WoTE) -> None:
        super().__init__()
        self.model = model
        with torch.no_grad():
            self.register_buffer("anchors", model.encoded_anchors(), persistent=False)

    def forward(self, *context: Tensor) -> tuple[Tensor, ...]:
        given = dict(zip(self.model.context_for_score, context, strict=True))
        scored = self.model.score(**given, anchors=self.anchors)
        return tuple(scored[name] for name in SCORED)


@dataclass(frozen=True)
class WoteAdapter:
    """Two graphs, encode and score, and the best of the anchors."""

    model: WoTE

    @property
    def parts(self) -> PlannerParts:
        """What the manifest says of it."""
        config = self.model.config
        return PlannerParts(
            inputs=sensor_inputs(config.backbone),
            conditioning=TensorsEntry(),
            sampler=VocabularyEntry(size=config.judged),
            finish=NoFinishEntry(),
            time=TimeEntry(steps=config.num_steps, first_s=config.dt, dt=config.dt),
            answer=AnswerEntry(
                components=COMPONENTS, arrays=("scores",), extras=answer_extras(config)
            ),
        )

    def trace(self) -> dict[str, TracedGraph]:
        """encode and score."""
        model, inputs = self.model, sensor_inputs(self.model.config.backbone)
        told = (*model.context_for_score, *TOLD)
        encode = trace_role(model, "encode", inputs=inputs, outputs=told)
        context = encode.outputs[: len(model.context_for_score)]
        return {"encode": encode, "score": trace(Score(model), inputs=context, outputs=SCORED)}

    def graph_trials(self, bundle: Bundle) -> Iterator[GraphTrial]:
        """Both graphs at several B."""
        for B in TRIALS:
            inputs = random_sensors(bundle, B, torch.Generator().manual_seed(B))
            context = self.model.encode(**inputs)
            yield GraphTrial(f"encode at B={B}", "encode", inputs, context)
            given = {name: context[name] for name in self.model.context_for_score}
            yield GraphTrial(f"score at B={B}", "score", given, self.model.score(**given))

    def sample_trials(self, bundle: Bundle) -> Iterator[SampleTrial]:
        """The engine's answer of a scene beside torch's, the best first."""
        inputs = random_sensors(bundle, 1, torch.Generator().manual_seed(len(TRIALS)))
        request = AnchorRequest.build(
            inputs={name: tensor.numpy() for name, tensor in inputs.items()},
            num_samples=self.model.config.judged,
        )
        sampler = VocabularySampler(bundle, threads=1, provider="cpu")
        resolved = resolve_for_card(request, bundle.card)
        (scene,) = TensorConditioning(bundle.manifest).scenes(resolved)
        encoded = sampler.encode(scene, threads=1)
        drawn = sampler.sample(scene, encoded, threads=1, check=lambda: None)
        context = self.model.encode(**inputs)
        given = self.model.score(**{name: context[name] for name in self.model.context_for_score})
        states, scores = given["trajectories"][0].numpy(), given["scores"][0].numpy()
        # Scores that are nearly equal may stand in either order, so each is found by its place.
        apart = np.abs(drawn.states[:, None] - states).max((-2, -1))
        nearest, got = apart.argmin(1), drawn.arrays["scores"]
        yield SampleTrial("sample, trajectories", drawn.states, states[nearest])
        yield SampleTrial("sample, scores", got, scores[nearest], relative=True)
        yield SampleTrial("sample, the best first", got, -np.sort(-scores), relative=True)


def wote_adapter(model: WoTE, _choices: ExportChoices) -> WoteAdapter:
    """The adapter of a network; it has no use for the choices."""
    return WoteAdapter(model)

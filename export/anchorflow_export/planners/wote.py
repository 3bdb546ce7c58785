"""WoTE's adapter: the sensors in one graph, the scores of all anchors in another."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from anchorflow_client.contract import (
    AnswerSpec,
    TensorSpec,
    TensorsSpec,
    TimeSpec,
    VocabularySpec,
)
from anchorflow_export.adapter import COMPONENTS, F32, ExportChoices, PlannerAdapter, PlannerParts
from anchorflow_export.planners.random_requests import (
    ROUTE,
    perceived,
    sensor_guard,
    sensor_inputs,
    sensor_request,
)
from anchorflow_models.sub_scores import SUB_SCORES
from anchorflow_models.torch_graphs import Role
from anchorflow_models.wote import WoTE
from anchorflow_models.wote.wote import POSE

PERCEIVED = ("agents", "agent_scores", "bev_semantics")
SCORED = ("trajectories", "scores", "offsets", "im_rewards", "sim_rewards")


class Scorer(nn.Module):
    """WoTE's `score` on anchors that are encoded once, beforehand."""

    anchors: Tensor

    def __init__(self, model: WoTE) -> None:
        super().__init__()
        self.model = model
        with torch.no_grad():
            self.register_buffer("anchors", model.encoded_anchors(), persistent=False)

    def score(self, **context: Tensor) -> dict[str, Tensor]:
        """Return the tensors that SCORED names."""
        return self.model.score(**context, anchors=self.anchors)


def wote_adapter(model: WoTE, _choices: ExportChoices) -> PlannerAdapter:
    """Adapt a network; it uses none of the choices."""
    config = model.config
    inputs = sensor_inputs(config.backbone)
    names = tuple(spec.name for spec in inputs)
    context = model.context_for_score
    return PlannerAdapter(
        parts=PlannerParts(
            inputs=(*inputs, ROUTE),
            conditioning=TensorsSpec(),
            sampler=VocabularySpec(size=config.judged),
            finish=sensor_guard(
                config.backbone,
                foretold=bool(config.encounters),
                lasts_s=config.num_steps * config.dt,
            ),
            time=TimeSpec(steps=config.num_steps, first_s=config.dt, dt=config.dt),
            answer=AnswerSpec(
                components=COMPONENTS,
                arrays=("scores",),
                extras=(
                    TensorSpec("offsets", F32, ("B", "N", config.num_steps, POSE), "m, m, rad"),
                    TensorSpec("im_rewards", F32, ("B", "N"), range=(0.0, 1.0)),
                    TensorSpec("sim_rewards", F32, ("B", "N", len(SUB_SCORES)), range=(0.0, 1.0)),
                    *perceived(
                        config.backbone, agents=config.agents, classes=config.semantic_classes
                    ),
                ),
            ),
        ),
        roles={
            "encode": Role(model, "encode", inputs=names, outputs=(*context, *PERCEIVED)),
            "score": Role(Scorer(model), "score", inputs=context, outputs=SCORED),
        },
        request=sensor_request,
        trials=({"B": 1}, {"B": 3}),
        scene_inputs=names,
        sample_sizes={"B": 1},
        num_samples=config.judged,
        unordered={"score": SCORED},
    )

"""DiffusionDriveV2's adapter: the graphs of a truncated diffusion and of its two scorers."""

from __future__ import annotations

import inspect
from collections.abc import Iterable

import numpy as np

from anchorflow_client.contract import (
    AnswerSpec,
    SamplerChoice,
    TensorSpec,
    TensorsSpec,
    TimeSpec,
    uniform_schedule,
)
from anchorflow_export.adapter import COMPONENTS, F32, ExportChoices, PlannerAdapter, PlannerParts
from anchorflow_export.planners.random_requests import (
    ROUTE,
    perceived,
    sensor_guard,
    sensor_inputs,
    sensor_request,
)
from anchorflow_export.tracing import ExportError
from anchorflow_models.diffusiondrive import DiffusionDriveV2
from anchorflow_models.diffusiondrive.config import FIRST_S, POSES, SCHEDULES, STEP_S
from anchorflow_models.sub_scores import SUB_SCORES
from anchorflow_models.torch_graphs import Role
from anchorflow_models.transfuser import AGENT_QUERIES
from anchorflow_service.bundle.entries import TruncatedDiffusionEntry

OUTPUTS = {
    "encode": (
        *("anchors", "bev", "values", "agent_queries", "ego_query", "ego_motion", "foretold"),
        *("agents", "agent_scores", "bev_semantics"),
    ),
    "denoise": ("x_0", "trajectories", "class_scores"),
    "coarse": (
        *("candidates", "features", "coarse_scores", "poses_cls"),
        *("coarse_logits", "coarse_imitation"),
    ),
    "fine": ("scores", "sub_scores", "direction_scores"),
}
OWN = (
    TensorSpec("x_t", F32, ("B", "N", POSES, 2), range=(-1.0, 1.0)),
    TensorSpec("t", F32, ("B",), range=(0.0, 50.0)),
    TensorSpec("diversity", F32, ("B", "N", "V", 2), range=(-1.0, 1.0)),
)
TRIALS = ({"B": 1, "N": 20, "V": 2}, {"B": 3, "N": 5, "V": 1})


def start_level(model: DiffusionDriveV2, noise_scale: float) -> int:
    """Return the level whose noise spreads nearest to noise_scale times that of the start."""
    spread = (1.0 - model.config.noise_levels.signal) ** 0.5
    return int(np.abs(spread - noise_scale * spread[model.config.start]).argmin())


def diffusiondrive_adapter(model: DiffusionDriveV2, choices: ExportChoices) -> PlannerAdapter:
    """Adapt a network, whose own configuration says how it is sampled.

    Raises `ExportError` if its vocabulary is empty.
    """
    config = model.config
    try:
        model.check_vocabulary()
    except ValueError as error:
        raise ExportError(str(error)) from error
    inputs = sensor_inputs(config.backbone)
    names = tuple(spec.name for spec in inputs)
    direction = TensorSpec("direction_scores", F32, ("B", "N"), range=(0.0, 1.0))
    return PlannerAdapter(
        parts=PlannerParts(
            inputs=(*inputs, ROUTE),
            conditioning=TensorsSpec(),
            sampler=TruncatedDiffusionEntry(
                anchors=config.anchors,
                groups=config.groups,
                variants=config.variants,
                vocabulary=config.vocabulary,
                keep=config.keep,
                noise=config.noise_levels,
                start=start_level(model, choices.noise_scale),
                schedules=tuple(SCHEDULES.values()),
                steps=config.steps,
            ),
            finish=sensor_guard(
                config.backbone,
                foretold=bool(config.encounters),
                lasts_s=FIRST_S + (POSES - 1) * STEP_S,
            ),
            time=TimeSpec(steps=POSES, first_s=FIRST_S, dt=STEP_S),
            answer=AnswerSpec(
                components=COMPONENTS,
                arrays=("scores",),
                extras=(
                    TensorSpec("coarse_scores", F32, ("B", "N"), range=(0.0, 1.0)),
                    TensorSpec("sub_scores", F32, ("B", "N", len(SUB_SCORES)), range=(0.0, 1.0)),
                    *((direction,) if config.direction else ()),
                    TensorSpec("poses_cls", F32, ("B", "N")),
                    *perceived(config.backbone, agents=AGENT_QUERIES, classes=config.classes),
                ),
            ),
        ),
        roles=_roles(model, (*names, *(spec.name for spec in OWN))),
        own=OWN,
        request=sensor_request,
        trials=TRIALS,
        scene_inputs=names,
        num_samples=config.keep,
        samplers=[SamplerChoice(schedule=uniform_schedule(steps)) for steps in SCHEDULES],
    )


def _roles(model: DiffusionDriveV2, given: Iterable[str]) -> dict[str, Role]:
    """Return the graphs, each of which takes what the ones before give and its method names.

    Outputs that only some configurations use are left out of the others: the ego's motion and the
    others' future if the scorers take them, coarse's logits if they count beside fine's.
    """
    config, known, roles = model.config, [*given], {}
    used = {
        "ego_motion": config.ego_motion,
        "foretold": config.encounters,
        "coarse_logits": config.pessimistic,
        "coarse_imitation": config.pessimistic and config.imitation,
        "direction_scores": config.direction,
    }
    for role, names in OUTPUTS.items():
        parameters = inspect.signature(getattr(model, role)).parameters.values()
        taken = [p.name for p in parameters if p.name in known or p.default is p.empty]
        outputs = [name for name in names if used.get(name, True)]
        roles[role] = Role(model, role, inputs=taken, outputs=outputs)
        known += outputs
    return roles

"""GoalFlow's adapter: a flow to goals, on a raster of a car's surroundings."""

from __future__ import annotations

from collections.abc import Mapping
from copy import deepcopy
from dataclasses import fields, replace
from functools import partial

from anchorflow_client.contract import (
    AnswerSpec,
    NoFinish,
    OdeSpec,
    SamplerChoice,
    TensorSpec,
    TensorsSpec,
    TimeSpec,
    uniform_schedule,
)
from anchorflow_export.adapter import COMPONENTS, F32, ExportChoices, PlannerAdapter, PlannerParts
from anchorflow_export.planners.flowmp import PRIOR_BASIS, TIMES, drawn_states, flow_roles
from anchorflow_export.planners.random_requests import (
    GUARD_HORIZON_S,
    ROUTE,
    STATUS_UNIT,
    sensor_inputs,
    street_request,
)
from anchorflow_export.tracing import ExportError
from anchorflow_models.goalflow import BevLayout, GoalFlow, GoalFlowConfig
from anchorflow_models.goalflow.config import ScoreWeights
from anchorflow_models.goalflow.goalflow import STATE, SURROUNDINGS
from anchorflow_models.torch_graphs import Role
from anchorflow_service.bundle.entries import GuardEntry, OdeEntry, PriorEntry, RasterEntry
from anchorflow_service.engine.samplers.flow import PRIOR_MEAN

ENCODE_OUTPUTS = (
    *(PRIOR_MEAN, PRIOR_BASIS, "goals", "goal_scores", "features", "context", "course"),
    *SURROUNDINGS,
)
TRIALS = ({"B": 1, "N": 7, "K": 3, "G": 1}, {"B": 3, "N": 5, "K": 1, "G": 4})
SAMPLED = 17  # anchors, enough for two slices
DEFAULT_SAMPLER = OdeSpec("euler", uniform_schedule(1))

MOST_STATUS = 32.0
"""m/s, and m/s²: a faster car leaves the raster within four seconds, however it brakes."""
STATUS = TensorSpec("ego_status", F32, ("B", 8), STATUS_UNIT, (-MOST_STATUS, MOST_STATUS))
SIZE = TensorSpec("vehicle_size", F32, ("B", 2), "m", (0.3, 30.0))


WEIGHTS = tuple(each.name for each in fields(ScoreWeights))
OF_A_REQUEST = (
    TensorSpec("goal", F32, ("B", "G", 2), "m", (-1e3, 1e3), optional=True),
    TensorSpec(
        "score_weights", F32, ("B", len(WEIGHTS)), ", ".join(WEIGHTS), (0.0, 1e3), optional=True
    ),
)
"""Inputs of a bundle whose requests may bring them."""


def _scored_by(config: GoalFlowConfig, weights: Mapping[str, float]) -> GoalFlowConfig:
    """Return the configuration with some weights of its score changed."""
    if unknown := set(weights) - set(WEIGHTS):
        raise ExportError(f"score: expected of {', '.join(WEIGHTS)}, got {', '.join(unknown)}")
    try:
        return replace(config, score=replace(config.score, **weights))
    except ValueError as error:
        raise ExportError(str(error)) from error


def _finish(config: GoalFlowConfig) -> GuardEntry | NoFinish:
    """Return the guard by the raster's road and boxes; features have none to guard by."""
    layout = config.bev
    if layout.dtype != "uint8":
        return NoFinish()
    return GuardEntry(
        horizon_s=min(GUARD_HORIZON_S, config.num_steps * config.dt),
        size=None,
        road=RasterEntry("drivable", layout.covered),
        occupied=RasterEntry("occupied", layout.covered, step_s=config.dt),
    )


def bev_spec(layout: BevLayout) -> TensorSpec:
    """Return the spec of the raster that a request brings."""
    shape = ("B", layout.channels, layout.rows, layout.columns)
    return TensorSpec("bev", layout.dtype, shape, extent=layout.extent)


def _seen(config: GoalFlowConfig) -> tuple[TensorSpec, ...]:
    """Return the specs of what a request shows, and of how the ego moves."""
    if not config.sensors:
        return bev_spec(config.bev), STATUS
    specs = sensor_inputs(config.transfuser)
    return tuple(STATUS if spec.name == STATUS.name else spec for spec in specs)


def goalflow_adapter(model: GoalFlow, choices: ExportChoices) -> PlannerAdapter:
    """Adapt a copy of a trained network, whose noise gets the spread of the choices."""
    model = deepcopy(model)
    model.noise_scale, model.takes_goals = choices.noise_scale, choices.goal_inputs
    model.config = config = _scored_by(model.config, choices.score)
    sampler, more = choices.sampler.over(DEFAULT_SAMPLER), OF_A_REQUEST * choices.goal_inputs
    inputs = (*_seen(config), SIZE, ROUTE, *more)
    names = tuple(spec.name for spec in inputs)
    told = ("weights",) if more else ()
    aims = TensorSpec("trajectory_goals", F32, ("B", "N", 2), "m")
    scored = ("x_1", PRIOR_MEAN, *model.context_for_score, *told)
    encoded = (*ENCODE_OUTPUTS, *told, *((aims.name,) if more else ()))
    states = ("B", "N", config.num_steps, STATE)
    return PlannerAdapter(
        parts=PlannerParts(
            inputs=inputs,
            conditioning=TensorsSpec(),
            sampler=OdeEntry(
                method=sampler.method,
                schedule=sampler.schedule,
                prior=PriorEntry(mean=PRIOR_MEAN, basis=PRIOR_BASIS),
            ),
            finish=_finish(config),
            time=TimeSpec(steps=config.num_steps, first_s=config.dt, dt=config.dt),
            answer=AnswerSpec(
                components=COMPONENTS,
                arrays=("scores",),
                extras=(
                    TensorSpec("goals", F32, ("B", config.goals, 2), "m"),
                    TensorSpec("goal_scores", F32, ("B", config.goals), "", (0.0, 1.0)),
                    *((aims,) if more else ()),
                ),
            ),
        ),
        roles={
            "encode": Role(model, "encode", inputs=names, outputs=encoded),
            **flow_roles(model, model.context_for_modulate, model.context_for_field),
            "score": Role(model, "score", inputs=scored, outputs=("scores",)),
        },
        own=(TIMES, *(TensorSpec(name, F32, states) for name in ("x_t", PRIOR_MEAN, "x_1"))),
        request=partial(street_request, config.bev),
        trials=TRIALS,
        scene_inputs=names,
        draw=drawn_states(PRIOR_MEAN),
        unordered={"encode": ("goals", "goal_scores")},
        num_samples=SAMPLED,
        samplers=(SamplerChoice("euler", uniform_schedule(3)),),
    )

"""FlowMP's adapter: the graphs of a flow on a cost map."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from copy import deepcopy
from dataclasses import replace

import numpy as np

from anchorflow_client.contract import (
    AnswerSpec,
    CostMapSpec,
    LimitsSpec,
    OdeSpec,
    TensorSpec,
    TimeSpec,
    uniform_schedule,
)
from anchorflow_export.adapter import (
    COMPONENTS,
    F32,
    ExportChoices,
    PlannerAdapter,
    PlannerParts,
    Sizes,
)
from anchorflow_export.planners.random_requests import map_request
from anchorflow_models.flowmp import L2SafetyCFM
from anchorflow_models.torch_graphs import Role
from anchorflow_service.bundle.entries import OdeEntry, PriorEntry, SplineEntry
from anchorflow_service.engine.interfaces import Arrays
from anchorflow_service.engine.samplers.flow import PRIOR_MEAN
from anchorflow_trajectory.scene import ROUTE_STATES

F64 = "float64"
PRIOR_BASIS = "prior_basis"
ARRAYS = ("velocities", "accelerations", "scores", "clearance", "safe", "routes")
DEFAULT_SAMPLER = OdeSpec("rk4", uniform_schedule(8))
TIMES = TensorSpec("times", F32, ("K",), "", (0.0, 1.0))
TRIALS = (
    {"B": 1, "N": 1, "K": 17, "H": 64, "W": 64},
    {"B": 3, "N": 5, "K": 1, "H": 16, "W": 40},
    {"B": 2, "N": 64, "K": 8, "H": 97, "W": 50},
)
SAMPLED = {"B": 2, "N": 17, "H": 64, "W": 48}  # N enough for two slices


def flowmp_adapter(model: L2SafetyCFM, choices: ExportChoices) -> PlannerAdapter:
    """Adapt a copy of a trained network, whose noise gets the spread of the choices."""
    config, limits = model.config, choices.limits
    model = deepcopy(model)
    model.prior.widen(choices.noise_scale)
    T, D, horizon_s = config.num_steps, config.dim, limits.horizon_s
    sampler, states = choices.sampler.over(DEFAULT_SAMPLER), ("B", "N", T, 3 * D + 1)
    encoded = _encode_inputs(model, D=D, channels=config.map_channels)
    names = tuple(spec.name for spec in encoded)
    of_modulate, of_field = model.context_for_modulate, model.context_for_field
    encode_outputs = tuple(dict.fromkeys((PRIOR_BASIS, *of_modulate, *of_field)))
    return PlannerAdapter(
        parts=PlannerParts(
            inputs=(
                TensorSpec("cost_map", F32, ("B", "C", "H", "W"), "", (0.0, 1.0)),
                TensorSpec("map_geometry", F64, ("B", 3), "m, m, m/cell"),
                TensorSpec("x_curr", F64, ("B", 3 * D), _unit_of("m, m/s, m/s^2", D)),
                TensorSpec("x_goal", F64, ("B", 2 * D), _unit_of("m, m/s", D)),
                TensorSpec("w_style", F64, ("B", 3), "", (0.0, None)),
            ),
            conditioning=CostMapSpec(
                channels=config.map_channels,
                H=config.map_size,
                W=config.map_size,
                limits=LimitsSpec(horizon_s, limits.v_max, limits.a_max, choices.robot_radius),
                ranges=dict(choices.ranges),  # pyright: ignore[reportArgumentType] - it checks names
            ),
            sampler=OdeEntry(
                method=sampler.method,
                schedule=sampler.schedule,
                prior=PriorEntry(mean=ROUTE_STATES, basis=PRIOR_BASIS),
            ),
            finish=SplineEntry(
                smooth=True,
                project=True,
                safety_margin=choices.safety_margin,
                guidance=0.0,
                steps=choices.refine_steps,
                rate=choices.refine_rate,
                num_control_points=config.num_control_points,
                degree=config.degree,
            ),
            time=TimeSpec(steps=T, first_s=0.0, dt=horizon_s and horizon_s / (T - 1)),
            answer=AnswerSpec(components=COMPONENTS[:D], arrays=ARRAYS),
        ),
        roles={
            "encode": Role(model, "encode", inputs=names, outputs=encode_outputs),
            **flow_roles(model, of_modulate, of_field),
        },
        own=(*encoded, TIMES, *(TensorSpec(name, F32, states) for name in ("x_t", PRIOR_MEAN))),
        request=map_request,
        trials=TRIALS,
        scene_inputs=(*names, ROUTE_STATES),
        draw=drawn_states(ROUTE_STATES),
        sample_sizes=SAMPLED,
        num_samples=SAMPLED["N"],
    )


def flow_roles(model: object, modulate: Sequence[str], field: Sequence[str]) -> dict[str, Role]:
    """Return the graphs modulate and field of a flow, which take these outputs of encode."""
    states = ("x_t", PRIOR_MEAN, "modulation")
    return {
        "modulate": Role(model, "modulate", inputs=("times", *modulate), outputs=("modulation",)),
        "field": Role(model, "field", inputs=(*states, *field), outputs=("dx_t",)),
    }


def drawn_states(mean: str) -> Callable[[Sequence[TensorSpec], Arrays, Sizes, int], Arrays]:
    """Return a function that draws the own inputs of a flow's graphs: sorted times, and x_0.

    mean: name of the prior's components [B,M,T,S]
    """

    def draw(specs: Sequence[TensorSpec], given: Arrays, sizes: Sizes, seed: int) -> Arrays:
        generator = np.random.default_rng(seed)
        if [spec.name for spec in specs] == ["times"]:
            return {"times": np.sort(generator.random(sizes["K"], dtype=np.float32))}
        basis, components = given[PRIOR_BASIS], given[mean]
        noise = generator.standard_normal((sizes["N"], basis.shape[1]), dtype=np.float32)
        dealt = components[:, np.arange(sizes["N"]) % components.shape[1]]
        x = dealt + (noise @ basis).reshape(dealt.shape)
        return {"x_t": x, "x_1": x, PRIOR_MEAN: dealt}

    return draw


_ENCODE_INPUTS = {
    spec.name: spec
    for spec in (
        TensorSpec("cost_map", F32, ("B", "C", "H", "W"), "", (0.0, 1.0)),
        TensorSpec("map_geometry", F32, ("B", 3), "m, m, m/cell"),
        TensorSpec("clearance_field", F32, ("B", "H", "W"), "m"),
        TensorSpec("x_curr", F32, ("B", "3D"), "m, m/s, m/s^2"),
        TensorSpec("x_goal", F32, ("B", "2D"), "m, m/s"),
        TensorSpec("w_style", F32, ("B", 3), "", (0.0, 1.0)),
        TensorSpec("limits", F32, ("B", 4), "m/s, m/s^2, m, s", (0.0, None)),
    )
}


def _encode_inputs(model: L2SafetyCFM, *, D: int, channels: int) -> tuple[TensorSpec, ...]:
    """Return the inputs of a model's `encode`, by the names of its parameters."""
    sizes: dict[str | int, int] = {"C": channels, "3D": 3 * D, "2D": 2 * D}
    specs = (_ENCODE_INPUTS[name] for name in inspect.signature(model.encode).parameters)
    return tuple(
        replace(
            spec,
            shape=tuple(sizes.get(axis, axis) for axis in spec.shape),
            unit=_unit_of(spec.unit, D) if {"3D", "2D"} & {*spec.shape} else spec.unit,
        )
        for spec in specs
    )


def _unit_of(unit: str, D: int) -> str:
    """Return the unit of vectors of D: "m/s", or "m/s (heading: rad/s)"."""
    return unit if D == 2 else f"{unit} (heading: {unit.replace('m', 'rad')})"

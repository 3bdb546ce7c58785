"""FlowMP on its way to a bundle: three graphs, traced and tried at sizes that mean nothing."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from anchorflow_client.contract import OdeSpec, TensorSpec
from anchorflow_export.adapter import GraphTrial, PlannerParts, SampleTrial, TracedGraph
from anchorflow_export.planners.flowmp.graphs import (
    PRIOR_BASIS,
    Context,
    FlowModel,
    context_names,
    encode_inputs,
    encode_outputs,
    unit_of,
)
from anchorflow_export.planners.flowmp.scenes import dealt_means, random_scenes, stacked_inputs
from anchorflow_export.planners.specs import COMPONENTS, F32, TIMES
from anchorflow_export.tracing import trace_role
from anchorflow_service.bundle import Bundle
from anchorflow_service.bundle.manifest import (
    AnswerEntry,
    CostMapEntry,
    OdeEntry,
    SplineEntry,
    TimeEntry,
)
from anchorflow_service.bundle.samplers import PriorEntry
from anchorflow_service.engine.samplers.flow_score import PRIOR_MEAN
from anchorflow_service.engine.samplers.ode import OdeSampler
from anchorflow_trajectory.ode.integrate import integrate_plainly
from anchorflow_trajectory.ode.methods import Method, method_named
from anchorflow_trajectory.scene import ROUTE_STATES
from anchorflow_trajectory.spline.basis import STEEPNESS

F64 = "float64"
ARRAYS = ("velocities", "accelerations", "scores", "clearance", "safe")


@dataclass(frozen=True)
class Trial:
    """Sizes that a graph is tried at; none is the one it was traced at."""

    B: int
    N: int
    K: int
    H: int
    W: int


TRIALS = (Trial(1, 1, 17, 64, 64), Trial(3, 5, 1, 16, 40), Trial(2, 64, 8, 97, 50))
SAMPLE_TRIAL = Trial(2, 9, 0, 64, 48)  # N enough for two slices


@dataclass(frozen=True, kw_only=True)
class FlowMPAdapter:
    """A flow model, and what a bundle of it answers where a request says nothing else.

    T: time steps of an anchor; D: components of a pose
    conditioning: with the grid that the model was trained on, and its limits
    sampler, finish: what a request that leaves them open gets
    """

    model: FlowModel
    T: int
    D: int
    conditioning: CostMapEntry
    sampler: OdeSpec
    finish: SplineEntry

    @property
    def parts(self) -> PlannerParts:
        """A planner with a cost map, an "ode" sampler and a "spline" finish."""
        D, limits = self.D, self.conditioning.limits
        return PlannerParts(
            inputs=(
                TensorSpec("cost_map", F32, ("B", "C", "H", "W"), "", (0.0, 1.0)),
                TensorSpec("map_geometry", F64, ("B", 3), "m, m, m/cell"),
                TensorSpec("x_curr", F64, ("B", 3 * D), unit_of("m, m/s, m/s^2", D)),
                TensorSpec("x_goal", F64, ("B", 2 * D), unit_of("m, m/s", D)),
                TensorSpec("w_style", F64, ("B", 3), "", (0.0, None)),
            ),
            conditioning=self.conditioning,
            sampler=OdeEntry(
                method=self.sampler.method,
                schedule=self.sampler.schedule,
                prior=PriorEntry(mean=ROUTE_STATES, basis=PRIOR_BASIS),
            ),
            finish=self.finish,
            time=TimeEntry(
                steps=self.T,
                first_s=0.0,
                dt=limits.horizon_s and limits.horizon_s / (self.T - 1),
            ),
            answer=AnswerEntry(components=COMPONENTS[:D], arrays=ARRAYS),
        )

    def trace(self) -> dict[str, TracedGraph]:
        """encode, modulate and field.

        Raises:
            ExportError: a graph cannot be traced, or holds only for the examples' sizes.
        """
        model = self.model
        inputs = encode_inputs(model, D=self.D, channels=self.conditioning.channels)
        encode = trace_role(model, "encode", inputs=inputs, outputs=encode_outputs(model))
        context = {spec.name: spec for spec in encode.outputs}

        modulate_inputs = (TIMES, *(context[name] for name in context_names(model, "modulate")))
        modulate = trace_role(model, "modulate", inputs=modulate_inputs, outputs=("modulation",))

        x_t, prior_mean = (
            TensorSpec(name, F32, ("B", "N", self.T, 3 * self.D + 1))
            for name in ("x_t", PRIOR_MEAN)
        )
        size = modulate.outputs[0].shape[-1]
        one_time = TensorSpec("modulation", F32, ("B", size))
        told = (context[name] for name in context_names(model, "field"))
        field_inputs = (x_t, prior_mean, one_time, *told)
        field_graph = trace_role(model, "field", inputs=field_inputs, outputs=("dx_t",))
        return {"encode": encode, "modulate": modulate, "field": field_graph}

    def graph_trials(self, bundle: Bundle) -> Iterator[GraphTrial]:
        """encode, modulate and field at several sizes, each fed from torch's own context."""
        for seed, trial in enumerate(TRIALS):
            yield from self._graph_trials(bundle, trial, seed)

    def _graph_trials(self, bundle: Bundle, trial: Trial, seed: int) -> Iterator[GraphTrial]:
        generator = torch.Generator().manual_seed(seed)
        scenes = random_scenes(bundle, trial.B, (trial.H, trial.W), seed=seed)
        inputs = stacked_inputs(bundle, scenes)
        context = self.model.encode(**inputs)
        yield GraphTrial(f"encode at {trial}", "encode", inputs, context)

        times = torch.rand(trial.K, generator=generator).sort().values
        modulation = self.model.modulate(times, context)
        told = {**context, "times": times}
        yield GraphTrial(f"modulate at {trial}", "modulate", told, {"modulation": modulation})

        noise = torch.randn(trial.N, context[PRIOR_BASIS].shape[1], generator=generator)
        mean, one_time = dealt_means(scenes, trial.N), modulation[:, -1]
        x_t = _initial_state(context, mean, noise)
        told = {**context, "x_t": x_t, PRIOR_MEAN: mean, "modulation": one_time}
        expected = {"dx_t": self.model.field(x_t, mean, one_time, context)}
        yield GraphTrial(f"field at {trial}", "field", told, expected)

    def sample_trials(self, bundle: Bundle) -> Iterator[SampleTrial]:
        """The card's sampler from the same noise: the plain torch loop and the engine's.

        Derivatives by own time are told in units in which they are about as large as positions.
        """
        units = np.append(np.repeat(STEEPNESS ** -np.arange(3.0), self.D), 1.0)
        trial, spec = SAMPLE_TRIAL, self.sampler
        flow = OdeSampler(bundle, threads=2)
        scenes = random_scenes(bundle, trial.B, (trial.H, trial.W), seed=len(TRIALS))
        context = self.model.encode(**stacked_inputs(bundle, scenes))
        for b, scene in enumerate(scenes):
            encoded = flow.encode(scene)
            noise = flow.draw_noise(encoded, num_samples=trial.N, seed=b)
            state = flow.integrate(encoded, flow.beginning(encoded, noise), spec)
            mean = dealt_means([scene], trial.N)
            own = {name: tensor[b : b + 1] for name, tensor in context.items()}
            expected = torch_sample(
                self.model,
                own,
                _initial_state(own, mean, torch.from_numpy(noise)),
                mean,
                schedule=spec.schedule,
                method=method_named(spec.method),
            )
            yield SampleTrial(
                f"sample of scene {b} at {trial}", state * units, expected[0].numpy() * units
            )


def torch_sample(
    model: FlowModel,
    context: Context,
    x: Tensor,
    prior_mean: Tensor,
    *,
    schedule: tuple[float, ...],
    method: Method,
) -> Tensor:
    """The sampler written the plain way, one modulation an evaluation: x_0 -> x_1 [B,N,T,S]."""

    def vector_field(x_t: Tensor, t: float) -> Tensor:
        modulation = model.modulate(torch.tensor([t]), context)[:, 0]
        return model.field(x_t, prior_mean, modulation, context)

    return integrate_plainly(vector_field, x, schedule=schedule, method=method)


def _initial_state(context: Context, mean: Tensor, noise: Tensor) -> Tensor:
    """x_0 [B,N,T,S] from prior means [B,N,T,S] and noise [N,R]."""
    return mean + (noise @ context[PRIOR_BASIS]).unflatten(-1, mean.shape[2:])

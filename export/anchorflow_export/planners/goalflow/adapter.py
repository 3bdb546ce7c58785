"""GoalFlow on its way to a bundle."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from anchorflow_client.contract import AnchorRequest, OdeSpec, TensorSpec, resolve_for_card
from anchorflow_client.sensors import ROUTE_POINTS, ROUTE_SPACING_M
from anchorflow_export.adapter import GraphTrial, PlannerParts, SampleTrial, TracedGraph
from anchorflow_export.planners.sensors import STATUS_UNIT
from anchorflow_export.planners.specs import COMPONENTS, F32, TIMES
from anchorflow_export.tracing import trace_role
from anchorflow_models.goalflow import BevLayout, GoalFlow
from anchorflow_models.goalflow.goalflow import POSE, STATE, SURROUNDINGS, Context
from anchorflow_service.bundle import Bundle
from anchorflow_service.bundle.graphs import open_graph
from anchorflow_service.bundle.manifest import (
    AnswerEntry,
    NoFinishEntry,
    OdeEntry,
    TensorsEntry,
    TimeEntry,
)
from anchorflow_service.bundle.samplers import PriorEntry
from anchorflow_service.engine.conditioning.tensors import TensorConditioning
from anchorflow_service.engine.samplers.ode import OdeSampler

ENCODE_OUTPUTS = (
    "prior_mean",
    "prior_basis",
    "goals",
    "goal_scores",
    "features",
    "context",
    "course",
    *SURROUNDINGS,
)
SIZES = ((1, 7, 3), (3, 5, 1))  # B, N and K of the trials; traced at others
SAMPLED = 9  # anchors, enough for two slices
SEED = 11
# m/s and m/s² of random cars.
FASTEST, SHARPEST_STATUS = 16.0, 2.0
WIDTHS = (6.0, 16.0)  # m, of random streets
BLOCK, TAKEN = 8, 0.05  # cells a side of what stands beside a random street; its share
TURNING = 0.01  # rad more from point to point of random routes, times a normal number

MOST_STATUS = 32.0
"""m/s, and m/s²: a faster car leaves the raster within four seconds, however it brakes."""
STATUS = TensorSpec("ego_status", F32, ("B", 8), STATUS_UNIT, (-MOST_STATUS, MOST_STATUS))
SIZE = TensorSpec("vehicle_size", F32, ("B", 2), "m", (0.3, 30.0))
ROUTE = TensorSpec("route", F32, ("B", ROUTE_POINTS, 2), "m", (-1e3, 1e3), optional=True)


def bev_spec(layout: BevLayout) -> TensorSpec:
    """What a caller sends of the scene."""
    shape = ("B", layout.channels, layout.rows, layout.columns)
    return TensorSpec("bev", "uint8", shape, extent=layout.extent)


@dataclass(frozen=True, kw_only=True)
class GoalFlowAdapter:
    """Four graphs; sampler: what a request that leaves it open gets."""

    model: GoalFlow
    sampler: OdeSpec

    @property
    def inputs(self) -> tuple[TensorSpec, ...]:
        """Of a request, and of encode."""
        return bev_spec(self.model.config.bev), STATUS, SIZE, ROUTE

    @property
    def parts(self) -> PlannerParts:
        """A planner with tensors, an "ode" sampler whose anchors are scored, and no finish."""
        config = self.model.config
        goals = TensorSpec("goals", F32, ("B", config.goals, 2), "m")
        scores = TensorSpec("goal_scores", F32, ("B", config.goals), "", (0.0, 1.0))
        return PlannerParts(
            inputs=self.inputs,
            conditioning=TensorsEntry(),
            sampler=OdeEntry(
                method=self.sampler.method,
                schedule=self.sampler.schedule,
                prior=PriorEntry(mean="prior_mean", basis="prior_basis"),
            ),
            finish=NoFinishEntry(),
            time=TimeEntry(steps=config.num_steps, first_s=config.dt, dt=config.dt),
            answer=AnswerEntry(components=COMPONENTS, arrays=("scores",), extras=(goals, scores)),
        )

    def trace(self) -> dict[str, TracedGraph]:
        """encode, modulate, field and score.

        Raises:
            ExportError: a graph cannot be traced, or holds only for the examples' sizes.
        """
        model = self.model
        encode = trace_role(model, "encode", inputs=self.inputs, outputs=ENCODE_OUTPUTS)
        context = {spec.name: spec for spec in encode.outputs}
        states = [
            TensorSpec(name, F32, ("B", "N", model.config.num_steps, STATE))
            for name in ("x_t", "prior_mean", "x_1")
        ]
        x_t, mean, x_1 = states
        told = {
            role: [context[name] for name in names]
            for role, names in {
                "modulate": model.context_for_modulate,
                "field": model.context_for_field,
                "score": model.context_for_score,
            }.items()
        }
        modulate = trace_role(
            model, "modulate", inputs=(TIMES, *told["modulate"]), outputs=("modulation",)
        )
        one_time = TensorSpec("modulation", F32, ("B", modulate.outputs[0].shape[-1]))
        return {
            "encode": encode,
            "modulate": modulate,
            "field": trace_role(
                model, "field", inputs=(x_t, mean, one_time, *told["field"]), outputs=("dx_t",)
            ),
            "score": trace_role(
                model, "score", inputs=(x_1, mean, *told["score"]), outputs=("scores",)
            ),
        }

    def graph_trials(self, bundle: Bundle) -> Iterator[GraphTrial]:
        """Every graph at several sizes, each fed from torch's own context."""
        for seed, (B, N, K) in enumerate(SIZES):
            inputs, size = self.random_inputs(B, seed=seed), f"B={B}, N={N}, K={K}"
            context = self._encoded(bundle, inputs)
            expected = {name: context[name] for name in ENCODE_OUTPUTS}
            yield GraphTrial(f"encode at {size}", "encode", inputs, expected)

            generator = torch.Generator().manual_seed(seed)
            times = torch.rand(K, generator=generator).sort().values
            modulation = self.model.modulate(times, context)
            told = {**context, "times": times}
            yield GraphTrial(f"modulate at {size}", "modulate", told, {"modulation": modulation})

            noise = torch.randn(N, context["prior_basis"].shape[1], generator=generator)
            mean, x_t = self._beginning(context, noise)
            told = {**context, "x_t": x_t, "x_1": x_t, "prior_mean": mean}
            told["modulation"] = modulation[:, 0]
            slope = self.model.field(x_t, mean, modulation[:, 0], context)
            yield GraphTrial(f"field at {size}", "field", told, {"dx_t": slope})
            scores = self.model.score(x_t, mean, context)
            yield GraphTrial(f"score at {size}", "score", told, {"scores": scores})

    def sample_trials(self, bundle: Bundle) -> Iterator[SampleTrial]:
        """The engine's trajectories and scores, beside torch's in a plain Euler loop."""
        inputs = self.random_inputs(2, seed=SEED)
        request = AnchorRequest.build(
            inputs={name: tensor.numpy() for name, tensor in inputs.items()},
            num_samples=SAMPLED,
            seed=SEED,
            sampler={"method": "euler", "schedule": {"uniform": 3}},
        )
        sampler = OdeSampler(bundle, threads=1)
        scenes = TensorConditioning(bundle.manifest).scenes(resolve_for_card(request, bundle.card))
        for b, scene in enumerate(scenes):
            encoded = sampler.encode(scene)
            noise = sampler.draw_noise(encoded, num_samples=SAMPLED, seed=SEED)
            drawn = sampler.sample(scene, encoded, threads=1)
            context = {name: torch.from_numpy(array) for name, array in encoded.items()}
            mean, x = self._beginning(context, torch.from_numpy(noise))
            for step in range(3):
                modulation = self.model.modulate(torch.tensor([step / 3]), context)[:, 0]
                x = x + self.model.field(x, mean, modulation, context) / 3
            yield SampleTrial(f"sample of scene {b}", drawn.states, x[0].numpy())
            scores = self.model.score(x, mean, context)[0].numpy()
            yield SampleTrial(f"scores of scene {b}", drawn.arrays["scores"], scores)
            yield self._order_trial(f"order of goals in scene {b}", context)

    def _encoded(self, bundle: Bundle, inputs: dict[str, Tensor]) -> Context:
        """What torch's encode gives where its goals stand in the order of the bundle's.

        Goals whose scores differ by a rounding may change places; `_order_trial` holds the order.
        """
        model, graph = self.model, open_graph(bundle, "encode")
        told = graph(**{name: tensor.numpy() for name, tensor in inputs.items()})
        order = torch.cdist(torch.from_numpy(told["goals"]), model.vocabulary[None]).argmin(-1)
        context, status = model.look(**inputs), inputs["ego_status"]
        ways = model.ways_to(model.vocabulary.expand(len(order), -1, -1), context["speed"])
        scores = model.goal_scores(model.rate(ways[..., :POSE], context))
        return context | model.arranged(ways, scores, order, status, context["course"])

    def _order_trial(self, what: str, context: Context) -> SampleTrial:
        """By how much a goal's score is above one that stands before it; nought in order."""
        config, goals, scores = self.model.config, context["goals"][0], context["goal_scores"][0]
        near = torch.cdist(goals, goals) < config.spacing
        wrong = [scores[config.picked :].diff()]
        for place in range(config.picked):
            # Of those that are left, the ones near to the fewest that are picked before.
            crowd = near[:place].sum(0)[place:]
            rivals = scores[place:][crowd == crowd.min()]
            wrong.append((rivals.max() - scores[place] + 2 * (crowd[0] - crowd.min()))[None])
        above = torch.cat(wrong).clamp(min=0.0).numpy()
        return SampleTrial(what, above, np.zeros_like(above))

    def _beginning(self, context: Context, noise: Tensor) -> tuple[Tensor, Tensor]:
        """Means [B,N,T,S], dealt out in turn, and x_0 from noise [N,R]."""
        components = context["prior_mean"]
        mean = components[:, torch.arange(len(noise)) % components.shape[1]]
        return mean, mean + (noise @ context["prior_basis"]).unflatten(-1, mean.shape[2:])

    def random_inputs(self, B: int, *, seed: int) -> dict[str, Tensor]:
        """Scenes of streets without traffic, of cars at some speed; who leaves the road or hits
        somebody scores nought, and so does all that a trained scorer has never seen the like of,
        whatever a graph makes of the rest.
        """
        generator = torch.Generator().manual_seed(seed)
        command = torch.eye(4)[torch.randint(0, 4, (B,), generator=generator)]
        speed = FASTEST * torch.rand(B, 1, generator=generator)
        pulls = SHARPEST_STATUS * (2 * torch.rand(B, 2, generator=generator) - 1)
        return {
            "bev": self._random_streets(B, generator),
            "ego_status": torch.cat([command, speed, torch.zeros(B, 1), pulls], -1),
            "vehicle_size": 2 + 3 * torch.rand(B, 2, generator=generator),
            "route": self._random_routes(B, generator),
        }

    def _random_streets(self, B: int, generator: torch.Generator) -> Tensor:
        """Straight ones of any width, with blocks beside them."""
        layout = self.model.config.bev
        right, left = layout.extent[2:]
        middles = left - (left - right) * (torch.arange(layout.columns) + 0.5) / layout.columns
        width = torch.empty(B, 1).uniform_(*WIDTHS, generator=generator)
        street = (middles.abs() < width / 2)[:, None, None]
        blocks = (B, layout.channels, layout.rows // BLOCK, layout.columns // BLOCK)
        taken = torch.rand(blocks, generator=generator) < TAKEN
        taken = taken.repeat_interleave(BLOCK, -1).repeat_interleave(BLOCK, -2)
        bev = 255 * (taken & ~street).to(torch.uint8)
        bev[:, layout.drivable] = 255 * street[:, 0].to(torch.uint8)
        return bev

    def _random_routes(self, B: int, generator: torch.Generator) -> Tensor:
        """Bends to either side; the last of several scenes is told no route."""
        turn = TURNING * torch.randn(B, 1, generator=generator) * torch.linspace(0, 1, ROUTE_POINTS)
        heading = turn.cumsum(-1)
        places = ROUTE_SPACING_M * torch.stack([heading.cos(), heading.sin()], -1).cumsum(1)
        told = torch.arange(B) < max(1, B - 1)
        return told[:, None, None] * places

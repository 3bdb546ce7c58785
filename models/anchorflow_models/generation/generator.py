"""Anchors from a network in torch, for one scene or several."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import count
from typing import Any, Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torchdiffeq import odeint

from anchorflow_client.contract import OdeSpec, WarmStart
from anchorflow_models.checks import check
from anchorflow_models.flowmp.config import L2Config
from anchorflow_models.generation.config import ADAPTIVE, AnchorTensors, GeneratorConfig
from anchorflow_models.generation.scenes import (
    DEFAULT_MOTION,
    DEFAULT_RESOLUTION,
    DEFAULT_ROBOT_RADIUS,
    Numbers,
    dealt_routes,
    prior_means,
    requested_scenes,
    stacked_inputs,
    warm_started,
)
from anchorflow_models.generation.steering import Barrier, Guidance, Steering
from anchorflow_models.layers.clearance_map import ClearanceMap
from anchorflow_models.torch_graphs import CPU, Role, TorchGraphs
from anchorflow_service.engine.samplers.flow import PRIOR_MEAN, flow_field
from anchorflow_trajectory.finish.refined import Refined
from anchorflow_trajectory.finish.refiner import Refiner
from anchorflow_trajectory.motion import MotionLimits
from anchorflow_trajectory.ode.integrate import VectorField, drawn, integrate
from anchorflow_trajectory.ode.schedule import Schedule, remaining
from anchorflow_trajectory.scene import COST_PENALTY, Scene

Array = NDArray[np.float32]
Context = dict[str, Tensor]
Seed = int | torch.Generator | None

OUTPUTS = {"encode": (), "modulate": ("modulation",), "field": ("dx_t",)}
PRIOR_BASIS = "prior_basis"
RESOLVED = 10  # units of the dtype's rounding below which no tolerance can be met


class FlowPlanner(Protocol):
    """The interface of a network that a generator draws from; `L2SafetyCFM` is one."""

    @property
    def config(self) -> L2Config: ...

    def encode(
        self,
        cost_map: Tensor,
        map_geometry: Tensor,
        clearance_field: Tensor,
        x_curr: Tensor,
        x_goal: Tensor,
        w_style: Tensor,
        limits: Tensor,
    ) -> Context: ...

    def modulate(self, times: Tensor, context: Context) -> Tensor: ...

    def field(
        self, x_t: Tensor, prior_mean: Tensor, modulation: Tensor, context: Context
    ) -> Tensor: ...


@dataclass(frozen=True, eq=False)
class TrajectoryGenerator:
    """Draws anchors from a network and finishes them, as the service does with a bundle.

    The model is used as it is: put it into evaluation mode, and on the device where it is to run.
    """

    model: FlowPlanner
    config: GeneratorConfig = field(default_factory=GeneratorConfig)

    def generate(
        self,
        cost_map: Numbers,
        x_curr: Numbers,
        x_goal: Numbers,
        w_style: Numbers | None = None,
        *,
        resolution: float = DEFAULT_RESOLUTION,
        origin: Numbers | None = None,
        robot_radius: float = DEFAULT_ROBOT_RADIUS,
        motion: MotionLimits = DEFAULT_MOTION,
        cost_penalty: float = COST_PENALTY,
        seed: Seed = None,
        warm_start: WarmStart | None = None,
        guidance: Guidance | None = None,
    ) -> AnchorTensors:
        """Return anchors [N, T, D] of one scene, in SI units and the cost map's frame.

        cost_map: [C, H, W] in [0, 1], occupancy first; missing channels are neutral
        x_curr: [3D] p, v, a; x_goal: [2D] p, v
        w_style: [3] safety, energy, smooth, scaled to sum to 1, or a style's name; by default
            balanced
        resolution: m/cell; origin: [2] m, outer corner of cell (0, 0), by default such that the
            map's centre is (0, 0); robot_radius: m
        motion: speed and acceleration to keep, and the horizon if durations are given
        cost_penalty: m of detour that one metre through soft cost 1 is worth
        seed: an int draws the noise that the service draws from it, a torch.Generator its own
        warm_start: a plan to start from instead of noise alone; the contract's
        guidance: a cost to keep low

        Raises:
            InvalidRequest: a field is not what the contract and the model take; the message names
                it, what was expected and what came, as a service's does.
            ValueError: there is more than one scene.
        """
        anchors = self.generate_batch(
            cost_map,
            x_curr,
            x_goal,
            w_style,
            resolution=resolution,
            origin=origin,
            robot_radius=robot_radius,
            motion=motion,
            cost_penalty=cost_penalty,
            seed=seed,
            warm_start=warm_start,
            guidance=guidance,
        )
        scenes = len(anchors.scores)
        check("B", scenes == 1, "one scene (generate_batch takes several)", scenes)
        return anchors.scene(0)

    def generate_batch(
        self,
        cost_map: Numbers,
        x_curr: Numbers,
        x_goal: Numbers,
        w_style: Numbers | None = None,
        *,
        resolution: float = DEFAULT_RESOLUTION,
        origin: Numbers | None = None,
        robot_radius: float = DEFAULT_ROBOT_RADIUS,
        motion: MotionLimits = DEFAULT_MOTION,
        cost_penalty: float = COST_PENALTY,
        seed: Seed = None,
        warm_start: WarmStart | None = None,
        guidance: Guidance | None = None,
    ) -> AnchorTensors:
        """Return anchors [B, N, T, D] of several scenes: `generate` with a B axis before arrays.

        An array without one is the same in every scene, and so is the noise. For maps of different
        places or resolutions, pass scenes to `sample`.
        """
        scenes = requested_scenes(
            cost_map,
            x_curr,
            x_goal,
            w_style,
            config=self.model.config,
            resolution=resolution,
            origin=origin,
            robot_radius=robot_radius,
            motion=motion,
            cost_penalty=cost_penalty,
        )
        return self.sample(scenes, seed=seed, warm_start=warm_start, guidance=guidance)

    def sample(
        self,
        scenes: Sequence[Scene],
        *,
        seed: Seed = None,
        warm_start: WarmStart | None = None,
        guidance: Guidance | None = None,
    ) -> AnchorTensors:
        """Return anchors [B, N, T, D] of scenes whose maps have one size and all channels."""
        states = self.sample_states(scenes, seed=seed, warm_start=warm_start, guidance=guidance)
        finished = [
            Refiner(scene, self.config.refine_steps).refine(
                state, dealt_routes(scene, len(state)), self.config
            )
            for state, scene in zip(states.cpu().numpy(), scenes, strict=True)
        ]
        return _stacked(finished, _place(self.model))

    def sample_states(
        self,
        scenes: Sequence[Scene],
        *,
        seed: Seed = None,
        warm_start: WarmStart | None = None,
        guidance: Guidance | None = None,
    ) -> Tensor:
        """Return states [B, N, T, 3D + 1] at t = 1, neither smoothed nor projected."""
        roles = {role: Role(self.model, role, outputs=names) for role, names in OUTPUTS.items()}
        place = _place(self.model)
        graphs = TorchGraphs(roles, place)
        inputs = stacked_inputs(scenes)
        context = graphs.run("encode", inputs)
        mean = prior_means(scenes, self.config.num_samples)
        noise = self._noise(context[PRIOR_BASIS].shape[1], seed)
        spread = np.stack([drawn(noise, basis) for basis in context[PRIOR_BASIS]])
        x, schedule = mean + spread.reshape(mean.shape), self.config.flow_times
        if warm_start is not None:
            x = warm_started(x, warm_start, scenes)
            schedule = remaining(schedule, warm_start.tau)
        steering = self._steering(inputs, context, guidance)
        flow = _Flow(graphs, context, mean, steering)
        if self.config.method == ADAPTIVE:
            states = flow.solved_adaptively(x, self.config, start=schedule[0])
        else:
            states = flow.solved(x, OdeSpec(self.config.method, schedule))
        return torch.from_numpy(states).to(place)

    def _noise(self, rank: int, seed: Seed) -> Array:
        """Draw [N, R], the same for all scenes."""
        size = self.config.num_samples, rank
        if isinstance(seed, torch.Generator):
            return torch.randn(1, *size, generator=seed, device=seed.device)[0].cpu().numpy()
        return np.random.Generator(np.random.PCG64(seed)).standard_normal(size, dtype=np.float32)

    def _steering(
        self, inputs: Mapping[str, Array], context: Mapping[str, Array], guidance: Guidance | None
    ) -> Steering | None:
        rate, margin, barrier = self.config.barrier_rate, self.config.safety_margin, None
        if rate is not None:
            told = {name: torch.from_numpy(array) for name, array in inputs.items()}
            clearance = ClearanceMap(told["clearance_field"], told["map_geometry"])
            ends = torch.stack([told["x_curr"][:, :2], told["x_goal"][:, :2]], 1)
            barrier = Barrier.of(clearance, margin=margin, rate=rate, ends=ends)
        if guidance is None and barrier is None:
            return None
        return Steering(torch.from_numpy(context[PRIOR_BASIS]), guidance, barrier)


@dataclass(frozen=True, eq=False)
class _Flow:
    """The flow of B scenes; mean: [B, N, T, S], the route that each anchor begins on."""

    graphs: TorchGraphs
    context: dict[str, Array]
    mean: Array
    steering: Steering | None

    def solved(self, x: Array, sampler: OdeSpec) -> Array:
        """Return the states at t = 1 from x [B, N, T, S] at the schedule's first time."""
        flow = flow_field(self.graphs, self.context, sampler)
        field: VectorField = flow.bound(self.mean)
        if self.steering is not None:
            field = self._steered(
                field, self.steering, flow.times, flow.method.stages, flow.schedule
            )
        return integrate(field, x, schedule=flow.schedule, method=flow.method)

    @staticmethod
    def _steered(
        field: VectorField, steering: Steering, times: Array, stages: int, schedule: Schedule
    ) -> VectorField:
        evaluations = count()

        def steered(x: Array, time_index: int, out: Array) -> None:
            field(x, time_index, out)
            step = next(evaluations) // stages
            stride, t = schedule[step + 1] - schedule[step], float(times[time_index])
            change = steering.steered(torch.from_numpy(out), torch.from_numpy(x), t, stride=stride)
            out[...] = change.numpy()

        return steered

    @torch.no_grad()
    def solved_adaptively(self, x: Array, config: GeneratorConfig, *, start: float) -> Array:
        """Return the states at t = 1 by `integrate_adaptive` from x at flow time `start`."""
        graph = self.graphs.bind("field", {**self.context, PRIOR_MEAN: self.mean})

        def velocity(t: Tensor, x_t: Tensor) -> Tensor:
            times = {**self.context, "times": t[None].numpy()}
            modulation = self.graphs.run("modulate", times)["modulation"][:, 0]
            slope = torch.empty_like(x_t)
            graph({"x_t": x_t.numpy(), "modulation": modulation}, outputs={"dx_t": slope.numpy()})
            if self.steering is None:
                return slope
            return self.steering.steered(slope, x_t, float(t), stride=None)

        x_0 = torch.from_numpy(x)
        return integrate_adaptive(
            velocity, x_0, start=start, rtol=config.rtol, atol=config.atol
        ).numpy()


def integrate_adaptive(
    vector_field: Any, x_0: Tensor, *, start: float, rtol: float, atol: float
) -> Tensor:
    """Return x at t = 1 by Dormand and Prince's method of orders 5 and 4 (torchdiffeq's dopri5).

    dx/dt = vector_field(t, x), t [] in [start, 1]; x: [B, N, ...]

    The hardest of the samples sets the steps, so that each of them meets the tolerance; a sample
    among others may differ from the same one alone by as much.

    Raises:
        ValueError: the tolerance is finer than x_0's dtype resolves.
    """
    least = RESOLVED * torch.finfo(x_0.dtype).eps
    check("rtol", rtol >= least, f"at least {least:.2g} for {x_0.dtype}", rtol)
    times = torch.tensor([start, 1.0], dtype=x_0.dtype, device=x_0.device)
    options = {"norm": _largest_norm}
    path = odeint(vector_field, x_0, times, rtol=rtol, atol=atol, method="dopri5", options=options)
    assert isinstance(path, Tensor)
    return path[-1]


def generate_trajectory_anchors(
    model: FlowPlanner,
    cost_map: Numbers,
    x_curr: Numbers,
    x_goal: Numbers,
    w_style: Numbers | None = None,
    num_samples: int = 64,
    *,
    config: GeneratorConfig | None = None,
    **options: Any,
) -> tuple[Tensor, Tensor, Tensor]:
    """Return trajectories, velocities and accelerations [B * N, T, D] in SI, scene after scene.

    cost_map: [C, H, W] in [0, 1]; x_curr: [3D] p, v, a; x_goal: [2D] p, v; w_style: [3] safety,
        energy, smooth; each with or without a B axis
    config: every setting but num_samples; `GeneratorConfig`
    options: resolution (0.1 m/cell), origin (m, [2]; the map's centre is (0, 0)), robot_radius
        (0.25 m), motion, seed, warm_start, guidance: of `TrajectoryGenerator.generate_batch`, which
        also returns which anchors are safe and how long each lasts

    Raises:
        InvalidRequest: a field is not that; the message names it.
    """
    settings = replace(config or GeneratorConfig(), num_samples=num_samples)
    anchors = TrajectoryGenerator(model, settings).generate_batch(
        cost_map, x_curr, x_goal, w_style, **options
    )
    states = anchors.trajectories, anchors.velocities, anchors.accelerations
    trajectories, velocities, accelerations = (field.flatten(0, 1) for field in states)
    return trajectories, velocities, accelerations


def _largest_norm(x: Tensor) -> Tensor:
    """Return the largest root mean square of a sample of [B, N, ...]."""
    return x.flatten(2).square().mean(-1).max().sqrt()


def _place(model: FlowPlanner) -> torch.device:
    tensors = model.state_dict().values() if isinstance(model, nn.Module) else ()
    return next((tensor.device for tensor in tensors), CPU)


def _stacked(scenes: Sequence[Refined], device: torch.device) -> AnchorTensors:
    def column(name: str) -> Tensor:
        arrays = np.stack([getattr(scene, name) for scene in scenes])
        kind = torch.bool if arrays.dtype == np.bool_ else torch.float32
        return torch.from_numpy(arrays).to(device, kind)

    return AnchorTensors(
        trajectories=column("positions"),
        velocities=column("velocities"),
        accelerations=column("accelerations"),
        scores=column("scores"),
        clearance=column("clearance"),
        safe=column("safe"),
        durations=column("duration"),
    )

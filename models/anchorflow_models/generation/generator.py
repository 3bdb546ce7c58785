"""Anchors from a model in torch, for one scene or several."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import torch
from torch import Tensor, nn

from anchorflow_client.contract import WarmStart
from anchorflow_models.generation.anchor_tensors import AnchorTensors
from anchorflow_models.generation.barrier import Barrier
from anchorflow_models.generation.checks import check
from anchorflow_models.generation.clearance_map import ClearanceMap
from anchorflow_models.generation.config import GeneratorConfig
from anchorflow_models.generation.flow import Context, FlowPlanner, SceneFlow
from anchorflow_models.generation.guidance import Guidance
from anchorflow_models.generation.scenes import (
    DEFAULT_MOTION,
    DEFAULT_RESOLUTION,
    DEFAULT_ROBOT_RADIUS,
    Numbers,
    dealt_routes,
    encode_inputs,
    prior_means,
    requested_scenes,
)
from anchorflow_models.generation.warm_start import noised
from anchorflow_trajectory.finish.refiner import Refined, Refiner
from anchorflow_trajectory.motion import MotionLimits
from anchorflow_trajectory.ode.schedule import remaining
from anchorflow_trajectory.scene import Scene

Seed = int | torch.Generator | None


@dataclass(frozen=True, eq=False)
class TrajectoryGenerator:
    """Draws anchors from a planner and finishes them, as the service does with a bundle.

    The model is used as it is: put it into evaluation mode, and on the device where it shall run.
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
        seed: Seed = None,
        warm_start: WarmStart | None = None,
        guidance: Guidance | None = None,
    ) -> AnchorTensors:
        """Anchors [N, T, D] of one scene; SI units, in the cost map's frame.

        cost_map: [C, H, W] in [0, 1], occupancy first; channels left out are neutral
        x_curr: [3D] p, v, a; x_goal: [2D] p, v
        w_style: [3] safety, energy, smooth, scaled to sum to 1, or a style's name; by default
            balanced
        resolution: m/cell; origin: [2] m, outer corner of cell (0, 0), by default such that the
            map's centre is (0, 0); robot_radius: m
        motion: speed and acceleration to keep, and the horizon where durations are given
        seed: an int draws the noise that the service draws from it, a torch.Generator its own
        warm_start: a plan to start from instead of noise alone; the contract's
        guidance: a cost that the anchors shall keep low

        Raises:
            InvalidRequest: a field is not what the contract and the model take, as a service would
                say it; the message names it, what was expected and what came.
            ValueError: there is more than one scene.
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
        )
        check("B", len(scenes) == 1, "one scene (generate_batch takes several)", len(scenes))
        return self.sample(scenes, seed=seed, warm_start=warm_start, guidance=guidance).scene(0)

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
        seed: Seed = None,
        warm_start: WarmStart | None = None,
        guidance: Guidance | None = None,
    ) -> AnchorTensors:
        """Anchors [B, N, T, D] of several scenes: `generate` with a B axis before each array.

        An array without one is the same in every scene, and so is the noise. Maps of different
        places or resolutions go to `sample`, which takes scenes.
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
        )
        return self.sample(scenes, seed=seed, warm_start=warm_start, guidance=guidance)

    @torch.no_grad()
    def sample(
        self,
        scenes: Sequence[Scene],
        *,
        seed: Seed = None,
        warm_start: WarmStart | None = None,
        guidance: Guidance | None = None,
    ) -> AnchorTensors:
        """Anchors [B, N, T, D] of scenes whose maps have one size and all the model's channels."""
        states = self.sample_states(scenes, seed=seed, warm_start=warm_start, guidance=guidance)
        per_scene = states.cpu().numpy()
        finished = [
            self._finish(state, scene) for state, scene in zip(per_scene, scenes, strict=True)
        ]
        return _stacked(finished, states.device)

    @torch.no_grad()
    def sample_states(
        self,
        scenes: Sequence[Scene],
        *,
        seed: Seed = None,
        warm_start: WarmStart | None = None,
        guidance: Guidance | None = None,
    ) -> Tensor:
        """States [B, N, T, 3D + 1] as the flow leaves them: neither smoothed nor projected."""
        device = _device(self.model)
        inputs = encode_inputs(scenes, device)
        mean = prior_means(scenes, self.config.num_samples, device)
        context = self.model.encode(**inputs)
        schedule = self.config.flow_times
        x = self.model.draw(self._noise(context, seed), mean, context)
        if warm_start is not None:
            x = noised(x, warm_start, scenes)
            schedule = remaining(schedule, warm_start.tau)
        flow = SceneFlow(self.model, context, mean, guidance, self._barrier(inputs))
        return flow.solve(x, self.config, schedule)

    def _noise(self, context: Context, seed: Seed) -> Tensor:
        """[1, N, R], the same for all scenes."""
        basis = context["prior_basis"]
        size = self.config.num_samples, basis.shape[1]
        if isinstance(seed, torch.Generator):
            return torch.randn(1, *size, generator=seed, device=seed.device).to(basis)
        drawn = np.random.Generator(np.random.PCG64(seed)).standard_normal(size, dtype=np.float32)
        return torch.from_numpy(drawn)[None].to(basis)

    def _barrier(self, inputs: Mapping[str, Tensor]) -> Barrier | None:
        rate, margin = self.config.barrier_rate, self.config.safety_margin
        if rate is None:
            return None
        clearance = ClearanceMap(inputs["clearance_field"], inputs["map_geometry"])
        ends = torch.stack([inputs["x_curr"][:, :2], inputs["x_goal"][:, :2]], 1)
        return Barrier.of(clearance, margin=margin, rate=rate, ends=ends)

    def _finish(self, state: np.ndarray, scene: Scene) -> Refined:
        route = dealt_routes(scene, len(state))
        return Refiner(scene, self.config.refine_steps).refine(state, route, self.config)


def _device(model: FlowPlanner) -> torch.device:
    tensors = model.state_dict().values() if isinstance(model, nn.Module) else ()
    return next((tensor.device for tensor in tensors), torch.device("cpu"))


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

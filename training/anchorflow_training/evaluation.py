"""The validation judge: sample anchors on held-out scenes, and say which could be driven.

It sees anchors as the service does before it repairs them: fitted by a spline that meets both ends,
not yet pushed out of obstacles. The sampler is cheap, so the numbers compare runs and steps of a
run; a bundle's own quality is measured after its export.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from anchorflow_models import L2Config, L2SafetyCFM
from anchorflow_training.batches import encode_inputs
from anchorflow_training.config import EvaluationConfig, JudgeConfig
from anchorflow_training.dataset import SceneDataset
from anchorflow_trajectory.clearance import GridField, path_clearance
from anchorflow_trajectory.spline import SplineBasis, spline_basis

FloatArray = NDArray[np.float32]
BoolArray = NDArray[np.bool_]

# Model, encode's inputs, noise [1, N, R] -> states [B, N, T, S] at t = 1.
Sampler = Callable[[L2SafetyCFM, Mapping[str, Tensor], Tensor], Tensor]

CHUNK = 16  # scenes sampled at a time
CHECK_STEP = 0.04  # m between the points at which a path's clearance is looked up
# As the service's `safe`: a bilinear field and a reader's rounding differ by less than this share.
FREE_SHARE_OF_CELL = 0.3
SPEED_TOLERANCE, ACCELERATION_TOLERANCE = 1.02, 1.05
REACHED = 0.1  # m from the goal


@dataclass(frozen=True)
class AnchorChecks:
    """What holds for each of N anchors, [N]."""

    free: BoolArray
    reached: BoolArray
    feasible: BoolArray

    @property
    def success(self) -> BoolArray:
        return self.free & self.reached & self.feasible


@dataclass(frozen=True)
class JudgedScene:
    """positions: [N, T, D] m; cost_map: [C, H, W]; map_geometry: [3]; x_curr: [3D]; x_goal: [2D]"""

    positions: FloatArray
    checks: AnchorChecks
    cost_map: FloatArray
    map_geometry: FloatArray
    x_curr: FloatArray
    x_goal: FloatArray


def judge(
    states: Sequence[FloatArray], clearance: GridField, *, x_goal: FloatArray, config: L2Config
) -> AnchorChecks:
    """Judge positions, velocities and accelerations [N, T, D] in SI and the map's frame."""
    position, velocity, acceleration = states
    room = path_clearance(clearance, position, max_step=CHECK_STEP)
    free = room >= FREE_SHARE_OF_CELL * clearance.resolution
    miss = np.linalg.norm(position[:, -1, :2] - x_goal[:2], axis=-1)
    feasible = _largest(velocity) <= SPEED_TOLERANCE * config.v_max
    feasible &= _largest(acceleration) <= ACCELERATION_TOLERANCE * config.a_max
    return AnchorChecks(free, miss <= REACHED, feasible)


@torch.no_grad()
def sample(model: L2SafetyCFM, inputs: Mapping[str, Tensor], noise: Tensor, steps: int) -> Tensor:
    """States [B, N, T, S] from noise [1, N, R] by equal midpoint steps."""
    context = model.encode(**inputs)
    x = model.draw(noise, context)
    times = torch.linspace(0, 1, 2 * steps + 1, device=x.device)
    modulation = model.modulate(times, context)
    for step in range(steps):
        start, middle = modulation[:, 2 * step], modulation[:, 2 * step + 1]
        halfway = x + model.field(x, start, context) / (2 * steps)
        x = x + model.field(halfway, middle, context) / steps
    return x


def flow_evaluator(dataset: SceneDataset, config: EvaluationConfig) -> Evaluator:
    """The judge of a flow, whose anchors are drawn by equal midpoint steps."""
    return Evaluator(dataset, config, partial(sample, steps=config.steps))


class Evaluator:
    """Judges models on scenes of one dataset, always the same ones with the same noise."""

    def __init__(self, dataset: SceneDataset, config: JudgeConfig, sampler: Sampler) -> None:
        self.dataset, self.config, self.sampler = dataset, config, sampler
        count = min(config.scenes, len(dataset))
        self.scenes = np.linspace(0, len(dataset) - 1, count).astype(np.int64)

    def judged(self, model: L2SafetyCFM) -> list[JudgedScene]:
        """Every scene with its sampled anchors and what they are worth."""
        config, device = model.config, model.prior.spread.device
        basis = spline_basis(
            config.num_steps,
            config.horizon_s,
            num_control_points=config.num_control_points,
            degree=config.degree,
        )
        generator = torch.Generator().manual_seed(0)
        noise = torch.randn(1, self.config.samples, model.prior.rank, generator=generator)
        result = []
        for start in range(0, len(self.scenes), CHUNK):
            batch = self.dataset.batch(self.scenes[start : start + CHUNK])
            inputs = {n: torch.from_numpy(v).to(device) for n, v in encode_inputs(batch).items()}
            states = self.sampler(model, inputs, noise.to(device)).cpu().numpy()
            for i, state in enumerate(states):
                scene = {name: array[i] for name, array in batch.items()}
                result.append(_judged_scene(state, scene, basis, config))
        return result


def scores(scenes: Sequence[JudgedScene]) -> dict[str, float]:
    """Shares of anchors that are free, reach the goal, keep the limits, and all three (success).

    any: share of scenes with a success; spread: m, how far anchors lie from their scene's mean
    """
    checks = [scene.checks for scene in scenes]
    names = ("success", "free", "reached", "feasible")
    shares = {n: float(np.mean([getattr(v, n).mean() for v in checks])) for n in names}
    some = float(np.mean([v.success.any() for v in checks]))
    spread = float(np.mean([_spread(scene.positions) for scene in scenes]))
    return {**shares, "any": some, "spread": spread}


def out_of_patience(evaluations: Sequence[Mapping[str, float]], patience: int) -> bool:
    """Whether the best success is `patience` evaluations old; never where patience is 0."""
    successes = [row["success"] for row in evaluations]
    since = len(successes) - 1 - successes.index(max(successes)) if successes else 0
    return 0 < patience <= since


def _judged_scene(
    state: FloatArray, scene: Mapping[str, FloatArray], basis: SplineBasis, config: L2Config
) -> JudgedScene:
    x_curr, x_goal, geometry = scene["x_curr"], scene["x_goal"], scene["map_geometry"]
    states = basis.states(basis.fit(state, x_curr, x_goal))
    clearance = GridField(scene["clearance"], float(geometry[2]), geometry[:2].astype(np.float64))
    checks = judge(states, clearance, x_goal=x_goal, config=config)
    return JudgedScene(states[0], checks, scene["cost_map"], geometry, x_curr, x_goal)


def _largest(vectors: FloatArray) -> FloatArray:
    """Greatest planar length along each anchor: [N, T, D] -> [N]."""
    return np.linalg.norm(vectors[..., :2], axis=-1).max(1)


def _spread(positions: FloatArray) -> float:
    return float(np.linalg.norm((positions - positions.mean(0))[..., :2], axis=-1).mean())

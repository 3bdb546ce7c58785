"""The validation judge: sample anchors on held-out scenes, and say which could be driven.

It sees anchors as the service does before it repairs them: fitted by a spline that meets both ends,
not yet pushed out of obstacles. The sampler is cheap, so the numbers compare runs and steps of a
run; a bundle's own quality is measured after its export.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from anchorflow_client.contract import uniform_schedule
from anchorflow_models import L2SafetyCFM
from anchorflow_training.batches import dealt_routes, encode_inputs, prior_means
from anchorflow_training.config import AnchorJudgeConfig, EvaluationConfig
from anchorflow_training.dataset import SceneDataset
from anchorflow_trajectory.cost.clearance import GridField
from anchorflow_trajectory.finish.certificate import verify
from anchorflow_trajectory.motion import MotionLimits
from anchorflow_trajectory.ode.integrate import integrate_plainly
from anchorflow_trajectory.ode.methods import MIDPOINT
from anchorflow_trajectory.spline.basis import Ends, SplineBasis

FloatArray = NDArray[np.float32]
States = tuple[FloatArray, FloatArray, FloatArray]
BoolArray = NDArray[np.bool_]

# Model, encode's inputs, noise [1, N, R], prior mean [B, N, T, S] -> [B, N, T, S] at t = 1.
Sampler = Callable[[L2SafetyCFM, Mapping[str, Tensor], Tensor, Tensor], Tensor]

CHUNK = 16  # scenes sampled at a time
REACHED = 0.1  # m from the goal


@dataclass(frozen=True)
class AnchorChecks:
    """What holds for each of N anchors, [N]; free and feasible as `verify` says it."""

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
    states: States, clearance: GridField, *, x_goal: FloatArray, limits: MotionLimits
) -> AnchorChecks:
    """Judge positions, velocities and accelerations [N, T, D] in SI and the map's frame."""
    found = verify(states, clearance, limits)
    miss = np.linalg.norm(states[0][:, -1, :2] - x_goal[:2], axis=-1)
    return AnchorChecks(found.free, miss <= REACHED, found.feasible)


@torch.no_grad()
def sample(
    model: L2SafetyCFM,
    inputs: Mapping[str, Tensor],
    noise: Tensor,
    prior_mean: Tensor,
    *,
    steps: int,
) -> Tensor:
    """States [B, N, T, S] from noise [1, N, R] by equal midpoint steps."""
    context = model.encode(**inputs)
    x = model.draw(noise, prior_mean, context)
    schedule = uniform_schedule(steps)

    def field(x_t: Tensor, t: float) -> Tensor:
        modulation = model.modulate(torch.tensor([t], device=x_t.device), context)[:, 0]
        return model.field(x_t, prior_mean, modulation, context)

    return integrate_plainly(field, x, schedule=schedule, method=MIDPOINT)


def flow_evaluator(dataset: SceneDataset, config: EvaluationConfig) -> Evaluator:
    """The judge of a flow, whose anchors are drawn by equal midpoint steps."""
    return Evaluator(dataset, config, partial(sample, steps=config.steps))


class Evaluator:
    """Judges models on scenes of one dataset, always the same ones with the same noise."""

    def __init__(self, dataset: SceneDataset, config: AnchorJudgeConfig, sampler: Sampler) -> None:
        self.dataset, self.config, self.sampler = dataset, config, sampler
        count = min(config.scenes, len(dataset))
        self.scenes = np.linspace(0, len(dataset) - 1, count).astype(np.int64)

    def judged(self, model: L2SafetyCFM) -> list[JudgedScene]:
        """Every scene with its sampled anchors and what they are worth."""
        basis, device = model.config.basis, model.prior.spread.device
        generator = torch.Generator().manual_seed(0)
        noise = torch.randn(1, self.config.samples, model.prior.rank, generator=generator)
        result = []
        for start in range(0, len(self.scenes), CHUNK):
            batch = self.dataset.batch(self.scenes[start : start + CHUNK])
            inputs = {n: torch.from_numpy(v).to(device) for n, v in encode_inputs(batch).items()}
            mean = prior_means(batch, dealt_routes(batch, self.config.samples))
            drawn = self.sampler(model, inputs, noise.to(device), torch.from_numpy(mean).to(device))
            states = drawn.cpu().numpy()
            for i, state in enumerate(states):
                scene = {name: array[i] for name, array in batch.items()}
                result.append(_judged_scene(state, scene, basis))
        return result


def scores(scenes: Sequence[JudgedScene]) -> dict[str, float]:
    """Shares of anchors that are free, reach the goal, keep the limits, and all three (success).

    any: share of scenes with a success; spread: m, mean distance of anchors from their scene's mean
    """
    checks = [scene.checks for scene in scenes]
    names = ("success", "free", "reached", "feasible")
    shares = {n: float(np.mean([getattr(v, n).mean() for v in checks])) for n in names}
    some = float(np.mean([v.success.any() for v in checks]))
    spread = float(np.mean([_spread(scene.positions) for scene in scenes]))
    return {**shares, "any": some, "spread": spread}


def _judged_scene(
    state: FloatArray, scene: Mapping[str, FloatArray], basis: SplineBasis
) -> JudgedScene:
    x_curr, x_goal, geometry = scene["x_curr"], scene["x_goal"], scene["map_geometry"]
    v_max, a_max, _, horizon_s = scene["limits"].tolist()
    limits = MotionLimits(v_max, a_max, horizon_s or None)
    duration = np.full(len(state), horizon_s) if horizon_s else np.exp(state[..., -1].mean(-1))
    states = basis.states(basis.fit(state[..., :-1], Ends(x_curr, x_goal), duration))
    clearance = GridField(scene["clearance"], float(geometry[2]), geometry[:2].astype(np.float64))
    checks = judge(states, clearance, x_goal=x_goal, limits=limits)
    return JudgedScene(states[0], checks, scene["cost_map"], geometry, x_curr, x_goal)


def _spread(positions: FloatArray) -> float:
    return float(np.linalg.norm((positions - positions.mean(0))[..., :2], axis=-1).mean())


LOG = logging.getLogger(__name__)

SIZE, DOTS_PER_INCH = 3.0, 100  # of a scene's panel
GOOD, BAD = "tab:green", "tab:red"


def sample_picture(scenes: Sequence[JudgedScene]) -> NDArray[np.uint8] | None:
    """Scenes side by side as [height, width, 3]; None, with a line in the log, without matplotlib.

    Anchors that succeed are green, the others red.
    """
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg

        from anchorflow_trajectory import drawing
    except ModuleNotFoundError:
        LOG.warning("no sample picture: matplotlib is not installed (pip install matplotlib)")
        return None
    figure, panels = drawing.sheet(len(scenes), columns=len(scenes), inches=SIZE)
    figure.set_dpi(DOTS_PER_INCH)
    canvas = FigureCanvasAgg(figure)
    for axes, scene in zip(panels, scenes, strict=True):
        x, y, resolution = scene.map_geometry
        drawing.draw_cells(axes, scene.cost_map[0], resolution=resolution, origin=(x, y))
        colours = np.where(scene.checks.success, GOOD, BAD)
        drawing.draw_paths(axes, scene.positions, colours, linewidths=0.8)
        drawing.draw_ends(
            axes, scene.x_curr, scene.x_goal, colours=("black", "black"), sizes=(4, 7)
        )
        drawing.hide_ticks(axes)
        axes.set_title(f"{scene.checks.success.mean():.0%}", fontsize=8)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()

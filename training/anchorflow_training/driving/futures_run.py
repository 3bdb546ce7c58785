"""Train the network that predicts the others on windows of driving logs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional as F

from anchorflow_client.sensors import KIND, OTHERS, OTHERS_TIMES_S
from anchorflow_driving.drivers import PLAN_TIMES
from anchorflow_driving.futures import MISSED_M, MOVING_M, recorded_futures
from anchorflow_driving.log import open_logs, read_log
from anchorflow_driving.sensors.others import others_seen
from anchorflow_driving.window import Scenes
from anchorflow_models.futures import FuturesConfig, FuturesNetwork
from anchorflow_training.batches import Batch, MirroredBatchConfig, batch_rng, batch_scenes
from anchorflow_training.config import HeldOutConfig, RunConfig
from anchorflow_training.driving.augmentation import mirror
from anchorflow_training.driving.driving_run import DrivingRun
from anchorflow_training.driving.goalflow_run import GoalFlowRun
from anchorflow_training.driving.log_cache import log_arrays
from anchorflow_training.driving.losses import likeness_loss
from anchorflow_training.driving.windows import DrivingWindows
from anchorflow_training.record import Row
from anchorflow_training.settings import other_default, setting

KEPT = ".futures-1"
"""Suffix of the file beside a log that holds the others of its windows and their futures."""
SPREAD = np.array([0.08, 0.08, 0.02, 0.15, 0.15, 0.05, 0.03, 0.0], np.float32)
"""Standard deviations of the noise on `others`, in its units; a recording is no simulation."""
SIGNS = np.array([1, -1, -1, 1, -1, 1, 1, 1], np.float32)


@dataclass(frozen=True)
class FuturesObjectiveConfig:
    """Weights of the loss, and how much the inputs are disturbed."""

    all_modes: float = setting(
        0.03, "Share of the loss that all modes have, beside the nearest.", ge=0, le=1
    )
    heading: float = setting(1.0, "Of a radian, beside a metre.", ge=0)
    likely: float = setting(0.5, "Of the probabilities.", ge=0)
    standing: float = setting(0.2, "Of those who do not move, beside those who do.", ge=0)
    noise: float = setting(1.0, "Of the noise on the others' pasts; 0: none.", ge=0)
    shortened: float = setting(0.2, "Share of the others whose past is cut short.", ge=0, le=1)


@dataclass(frozen=True)
class FuturesRunConfig(RunConfig):
    """A run that learns to predict the others from driving logs."""

    planner: ClassVar[str] = "futures"

    steps: int = other_default(RunConfig, "steps", 4000)
    warmup: int = other_default(RunConfig, "warmup", 100)
    batch: MirroredBatchConfig = field(default_factory=lambda: MirroredBatchConfig(scenes=16))
    evaluation: HeldOutConfig = field(default_factory=HeldOutConfig)
    model: FuturesConfig = field(default_factory=FuturesConfig)
    objective: FuturesObjectiveConfig = field(default_factory=FuturesObjectiveConfig)


class FuturesObjective(nn.Module):
    """The loss on a batch: the nearest mode learns poses, the probabilities which mode it was."""

    def __init__(self, model: FuturesNetwork, config: FuturesObjectiveConfig) -> None:
        super().__init__()
        self.model, self.config = model, config

    def draw(self, _scenes: int, _samples: int, _generator: torch.Generator) -> tuple[Tensor, ...]:
        """Return nothing: batches bring their noise."""
        return ()

    def forward(self, batch: Mapping[str, Tensor]) -> tuple[Tensor, dict[str, Tensor]]:
        """Return the loss and its terms.

        others, bev, ego_status: as the network; futures: [B, A, T, 3], NaN: not recorded
        """
        config, truth = self.config, batch["futures"]
        poses, logits = self.model(batch["others"], batch["bev"], batch["ego_status"])
        known = truth.isfinite().all(-1)
        counted = known.any(-1) & (batch["others"][:, :, -1, KIND] > 0)
        poses, logits, truth, known = (each[counted] for each in (poses, logits, truth, known))
        truth, share = truth.nan_to_num(0.0), known / known.sum(-1, keepdim=True)
        away = (poses[..., :2] - truth[:, None, :, :2]).square().sum(-1).add(1e-4).sqrt()
        distance = (away * share[:, None]).sum(-1)
        turned = 1 - (poses[..., 2] - truth[:, None, :, 2]).cos()
        losses = distance + config.heading * (turned * share[:, None]).sum(-1)
        nearest = F.one_hot(distance.argmin(-1), distance.shape[1]).to(losses.dtype)
        weights = (1 - config.all_modes) * nearest + config.all_modes / distance.shape[1]
        now = batch["others"][:, :, -1, :2][counted]
        farthest = ((truth[..., :2] - now[:, None]).square().sum(-1) * known).amax(-1)
        counts = torch.where(farthest > MOVING_M**2, 1.0, config.standing)
        counts = counts / counts.sum().clamp(min=1.0)
        way = (counts * (weights * losses).sum(-1)).sum()
        likely = (counts * likeness_loss(logits, distance.detach(), over=0.5)).sum()
        return way + config.likely * likely, {"way": way, "likely": likely}


class FuturesRun(DrivingRun):
    """Trains the network on the recorded futures of the others."""

    def __init__(self, config: FuturesRunConfig, windows: DrivingWindows, out: Path) -> None:
        super().__init__(config, windows, out, of=f"the windows of {windows.path}")
        found = [*log_arrays(open_logs(windows.path), KEPT, _recorded)]
        self.others, self.futures = (
            np.concatenate([each[name] for each in found]) for name in ("others", "futures")
        )

    @staticmethod
    def model_settings(data: DrivingWindows) -> Mapping[str, Any]:
        """Return the raster and times of the windows, and the shape of `others`."""
        settings = {"num_steps": len(PLAN_TIMES), "others": OTHERS, "times": len(OTHERS_TIMES_S)}
        return {**GoalFlowRun.model_settings(data), **settings}

    def begin(self, model: FuturesNetwork) -> None:
        """Leave the random weights."""

    def new_objective(self, model: FuturesNetwork) -> nn.Module:
        return FuturesObjective(model, self.config.objective)

    def batch(self, index: int) -> Batch:
        config, rng = self.config, batch_rng(self.config.batch, index)
        chosen = batch_scenes(self.count, config.batch, index)
        most = max(1, int((self.others[chosen, :, -1, KIND] > 0).sum(1).max()))
        others, futures = self.others[chosen, :most].copy(), self.futures[chosen, :most].copy()
        bev, status = self.windows.rasters(chosen), self.windows.status[chosen].astype(float)
        if config.batch.mirror and rng.random() < 0.5:
            for raster, numbers in zip(bev, status, strict=True):
                mirror(raster, numbers, np.zeros((1, 2), np.float64))
            others, futures = others * SIGNS, futures * SIGNS[:3]
        self._disturb(others, rng)
        return {
            "others": others,
            "bev": bev,
            "ego_status": status.astype(np.float32),
            "futures": futures,
        }

    def _disturb(self, others: NDArray[np.float32], rng: np.random.Generator) -> None:
        """Add noise to `others` [B, A, H, 8] and cut some pasts short, in place."""
        config, there = self.config.objective, others[..., KIND:] > 0
        noise = rng.standard_normal(others.shape, np.float32) * SPREAD * config.noise
        noise[..., 5:] = noise[..., -1:, 5:]  # a box keeps its size
        moves = np.hypot(others[..., 3], others[..., 4])[..., None] > 0
        noise[..., :5] *= moves  # a standing one keeps still
        others += noise * there
        times = others.shape[2]
        first = rng.integers(1, times, others.shape[:2]) * (
            rng.random(others.shape[:2]) < config.shortened
        )
        others[np.arange(times) < first[..., None]] = 0.0

    def judged(self, model: FuturesNetwork, window: int) -> Row:
        """Return the share of the moving others that some mode ends near, and minADE in m."""
        bev = self.windows.rasters([window])
        arrays = (self.others[[window]], bev, self.windows.status[[window]])
        poses, _ = model(*(torch.from_numpy(each).to(self.fabric.device) for each in arrays))
        truth, now = self.futures[window], self.others[window, :, -1]
        moved = np.linalg.norm(truth[:, -1, :2] - now[:, :2], axis=-1) > MOVING_M  # not of NaN
        moved &= np.isfinite(truth).all((1, 2))
        if not moved.any():
            return {"success": np.nan, "min_ade_m": np.nan}
        away = np.linalg.norm(
            poses[0].cpu().numpy()[moved, ..., :2] - truth[moved, None, :, :2], axis=-1
        )
        return {
            "success": float((away[..., -1].min(-1) <= MISSED_M).mean()),
            "min_ade_m": float(away.mean(-1).min(-1).mean()),
        }


def _recorded(log: Path) -> dict[str, NDArray[np.float32]]:
    """Return others [W, A, H, 8] and futures [W, A, T, 3] of a log's windows."""
    windows = [*Scenes(read_log(log))]
    others = [others_seen(window.view) for window in windows]
    futures = [recorded_futures(window).astype(np.float32) for window in windows]
    shapes = (OTHERS, len(OTHERS_TIMES_S), 8), (OTHERS, len(PLAN_TIMES), 3)
    return {
        name: np.array(rows, np.float32).reshape(len(windows), *shape)
        for name, rows, shape in zip(("others", "futures"), (others, futures), shapes, strict=True)
    }

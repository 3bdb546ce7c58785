"""Train GoalFlow on windows of driving logs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from anchorflow_driving.log import open_logs
from anchorflow_driving.recorded_sensors import kinds_of, read_sensors
from anchorflow_models.goalflow import GoalFlow, GoalFlowConfig
from anchorflow_models.goalflow.goalflow import POSE
from anchorflow_models.transfuser import TransfuserConfig
from anchorflow_training.batches import (
    Batch,
    SampledBatchConfig,
    batch_rng,
    batch_scenes,
    reflection,
)
from anchorflow_training.config import HeldOutConfig, RunConfig
from anchorflow_training.driving.anchors import clustered, pdms, read_goals
from anchorflow_training.driving.augmentation import (
    AugmentationConfig,
    draw,
    mirror,
    poses_on,
    retimed,
)
from anchorflow_training.driving.driving_run import SightRun, SightRunConfig
from anchorflow_training.driving.feature_windows import (
    FeatureWindows,
    has_features,
    open_features,
)
from anchorflow_training.driving.goalflow_objective import (
    GoalFlowObjective,
    GoalFlowObjectiveConfig,
    OutcomeObjective,
)
from anchorflow_training.driving.log_cache import PLAN_SETTINGS, check_horizon
from anchorflow_training.driving.proposals import proposals
from anchorflow_training.driving.sensor_windows import (
    SensorSizes,
    SensorWindows,
    open_sensor_windows,
    sensors_of,
)
from anchorflow_training.driving.windows import DrivingWindows, open_windows
from anchorflow_training.record import Row
from anchorflow_training.settings import ConfigError, check_fixed, other_default, setting

Windows = DrivingWindows | FeatureWindows

OF_SIGHT = ("resnet", "perception", "frozen_perception", "sensor_noise")
"""Settings that only a planner with sensors has a use for."""
RETIMED_SHARE = 1  # ends of re-timed targets to one of the record, in the vocabulary
TOP, NEAR_M, MOVING_M = 5, 3.0, 2.0
"""A success: the recorded end, if MOVING_M away, is within NEAR_M of one of the TOP goals."""


def open_goalflow(folder: Path) -> Windows:
    """Return the windows of a folder: of driving logs, or with rasters of one's own."""
    return open_features(folder) if has_features(folder) else open_windows(folder)


@dataclass(frozen=True)
class GoalFlowRunConfig(SightRunConfig):
    """A run that learns GoalFlow from driving logs."""

    planner: ClassVar[str] = "goalflow"
    begins_with: ClassVar = ("vocabulary", *SightRunConfig.begins_with)

    steps: int = other_default(RunConfig, "steps", 6000)
    warmup: int = other_default(RunConfig, "warmup", 200)
    batch: SampledBatchConfig = field(
        default_factory=lambda: SampledBatchConfig(scenes=32, samples=8)
    )
    evaluation: HeldOutConfig = field(default_factory=HeldOutConfig)
    model: GoalFlowConfig = field(default_factory=GoalFlowConfig)
    objective: GoalFlowObjectiveConfig = field(default_factory=GoalFlowObjectiveConfig)
    augmentation: AugmentationConfig = field(default_factory=AugmentationConfig)
    vocabulary: str | None = setting(
        None, "File of goals [K, 2] (.npy) or grid:X0,X1,Y0,Y1 (m) instead of clustered ones."
    )

    @property
    def sight(self) -> TransfuserConfig | None:
        return self.model.transfuser if self.model.sensors else None


class GoalFlowRun(SightRun):
    """Learns goals and flow, or the outcomes of what a trained network proposes."""

    def __init__(self, config: GoalFlowRunConfig, windows: Windows, out: Path) -> None:
        fixed = {"model": self.model_settings(windows), **self.other_settings(windows)}
        check_fixed(config, fixed, by="the windows", prefix="")
        self.learns_outcomes = config.objective.stage == "outcomes"
        scored = "the PDM score of the stage outcomes" if self.learns_outcomes else None
        if isinstance(windows, DrivingWindows):
            check_horizon(config.model.num_steps, whole=scored)
        elif scored:
            said = "expected flow, as the PDM score needs logs, got outcomes"
            raise ConfigError(f"objective.stage: {said}")
        if self.learns_outcomes != config.model.outcomes:
            raise ConfigError(
                f"model.outcomes: expected {str(self.learns_outcomes).lower()} in the stage "
                f"{config.objective.stage}, got {str(config.model.outcomes).lower()}"
            )
        if self.learns_outcomes and config.before is None:
            raise ConfigError("before: expected a checkpoint to begin outcomes with, got none")
        self.sensors = self._opened_sensors(config, windows)
        super().__init__(config, windows, out, of=f"the windows of {windows.path}")
        if self.learns_outcomes:
            asked = self._created()
            asked.load_state_dict(self.model.state_dict())
            self.proposals = proposals(open_logs(windows.path), asked.eval())

    def _opened_sensors(self, config: GoalFlowRunConfig, windows: Windows) -> SensorWindows | None:
        """Return what the sensors show in the windows, of a planner that sees."""
        if config.sight is None:
            for name in OF_SIGHT:
                if got := getattr(config, name):
                    raise ConfigError(f"{name}: expected none without model.sensors, got {got}")
            return None
        stage, moved = config.objective.stage, config.augmentation.moved
        if self.learns_outcomes:
            raise ConfigError(f"objective.stage: expected flow with model.sensors, got {stage}")
        if moved:
            said = "expected 0 with model.sensors, whose pictures cannot be moved"
            raise ConfigError(f"augmentation.moved: {said}, got {moved:g}")
        return open_sensor_windows(open_logs(windows.path), SensorSizes.of(config.sight))

    @property
    def data(self) -> dict[str, Any]:
        if self.sensors is None:
            return super().data
        return {**super().data, "sensors": kinds_of(map(read_sensors, self.sensors.logs))}

    @staticmethod
    def model_settings(data: Windows) -> Mapping[str, Any]:
        """The raster that windows hold, and the times of what was driven."""
        if isinstance(data, DrivingWindows):
            return {**PLAN_SETTINGS, "bev": data.layout}
        times = {"num_steps": len(data.times), "dt": float(data.times[0])}
        return {**times, "bev": data.layout}

    @staticmethod
    def other_settings(data: Windows) -> Mapping[str, Any]:
        """Features cannot be reflected, and none is known to turn with the car."""
        unmoved = {"mirror": 0.0, "moved": 0.0}
        return {} if isinstance(data, DrivingWindows) else {"augmentation": unmoved}

    def begin(self, model: GoalFlow) -> None:
        """The vocabulary, and how far poses stray from the way to their goal."""
        config = self.config
        rng = np.random.default_rng(config.batch.seed)
        windows, learnt = self.windows, slice(self.count)
        speed = windows.status[learnt, 4].astype(float)
        timed = retimed(speed, config.augmentation, windows.times, count=RETIMED_SHARE, rng=rng)
        timed = np.concatenate([windows.along[learnt, None].astype(float), timed], axis=1)
        courses = windows.course[learnt].astype(float)
        timed = timed[..., : config.model.num_steps]
        targets = np.stack([poses_on(c, s) for c, s in zip(courses, timed, strict=True)])
        ends = targets[:, :, -1, :2]
        if windows.goal is not None:
            ends = np.concatenate([windows.goal[learnt, None], ends[:, 1:]], axis=1)
        ends = ends.reshape(-1, 2)
        ends = np.concatenate([ends, ends * [1, -1]])
        count, file = config.model.goals, config.vocabulary
        goals = (
            read_goals(file, count)
            if file
            else clustered(ends, count=count, seed=config.batch.seed)
        )
        model.vocabulary.copy_(torch.from_numpy(goals))
        to = torch.from_numpy(targets.astype(np.float32))
        ways = model.ways_to(to[..., -1, :2], torch.from_numpy(speed.astype(np.float32)))
        strays = (to - ways[..., :3]).flatten(0, 1)
        strays = torch.cat([strays, strays * torch.tensor([1.0, -1.0, -1.0])])
        model.stray.copy_(strays.std(0).clamp(min=1e-3).maximum(model.stray / 10))
        self.load_sight(model)

    def begin_after(self, model: GoalFlow, weights: Mapping[str, Tensor]) -> None:
        """Those weights; a scorer of outcomes begins anew where the run before had none."""
        super().begin_after(model, {**model.state_dict(), **weights})

    def _new_model(self) -> GoalFlow:
        model = super()._new_model()
        if self.learns_outcomes:
            model.requires_grad_(False).outcomes.requires_grad_(True)
        return model

    def new_objective(self, model: GoalFlow) -> nn.Module:
        if self.learns_outcomes:
            return OutcomeObjective(model, forgotten=self.config.objective.forgotten)
        return GoalFlowObjective(model, self.config.objective)

    def batch(self, index: int) -> Batch:
        config = self.config
        chosen = batch_scenes(self.count, config.batch, index)
        rng = batch_rng(config.batch, index)
        if self.learns_outcomes:
            return self._proposed(chosen, rng)
        drawn = draw(
            self.windows, chosen, config.augmentation, samples=config.batch.samples, rng=rng
        )
        batch = {**vars(drawn), "targets": drawn.targets[:, :, : config.model.num_steps]}
        if self.sensors is not None:
            seen = self._asked(chosen)
            for picture in (array for array in seen.values() if array.ndim > 2):
                picture[drawn.mirrored] = picture[drawn.mirrored, ..., ::-1]
            self.spoil(seen, rng, luck=rng.random())
            batch |= seen | {"ego_status": drawn.status}
        return batch if self.windows.goal is None else {**batch, "goal": self.windows.goal[chosen]}

    def _asked(self, chosen: NDArray[np.integer]) -> Batch:
        """Return what `encode` takes in windows: [B, ...] by name."""
        windows = self.windows
        ego = {"ego_status": windows.status[chosen], "vehicle_size": windows.size[chosen]}
        if self.sensors is None:
            return {"bev": windows.rasters(chosen), **ego}
        return {**sensors_of(self.sensors.batch(chosen)), **ego}

    def _proposed(self, chosen: NDArray[np.int64], rng: np.random.Generator) -> Batch:
        """Windows and what was proposed in them, some left for right."""
        windows, asked = self.windows, self.proposals
        bev, status = windows.rasters(chosen), windows.status[chosen].astype(float)
        course, trajectories = windows.course[chosen], asked.trajectories[chosen]
        for i in np.flatnonzero(rng.random(len(chosen)) < self.config.augmentation.mirror):
            mirror(bev[i], status[i], course[i])
            trajectories[i] *= reflection(3)
        return {
            "bev": bev,
            "status": status.astype(np.float32),
            "size": windows.size[chosen],
            "trajectories": trajectories,
            "scores": asked.scores[chosen],
        }

    def judged(self, model: GoalFlow, window: int) -> Row:
        """Return the scores of goals and one-step trajectories; when outcomes are learnt, the PDM
        score of the proposal with the best score.
        """
        windows, device = self.windows, model.vocabulary.device
        arrays = self._asked(np.array([window]))
        seen = {name: torch.from_numpy(each).to(device) for name, each in arrays.items()}
        if self.learns_outcomes:
            plans = torch.from_numpy(self.proposals.trajectories[window])[None].to(device)
            states = nn.functional.pad(plans, (0, POSE))  # to no goal: none is missed
            scores = model.score(states, states, model.look(**seen))[0]
            worth = pdms(self.proposals.scores[window])
            return {"success": float(worth[int(scores.argmax())]), "best_pdms": float(worth.max())}
        context = model.encode(**seen)
        mean = context["prior_mean"]
        modulation = model.modulate(torch.zeros(1, device=device), context)[:, 0]
        x_1 = mean + model.field(mean, mean, modulation, context)
        scores = model.score(x_1, mean, context)[0]
        course, along = windows.course[window].astype(float), windows.along[window].astype(float)
        driven = poses_on(course, along[: model.config.num_steps])
        apart = _apart(x_1[0, ..., :2].cpu().numpy(), driven[:, :2]).mean(-1)
        end = driven[-1, :2] if windows.goal is None else windows.goal[window]
        goals = context["goals"][0, :TOP].cpu().numpy()
        near = bool((_apart(goals, end) < NEAR_M).any())
        return {
            "success": float(near) if along[-1] > MOVING_M else np.nan,
            "best_ade_m": float(apart.min()),
            "chosen_ade_m": float(apart[int(scores.argmax())]),
        }


def _apart(points: NDArray[Any], others: NDArray[Any]) -> NDArray[Any]:
    return np.linalg.norm(points - others, axis=-1)

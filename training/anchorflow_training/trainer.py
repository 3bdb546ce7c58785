"""Train a flow on a scene dataset: AdamW, warm-up and cosine, EMA, checkpoints, resume."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np
import torch
from anchorflow_models import L2Config, create_l2_safety_cfm
from anchorflow_models.flow_matching import LossWeights, flow_matching_loss, interpolate
from anchorflow_models.flowmp.frame import Frame
from torch import Tensor

from anchorflow_training.batches import BatchConfig, batches
from anchorflow_training.checkpoint import Checkpoint, load_checkpoint, save_checkpoint
from anchorflow_training.coupling import couple
from anchorflow_training.dataset import SceneDataset
from anchorflow_training.statistics import prior_covariance

Report = Callable[[int, dict[str, float]], None]


@dataclass(frozen=True)
class FlowMatchingConfig:
    """The objective: weights of the fields, and whether noise is paired with the nearest data."""

    weights: LossWeights = field(default_factory=LossWeights)
    optimal_transport: bool = True


@dataclass(frozen=True)
class TrainerConfig:
    """How long and how fast; the rate climbs over `warmup` steps, then falls as a cosine."""

    steps: int = 20_000
    learning_rate: float = 1e-3
    warmup: int = 500
    weight_decay: float = 0.01
    gradient_clip: float = 1.0
    ema_decay: float = 0.999
    checkpoint_every: int = 500
    report_every: int = 50
    bfloat16: bool = False
    batch: BatchConfig = field(default_factory=BatchConfig)
    flow: FlowMatchingConfig = field(default_factory=FlowMatchingConfig)
    model: L2Config = field(default_factory=L2Config)


class CFMTrainer:
    """Trains one model on one dataset; `fit` may be called again after any interruption."""

    def __init__(self, config: TrainerConfig, dataset: SceneDataset, out: Path) -> None:
        self.config, self.dataset, self.out = config, dataset, out
        self.step, self.curve = 0, []
        self.model = create_l2_safety_cfm(config.model)
        self.optimiser = torch.optim.AdamW(
            self.model.parameters(), config.learning_rate, weight_decay=config.weight_decay
        )
        if self.checkpoint_path.exists():
            self._resume(load_checkpoint(self.checkpoint_path))
        else:
            self.model.prior.set_covariance(prior_covariance(dataset, config.model))
            self.average = {k: v.clone() for k, v in self.model.state_dict().items()}

    @property
    def checkpoint_path(self) -> Path:
        return self.out / "checkpoint.pt"

    def fit(self, report: Report = lambda *_: None) -> None:
        """Train to `config.steps`, saving every `checkpoint_every` steps and at the end."""
        config, began, sums = self.config, time.perf_counter(), {}
        for batch in batches(self.dataset, config.batch, range(self.step, config.steps)):
            terms = self.train_step(batch)
            for name, value in terms.items():
                sums[name] = sums.get(name, 0.0) + value
            if self.step % config.report_every == 0:
                means = {name: value / config.report_every for name, value in sums.items()}
                means["seconds"] = time.perf_counter() - began
                self.curve.append({"step": self.step, **means})
                report(self.step, means)
                sums = {}
            if self.step % config.checkpoint_every == 0 or self.step == config.steps:
                self.save()

    def train_step(self, batch: dict[str, np.ndarray]) -> dict[str, float]:
        """One optimiser step; returns the loss and its terms."""
        config = self.config
        for group in self.optimiser.param_groups:
            group["lr"] = config.learning_rate * self._rate(self.step)
        generator = torch.Generator().manual_seed(config.batch.seed * 1_000_003 + self.step)
        with torch.autocast("cpu", torch.bfloat16, enabled=config.bfloat16):
            loss, terms = self.loss(batch, generator)
        self.optimiser.zero_grad(set_to_none=True)
        loss.backward()
        norm = torch.nn.utils.clip_grad_norm_(self.model.parameters(), config.gradient_clip)
        self.optimiser.step()
        self._average_weights()
        self.step += 1
        named = {name: float(value.detach()) for name, value in terms.items()}
        return {"loss": float(loss.detach()), **named, "gradient_norm": float(norm)}

    def loss(
        self, batch: dict[str, np.ndarray], generator: torch.Generator
    ) -> tuple[Tensor, dict[str, Tensor]]:
        """The flow-matching loss on a batch, in the model's normalised units."""
        model, inputs = self.model, {k: torch.from_numpy(v) for k, v in batch.items()}
        data = inputs.pop("states")
        context = model.encode(**inputs)
        frame = Frame.unpack(context["frame"], model.config.dim)
        scenes, samples = data.shape[:2]
        with torch.autocast("cpu", enabled=False), torch.no_grad():
            context |= {name: context[name].float() for name in ("prior_mean", "prior_basis", "frame")}
            noise = torch.randn(scenes, samples, model.prior.rank, generator=generator)
            x_0 = model.draw(noise, context)
            if self.config.flow.optimal_transport:
                x_0 = _paired(x_0, data, model.config.dim)
            t = torch.rand(scenes, samples, generator=generator)
            x_t, target = interpolate(x_0, data, t)
            state = model.prior.normalise(x_t, context["prior_mean"], frame)
            # The prior's mean cancels in a difference.
            target = model.prior.normalise(target, torch.zeros_like(context["prior_mean"]), frame)
        modulation = model.modulate(t, context)
        predicted = model.normalised_field(x_t, state, modulation, context)
        return flow_matching_loss(predicted.float(), target, self.config.flow.weights)

    def save(self) -> None:
        save_checkpoint(
            self.checkpoint_path,
            Checkpoint(
                step=self.step,
                config=asdict(self.config),
                data=dict(self.dataset.meta),
                model=self.model.state_dict(),
                average=self.average,
                optimiser=self.optimiser.state_dict(),
                curve=self.curve,
            ),
        )

    def _resume(self, checkpoint: Checkpoint) -> None:
        self.step, self.curve, self.average = checkpoint.step, checkpoint.curve, checkpoint.average
        self.model.load_state_dict(checkpoint.model)
        self.optimiser.load_state_dict(checkpoint.optimiser)

    def _rate(self, step: int) -> float:
        warmup, steps = self.config.warmup, self.config.steps
        if step < warmup:
            return (step + 1) / warmup
        done = (step - warmup) / max(1, steps - warmup)
        return 0.01 + 0.99 * 0.5 * (1 + math.cos(math.pi * done))

    @torch.no_grad()
    def _average_weights(self) -> None:
        decay = min(self.config.ema_decay, (1 + self.step) / (10 + self.step))
        for name, value in self.model.state_dict().items():
            self.average[name].lerp_(value, 1 - decay)


def _paired(x_0: Tensor, data: Tensor, dim: int) -> Tensor:
    """x_0 reordered within each scene to lie near the data."""
    points = (x[:, :, ::4, :dim].flatten(2).numpy() for x in (data, x_0))
    order = torch.from_numpy(couple(*points))
    return torch.take_along_dim(x_0, order[..., None, None], 1)

"""The training loop: AdamW, warm-up and its schedule, EMA, checkpoints, resume, evaluations.

A subclass says what one planner learns: its objective, its batches and its evaluation.
`anchorflow_training.planners` lists the subclass of each planner.
"""

from __future__ import annotations

import itertools
import math
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from contextlib import closing, nullcontext
from dataclasses import asdict
from pathlib import Path
from reprlib import repr as shortened
from typing import Any

import torch
from torch import Tensor, nn
from torch.optim.swa_utils import get_ema_multi_avg_fn

from anchorflow_models.registry import planner_named
from anchorflow_training.batches import Batch, prefetched
from anchorflow_training.checkpoint import (
    Checkpoint,
    CheckpointError,
    resumable,
    save_checkpoint,
    weights_before,
)
from anchorflow_training.config import RunConfig
from anchorflow_training.fabric import check_finite, make_fabric
from anchorflow_training.record import Picture, Row, RunningMean, RunRecord
from anchorflow_training.settings import ConfigError

Report = Callable[[int, Row], None]

SEED_STRIDE = 1_000_003  # between the noise of one seed and of the next
SEEDS = 2**64  # that torch has
MAX_RATE = 1e37
"""AdamW's first step is ten times as long, and must be a number of float32."""
FINAL_RATE = 0.01  # share of the peak learning rate at which the cosine ends


def rate_share(step: int, *, warmup: int, steps: int, schedule: str = "cosine") -> float:
    """Return the learning rate at a step as a share of its peak: linear warm-up, then the rest."""
    if step < warmup:
        return (step + 1) / warmup
    if schedule == "constant":
        return 1.0
    done = (step - warmup) / max(1, steps - warmup)
    return FINAL_RATE + (1 - FINAL_RATE) * 0.5 * (1 + math.cos(math.pi * min(1.0, done)))


@torch.no_grad()
def update_average(
    average: dict[str, Tensor], model: nn.Module, *, decay: float, step: int
) -> None:
    """Move the average towards the weights, in place; early in a run it follows faster."""
    moving = get_ema_multi_avg_fn(min(decay, (1 + step) / (10 + step)))
    for name, value in model.state_dict().items():
        if value.is_floating_point():
            moving([average[name]], [value], 0)
        else:
            average[name].copy_(value)


def without_progress(evaluations: Sequence[Mapping[str, float]], patience: int) -> bool:
    """Return whether the best success is `patience` evaluations old; never if patience is 0."""
    successes = [row["success"] for row in evaluations]
    since = len(successes) - 1 - successes.index(max(successes)) if successes else 0
    return 0 < patience <= since


class TrainingRun(ABC):
    """Train one model; `fit` may be called again after any interruption.

    curve: a row a report, the means of the loss and its terms since the last one
    evaluations: a row an evaluation, if scenes are held out

    Raises `ConfigError` if the configuration does not fit the dataset, the machine or the run
    `before`; `CheckpointError` if the folder's checkpoint is of another model, teacher or dataset.
    """

    def __init__(self, config: RunConfig, out: Path) -> None:
        if (rate := config.learning_rate) > MAX_RATE:
            raise ConfigError(f"learning_rate: expected at most {MAX_RATE:g}, got {rate:g}")
        for name in config.begins_with if config.before is not None else ():
            if value := getattr(config, name):
                raise ConfigError(
                    f"{name}: expected none beside before, whose run brings its own, got {value}"
                )
        self.run_config, self.out = config, out
        self.fabric = make_fabric(config)
        if config.threads:
            torch.set_num_threads(config.threads)
        self.fabric.launch()
        saved = resumable(self.checkpoint_path, config)
        self.model = self._new_model()
        if saved is not None:
            self.model.load_state_dict(saved.model)
        elif config.before is not None:
            self.begin_after(self.model, weights_before(config.before, config))
        else:
            self.begin(self.model)
        if config.compile:
            # Compiled in place and part by part, so that the weights keep their names.
            for part in self.called_parts(self.model):
                part.compile()
        self._optimiser = torch.optim.AdamW(
            self.model.parameters(), config.learning_rate, weight_decay=config.weight_decay
        )
        self.objective, self.optimiser = self.fabric.setup(
            self.new_objective(self.model), self._optimiser
        )
        self.step, self.curve, self.evaluations = 0, [], []
        self.average = {k: v.clone() for k, v in self.model.state_dict().items()}
        self.pending = RunningMean()
        if saved is not None:
            self._resume(saved)

    @staticmethod
    @abstractmethod
    def model_settings(data: Any) -> Mapping[str, Any]:
        """Return the settings of the model that the data require."""

    @staticmethod
    def other_settings(data: Any) -> Mapping[str, Any]:  # noqa: ARG004
        """Return further settings that the data require, by name."""
        return {}

    def called_parts(self, model: Any) -> Iterable[nn.Module]:
        """Return the parts of a model that are called, which can be compiled."""
        return model.children()

    @abstractmethod
    def begin(self, model: Any) -> None:
        """Initialise a model of random weights from the data, unless a run was `before`."""

    def begin_after(self, model: Any, weights: Mapping[str, Tensor]) -> None:
        """Initialise a model with the weights of the run `before`."""
        model.load_state_dict(weights)

    @abstractmethod
    def new_objective(self, model: Any) -> nn.Module:
        """Return the loss to train the model on: (batch, *draws) -> (loss, terms).

        Its draw(scenes, samples, generator) returns the draws, all that is random in the loss: on
        the CPU, so alike on every device.
        """

    @abstractmethod
    def batch(self, index: int) -> Batch:
        """Return the batch of a number, always the same."""

    def stream(self, indices: Iterable[int]) -> Generator[Batch]:
        """Return the batches of these numbers, prepared ahead."""
        return prefetched(self.batch, indices, threads=self.run_config.loaders)

    @property
    @abstractmethod
    def data(self) -> dict[str, Any]:
        """The description of the data in the checkpoint."""

    @property
    @abstractmethod
    def evaluates(self) -> bool:
        """Whether data are held out to evaluate the model on."""

    @abstractmethod
    def evaluate(self, model: Any) -> tuple[Row, Picture | None]:
        """Return the scores of the model on held-out data, with a `success`, and a picture."""

    @property
    def learnt_from(self) -> dict[str, Any]:
        """The description of the teacher in the checkpoint, if there is one."""
        return {}

    @property
    def checkpoint_path(self) -> Path:
        return self.out / "checkpoint.pt"

    @property
    def best_path(self) -> Path:
        """The checkpoint of the evaluation with the best success."""
        return self.out / "best.pt"

    @property
    def leads(self) -> bool:
        """Whether this is the process that writes and reports."""
        return self.fabric.is_global_zero

    @property
    def stopped(self) -> bool:
        """Whether the validation judge has ended the training early."""
        return without_progress(self.evaluations, self.run_config.evaluation.patience)

    def fit(self, report: Report = lambda *_: None) -> None:
        """Train to `config.steps` or until the judge sees no more progress.

        report: called in one process with the step and each new row of `curve` and `evaluations`

        Raises `DivergenceError` if the loss or its gradient, which is not followed, is not finite.
        """
        config = self.run_config
        before = self.curve[-1]["seconds"] if self.curve else 0.0
        began = time.perf_counter() - before
        record = self._open_record() if self.leads else None
        kept_open = closing(record) if record else nullcontext()
        with kept_open, closing(self.stream(self._indices())) as stream:
            while self.step < config.steps and not self.stopped:
                mark = time.perf_counter()
                terms = self.train_step(list(itertools.islice(stream, config.accumulate)))
                seconds = torch.tensor(time.perf_counter() - mark)
                self.pending.add({**terms, "step_seconds": seconds})
                last = self.step == config.steps
                if self.step % config.report_every == 0:
                    self._report(record, report, seconds=time.perf_counter() - began)
                if self.evaluates and (self.step % config.evaluation.every == 0 or last):
                    self._evaluate(record, report)
                if self.step % config.checkpoint_every == 0 or last or self.stopped:
                    self.save(self.checkpoint_path)

    def train_step(self, group: Sequence[Batch]) -> dict[str, Tensor]:
        """One optimiser step on `accumulate` batches; returns the loss, its terms and the norm."""
        config = self.run_config
        rate = config.learning_rate * rate_share(
            self.step, warmup=config.warmup, steps=config.steps, schedule=config.rate_schedule
        )
        for settings in self._optimiser.param_groups:
            settings["lr"] = rate
        self.optimiser.zero_grad(set_to_none=True)  # of a step that was interrupted, too
        sums: dict[str, Tensor] = {}
        for part, batch in enumerate(group):
            waiting = part + 1 < len(group)
            with self.fabric.no_backward_sync(self.objective, enabled=waiting):
                loss, terms = self._loss(batch, part)
                self.fabric.backward(loss / len(group))
            for name, value in {"loss": loss, **terms}.items():
                sums[name] = sums.get(name, 0.0) + value.detach() / len(group)
        norm = self.fabric.clip_gradients(
            self.objective,
            self.optimiser,
            max_norm=config.gradient_clip,
            error_if_nonfinite=False,
        )
        self._check_finite({**sums, "gradient_norm": torch.as_tensor(norm)})
        self.optimiser.step()
        update_average(self.average, self.model, decay=config.ema_decay, step=self.step)
        self.step += 1
        course = {"learning_rate": torch.tensor(rate, dtype=torch.float64)}
        return {**sums, "gradient_norm": torch.as_tensor(norm), **course}

    def _check_finite(self, terms: dict[str, Tensor]) -> None:
        if self.fabric.strategy.precision.state_dict():
            # The loss scaling of float16 skips a step whose gradient overflows, by itself.
            terms.pop("gradient_norm")
        check_finite(terms, step=self.step + 1, fabric=self.fabric, checkpoint=self.checkpoint_path)

    def save(self, path: Path) -> None:
        """Write the run as it stands; one process does."""
        if not self.leads:
            return
        checkpoint = Checkpoint(
            step=self.step,
            config=asdict(self.run_config),
            data=self.data,
            model=self.model.state_dict(),
            average=self.average,
            optimiser=self._optimiser.state_dict(),
            curve=self.curve,
            evaluations=self.evaluations,
            pending=self.pending.state(),
            scaler=self.fabric.strategy.precision.state_dict(),
            teacher=self.learnt_from,
            planner=self.run_config.planner,
        )
        save_checkpoint(path, checkpoint)

    def averaged_model(self) -> Any:
        """A model with the averaged weights, on the CPU or GPU that trains."""
        model = self._created()
        model.load_state_dict(self.average)
        return model.to(self.fabric.device).eval()

    def _loss(self, batch: Batch, part: int) -> tuple[Tensor, dict[str, Tensor]]:
        sizes = self.run_config.batch
        index = self._index(self.step * self.run_config.accumulate + part)
        generator = torch.Generator().manual_seed((sizes.seed * SEED_STRIDE + index) % SEEDS)
        draws = self.objective.module.draw(sizes.scenes, sizes.per_scene, generator)
        inputs = {name: torch.from_numpy(value) for name, value in batch.items()}
        device = self.fabric.device
        with torch.random.fork_rng([device] if device.type == "cuda" else []):
            # What layers draw by themselves, as dropout does, hangs on seed and batch as well.
            torch.manual_seed(int(torch.randint(2**62, (), generator=generator)))
            return self.objective(*self.fabric.to_device((inputs, *draws)))

    def _index(self, batch: int) -> int:
        """The number over all processes of this process's n-th batch."""
        return batch * self.fabric.world_size + self.fabric.global_rank

    def _indices(self) -> Sequence[int]:
        """The batches that this process still has to see."""
        per_step = self.run_config.accumulate
        first, end = self.step * per_step, self.run_config.steps * per_step
        return range(self._index(first), self._index(end), self.fabric.world_size)

    def _report(self, record: RunRecord | None, report: Report, *, seconds: float) -> None:
        means = self.pending.means()
        values = torch.tensor([*means.values()], dtype=torch.float64, device=self.fabric.device)
        shared = self.fabric.all_reduce(values, reduce_op="mean")
        row = dict(zip(means, torch.as_tensor(shared).tolist(), strict=True))
        config, processes = self.run_config, self.fabric.world_size
        samples = config.batch.scenes * config.batch.per_scene * config.accumulate * processes
        row["samples_per_s"] = samples / row.pop("step_seconds")
        row["seconds"] = seconds
        self.curve.append({"step": self.step, **row})
        self.pending = RunningMean()
        if record:
            record.report(self.step, row)
            report(self.step, row)

    def _evaluate(self, record: RunRecord | None, report: Report) -> None:
        row, picture = self.evaluate(self.averaged_model()) if record else ({}, None)
        row = self.fabric.broadcast(row)
        best = max((past["success"] for past in self.evaluations), default=-1.0)
        self.evaluations.append({"step": self.step, **row})
        if row["success"] > best:
            self.save(self.best_path)
        if record:
            record.evaluation(self.step, row, picture)
            report(self.step, row)

    def _new_model(self) -> Any:
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(self.run_config.batch.seed % SEEDS)
            return self._created()

    def _created(self) -> Any:
        """A network of the run's configuration."""
        return planner_named(self.run_config.planner).create(self.run_config.model)

    def _resume(self, saved: Checkpoint) -> None:
        if not saved.optimiser:
            raise CheckpointError(
                f"{self.checkpoint_path}: expected the checkpoint of a run, got weights alone; "
                "--before begins a run with them"
            )
        if saved.teacher != self.learnt_from:
            raise CheckpointError(
                f"{self.checkpoint_path}: expected the teacher {saved.teacher or None}, as it was "
                f"trained, got {self.learnt_from or None}; another folder begins a new run"
            )
        for name in sorted(saved.data.keys() | self.data.keys()):
            old, new = (data.get(name) for data in (saved.data, self.data))
            if old != new:
                raise CheckpointError(
                    f"{self.checkpoint_path}: {name} of the data: expected {shortened(old)}, as it "
                    f"was trained on, got {shortened(new)}; another folder begins a new run, and "
                    "--before gives it these weights"
                )
        self.step, self.curve, self.evaluations = saved.step, saved.curve, saved.evaluations
        self.average = {k: v.to(self.fabric.device) for k, v in saved.average.items()}
        self.pending = RunningMean(saved.pending)
        self._optimiser.load_state_dict(saved.optimiser)
        for settings in self._optimiser.param_groups:
            settings["weight_decay"] = self.run_config.weight_decay
        if saved.scaler:  # a run may go on in another precision
            self.fabric.strategy.precision.load_state_dict(saved.scaler)

    def _open_record(self) -> RunRecord:
        return RunRecord(
            self.out,
            step=self.step,
            curve=self.curve,
            evaluations=self.evaluations,
            tensorboard=self.run_config.tensorboard,
        )

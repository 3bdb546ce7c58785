"""Train a flow on a scene dataset: AdamW, warm-up and cosine, EMA, checkpoints, resume."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import asdict
from pathlib import Path

import torch
from torch import Tensor

from anchorflow_models import L2SafetyCFM, create_l2_safety_cfm
from anchorflow_training.average import update_average
from anchorflow_training.batches import Batch, batches
from anchorflow_training.checkpoint import Checkpoint, save_checkpoint
from anchorflow_training.config import FlowMatchingConfig, TrainerConfig
from anchorflow_training.curve import Row, RunningMean
from anchorflow_training.dataset import SceneDataset
from anchorflow_training.devices import make_fabric
from anchorflow_training.evaluation import Evaluator, out_of_patience, scores
from anchorflow_training.held_out import split
from anchorflow_training.learning_rate import rate_share
from anchorflow_training.objective import FlowObjective
from anchorflow_training.pictures import sample_picture
from anchorflow_training.record import RunRecord
from anchorflow_training.restore import resumable
from anchorflow_training.statistics import prior_covariance

__all__ = ["CFMTrainer", "FlowMatchingConfig", "Report", "TrainerConfig"]

Report = Callable[[int, Row], None]

SEED_STRIDE = 1_000_003  # between the noise of one seed and of the next


class CFMTrainer:
    """Trains one model on one dataset; `fit` may be called again after any interruption.

    curve: a row a report, the means of the loss and its terms since the last one
    evaluations: a row an evaluation, where scenes are held out

    Raises:
        ConfigError: the configuration does not fit the dataset or the machine.
        CheckpointError: the folder's checkpoint is of another model.
    """

    def __init__(self, config: TrainerConfig, dataset: SceneDataset, out: Path) -> None:
        self.config, self.out = config, out
        self.fabric = make_fabric(config)
        self.dataset, held_out = split(dataset, config)
        self.evaluator = Evaluator(held_out, config.evaluation) if held_out else None
        if config.threads:
            torch.set_num_threads(config.threads)
        self.fabric.launch()
        saved = resumable(self.checkpoint_path, config.model)
        self.model = self._new_model()
        if saved is None:
            covariance = prior_covariance(self.dataset, config.model, mirrored=config.batch.mirror)
            self.model.prior.set_covariance(covariance)
        else:
            self.model.load_state_dict(saved.model)
        if config.compile:
            # In place and part by part, so that the weights keep their names.
            for part in self.model.children():
                part.compile()
        self._optimiser = torch.optim.AdamW(
            self.model.parameters(), config.learning_rate, weight_decay=config.weight_decay
        )
        self.objective, self.optimiser = self.fabric.setup(
            FlowObjective(self.model, config.flow), self._optimiser
        )
        self.step, self.curve, self.evaluations = 0, [], []
        self.average = {k: v.clone() for k, v in self.model.state_dict().items()}
        self.pending = RunningMean()
        if saved is not None:
            self._resume(saved)

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
        return out_of_patience(self.evaluations, self.config.evaluation.patience)

    def fit(self, report: Report = lambda *_: None) -> None:
        """Train to `config.steps` or until the judge sees no more progress.

        report: called in one process with the step and each new row of `curve` and `evaluations`
        """
        config = self.config
        before = self.curve[-1]["seconds"] if self.curve else 0.0
        began = time.perf_counter() - before
        record = self._open_record() if self.leads else None
        with closing(batches(self.dataset, config.batch, self._indices())) as stream:
            while self.step < config.steps and not self.stopped:
                mark = time.perf_counter()
                terms = self.train_step(list(itertools.islice(stream, config.accumulate)))
                seconds = torch.tensor(time.perf_counter() - mark)
                self.pending.add({**terms, "step_seconds": seconds})
                last = self.step == config.steps
                if self.step % config.report_every == 0:
                    self._report(record, report, seconds=time.perf_counter() - began)
                if self.evaluator and (self.step % config.evaluation.every == 0 or last):
                    self._evaluate(self.evaluator, record, report)
                if self.step % config.checkpoint_every == 0 or last or self.stopped:
                    self.save(self.checkpoint_path)
        if record:
            record.close()

    def train_step(self, group: Sequence[Batch]) -> dict[str, Tensor]:
        """One optimiser step on `accumulate` batches; returns the loss, its terms and the norm."""
        config = self.config
        rate = config.learning_rate * rate_share(
            self.step, warmup=config.warmup, steps=config.steps
        )
        for settings in self._optimiser.param_groups:
            settings["lr"] = rate
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
        self.optimiser.step()
        self.optimiser.zero_grad(set_to_none=True)
        update_average(self.average, self.model, decay=config.ema_decay, step=self.step)
        self.step += 1
        course = {"learning_rate": torch.tensor(rate, dtype=torch.float64)}
        return {**sums, "gradient_norm": torch.as_tensor(norm), **course}

    def save(self, path: Path) -> None:
        """Write the run as it stands; one process does."""
        if not self.leads:
            return
        checkpoint = Checkpoint(
            step=self.step,
            config=asdict(self.config),
            data=dict(self.dataset.meta),
            model=self.model.state_dict(),
            average=self.average,
            optimiser=self._optimiser.state_dict(),
            curve=self.curve,
            evaluations=self.evaluations,
            pending=self.pending.state(),
            scaler=self.fabric.strategy.precision.state_dict(),
        )
        save_checkpoint(path, checkpoint)

    def averaged_model(self) -> L2SafetyCFM:
        """A model with the averaged weights, on the CPU or GPU that trains."""
        model = create_l2_safety_cfm(self.config.model)
        model.load_state_dict(self.average)
        return model.to(self.fabric.device).eval()

    def _loss(self, batch: Batch, part: int) -> tuple[Tensor, dict[str, Tensor]]:
        index = self._index(self.step * self.config.accumulate + part)
        generator = torch.Generator().manual_seed(self.config.batch.seed * SEED_STRIDE + index)
        noise, t = self.objective.module.draw(*batch["states"].shape[:2], generator)
        inputs = {name: torch.from_numpy(value) for name, value in batch.items()}
        return self.objective(*self.fabric.to_device((inputs, noise, t)))

    def _index(self, batch: int) -> int:
        """The number over all processes of this process's n-th batch."""
        return batch * self.fabric.world_size + self.fabric.global_rank

    def _indices(self) -> Sequence[int]:
        """The batches that this process still has to see."""
        per_step = self.config.accumulate
        first, end = self.step * per_step, self.config.steps * per_step
        return range(self._index(first), self._index(end), self.fabric.world_size)

    def _report(self, record: RunRecord | None, report: Report, *, seconds: float) -> None:
        means = self.pending.means()
        values = torch.tensor([*means.values()], dtype=torch.float64, device=self.fabric.device)
        shared = self.fabric.all_reduce(values, reduce_op="mean")
        row = dict(zip(means, torch.as_tensor(shared).tolist(), strict=True))
        config, processes = self.config, self.fabric.world_size
        samples = config.batch.scenes * config.batch.samples * config.accumulate * processes
        row["samples_per_s"] = samples / row.pop("step_seconds")
        row["seconds"] = seconds
        self.curve.append({"step": self.step, **row})
        self.pending = RunningMean()
        if record:
            record.report(self.step, row)
            report(self.step, row)

    def _evaluate(self, evaluator: Evaluator, record: RunRecord | None, report: Report) -> None:
        row: Row = {}
        scenes = evaluator.judged(self.averaged_model()) if record else []
        row = self.fabric.broadcast(scores(scenes) if record else row)
        best = max((past["success"] for past in self.evaluations), default=-1.0)
        self.evaluations.append({"step": self.step, **row})
        if row["success"] > best:
            self.save(self.best_path)
        if record:
            shown = scenes[: self.config.evaluation.pictures]
            record.evaluation(self.step, row, sample_picture(shown) if shown else None)
            report(self.step, row)

    def _new_model(self) -> L2SafetyCFM:
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(self.config.batch.seed)
            return create_l2_safety_cfm(self.config.model)

    def _resume(self, saved: Checkpoint) -> None:
        self.step, self.curve, self.evaluations = saved.step, saved.curve, saved.evaluations
        self.average = {k: v.to(self.fabric.device) for k, v in saved.average.items()}
        self.pending = RunningMean(saved.pending)
        self._optimiser.load_state_dict(saved.optimiser)
        self.fabric.strategy.precision.load_state_dict(saved.scaler)

    def _open_record(self) -> RunRecord:
        return RunRecord(
            self.out,
            step=self.step,
            curve=self.curve,
            evaluations=self.evaluations,
            tensorboard=self.config.tensorboard,
        )

"""Train a student on what its teacher does."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
from torch import Tensor, nn

from anchorflow_client.contract import uniform_schedule
from anchorflow_models import L2SafetyCFM
from anchorflow_training.batches import Batch
from anchorflow_training.dataset import SceneDataset
from anchorflow_training.distillation.anchor_cost import AnchorCost
from anchorflow_training.distillation.objective import (
    ConsistencyObjective,
    DirectObjective,
    ReflowObjective,
    drawn,
    start_states,
)
from anchorflow_training.distillation.pairs import (
    DistillConfig,
    PairBank,
    PairBatches,
    Progress,
    make_pairs,
    open_pairs,
)
from anchorflow_training.distillation.teacher import Teacher, begin_as, check_student
from anchorflow_training.evaluation import Evaluator, JudgedScene
from anchorflow_training.record import Row
from anchorflow_training.run import Report
from anchorflow_training.settings import ConfigError
from anchorflow_training.trainer import CostMapRun
from anchorflow_trajectory.ode.methods import method_named


class Distiller(CostMapRun):
    """Teaches a student; `TrainingRun` says the rest.

    pairs: folder of the teacher's pairs, made there as far as they are missing

    Raises `ConfigError` if the student is not to answer what its teacher answers, or the pairs that
    are there are not this teacher's.
    """

    def __init__(
        self,
        config: DistillConfig,
        dataset: SceneDataset,
        out: Path,
        *,
        teacher: Teacher,
        pairs: Path,
    ) -> None:
        check_student(config.model, teacher.model.config)
        if 0 < config.teacher.scenes < config.batch.scenes:
            raise ConfigError(
                f"teacher.scenes: expected at least {config.batch.scenes}, as batch.scenes, "
                f"got {config.teacher.scenes}"
            )
        self.config, self.teacher, self._pairs = config, teacher, pairs
        self._held_out: SceneDataset | None = None
        super().__init__(config, dataset, out)
        self.teacher.model.to(self.fabric.device)

    def begin(self, model: L2SafetyCFM) -> None:
        begin_as(model, self.teacher.model)

    def begin_after(self, model: L2SafetyCFM, weights: Mapping[str, Tensor]) -> None:
        """Those weights, and the teacher's noise."""
        super().begin_after(model, weights)
        model.prior.load_state_dict(self.teacher.model.prior.state_dict())

    def new_objective(self, model: L2SafetyCFM) -> nn.Module:
        config = self.config
        schedule, weights = config.schedule, config.weights
        if config.method == "reflow":
            return ReflowObjective(
                model, schedule=schedule, at_schedule=config.at_schedule, weights=weights
            )
        if config.method == "consistency":
            return ConsistencyObjective(
                model,
                self.teacher.model,
                intervals=config.intervals,
                optimal_transport=self.teacher.optimal_transport,
                weights=weights,
            )
        cost = AnchorCost(config.model, margin=config.cost_margin) if config.cost_weight else None
        return DirectObjective(
            model, schedule=schedule, weights=weights, cost=cost, cost_weight=config.cost_weight
        )

    def new_evaluator(self, held_out: SceneDataset) -> Evaluator:
        self._held_out = held_out
        sampler = partial(drawn, schedule=self.config.schedule)
        return Evaluator(held_out, self.config.evaluation, sampler)

    def batch(self, index: int) -> Batch:
        return self._pair_batches.draw(index) if self.needs_pairs else super().batch(index)

    @cached_property
    def _pair_batches(self) -> PairBatches:
        starts = start_states(self.teacher.model).cpu().numpy()
        return PairBatches(self.dataset, self.bank, starts, self.config.batch)

    def scores(self, scenes: Sequence[JudgedScene]) -> Row:
        """As of a flow, beside its teacher's.

        distance: m, root mean square between anchors of student and teacher from the same noise
        """
        gaps = [
            np.square(student.positions - teacher.positions)[..., :2].sum(-1).mean()
            for student, teacher in zip(scenes, self._judged_teacher, strict=True)
        ]
        row = {"distance": float(np.sqrt(np.mean(gaps)))}
        own, teacher = super().scores(scenes), super().scores(self._judged_teacher)
        return {**own, **row, "teacher_success": teacher["success"]}

    @property
    def learnt_from(self) -> dict[str, Any]:
        return self.teacher.description

    @property
    def needs_pairs(self) -> bool:
        """Whether the method learns from the teacher's pairs."""
        return self.config.method != "consistency"

    @cached_property
    def bank(self) -> PairBank:
        """The teacher's pairs; whole after `prepare`."""
        return open_pairs(self._pairs, self.teacher, self.dataset, self.config.teacher)

    def prepare(self, progress: Progress = lambda *_: None) -> None:
        """Make the pairs that are missing, each process its share of them."""
        if not self.needs_pairs:
            return
        missing = self.bank.missing()
        if self.leads:
            self.bank.begin()
        # A later look would find fewer missing blocks and share them differently.
        self.fabric.barrier()
        make_pairs(
            self.bank,
            missing[self.fabric.global_rank :: self.fabric.world_size],
            teacher=self.teacher,
            dataset=self.dataset,
            config=self.config.teacher,
            progress=progress,
        )
        self.fabric.barrier()

    def fit(self, report: Report = lambda *_: None) -> None:
        self.prepare()
        super().fit(report)

    @cached_property
    def _judged_teacher(self) -> list[JudgedScene]:
        assert self._held_out is not None
        asked = self.config.teacher
        sampler = partial(
            drawn, schedule=uniform_schedule(asked.steps), method=method_named(asked.method)
        )
        return Evaluator(self._held_out, self.config.evaluation, sampler).judged(self.teacher.model)

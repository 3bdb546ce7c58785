"""A distillation learns, can be cut off anywhere, and changes nothing of its teacher."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, replace

import numpy as np
import pytest
import torch
from training_runs import DISTILLATION, copied_weights, resumed_and_whole

from anchorflow_training.checkpoint import (
    CheckpointError,
    load_checkpoint,
    provenance,
    restore_model,
)
from anchorflow_training.config import AnchorJudgeConfig, TrainerConfig
from anchorflow_training.dataset import SceneDataset
from anchorflow_training.distillation.distiller import Distiller
from anchorflow_training.distillation.pairs import DistillConfig
from anchorflow_training.distillation.teacher import Teacher, student_schedule
from anchorflow_training.settings import ConfigError, build
from anchorflow_training.trainer import CFMTrainer

Distil = Callable[..., Distiller]

every_method = pytest.mark.parametrize("method", ["reflow", "direct", "consistency"])


@every_method
def test_only_the_student_learns(method: str, distil: Distil, teacher: Teacher) -> None:
    before = copied_weights(teacher.model)
    run = distil(method=method, steps=2)
    run.fit()
    moved = [
        name for name, value in run.model.named_parameters() if not torch.equal(value, before[name])
    ]
    assert any(name.startswith("transformer.blocks") for name in moved)
    assert any(name.startswith("cost_map_encoder") for name in moved)
    torch.testing.assert_close(teacher.model.state_dict(), before, rtol=0, atol=0)
    assert all(parameter.grad is None for parameter in teacher.model.parameters())
    held = {id(p) for group in run.optimiser.param_groups for p in group["params"]}
    assert held == {id(p) for p in run.model.parameters()}


def test_the_student_comes_nearer_to_its_teacher(distil: Distil) -> None:
    run = distil(steps=30, learning_rate=1e-3)
    run.fit()
    losses = [row["loss"] for row in run.curve]
    assert np.mean(losses[-10:]) < 0.7 * np.mean(losses[:5])


@every_method
def test_a_run_that_was_cut_goes_on_as_if_it_had_not_been(method: str, distil: Distil) -> None:
    resumed, whole = resumed_and_whole(lambda name: distil(name, method=method))
    lines = (resumed.out / "curve.jsonl").read_text().splitlines()
    assert [json.loads(line)["step"] for line in lines] == [1, 2, 3, 4]
    losses = [[row["loss"] for row in run.curve] for run in (resumed, whole)]
    np.testing.assert_allclose(*losses, rtol=1e-4)
    torch.testing.assert_close(resumed.average, whole.average, rtol=1e-3, atol=1e-5)


def test_the_checkpoint_knows_its_teacher_and_its_steps(distil: Distil, teacher: Teacher) -> None:
    run = distil(steps=1, schedule=(0.0, 0.8, 1.0))
    run.fit()
    saved = load_checkpoint(run.checkpoint_path)
    assert saved.teacher == {"sha256": teacher.sha256, "step": 7}
    assert build(DistillConfig, saved.config, source="checkpoint") == run.config
    assert provenance(saved)["teacher"] == saved.teacher
    assert provenance(saved)["config"]["method"] == "direct"
    assert student_schedule(saved) == (0.0, 0.8, 1.0)
    assert student_schedule(replace(saved, teacher={})) is None
    # Other planners learn from teachers too, and step over nothing.
    assert student_schedule(replace(saved, config={"planner": "v2x_vlm"})) is None
    assert asdict(restore_model(saved).config) == asdict(run.config.model)


def test_a_run_goes_on_with_its_own_teacher_only(
    distil: Distil, teacher: Teacher, tiny_dataset: SceneDataset
) -> None:
    run = distil(method="consistency", steps=1)
    run.fit()
    other = replace(teacher, sha256="6" * 64)
    with pytest.raises(CheckpointError, match=r"checkpoint\.pt: expected the teacher .*555.*666"):
        Distiller(run.config, tiny_dataset, run.out, teacher=other, pairs=run.out)
    flow = TrainerConfig(model=run.config.model, batch=run.config.batch)
    with pytest.raises(CheckpointError, match=r"expected the teacher .* got None"):
        CFMTrainer(flow, tiny_dataset, run.out)


def test_a_student_that_samples_as_its_teacher_does_is_at_no_distance(distil: Distil) -> None:
    """A tiny learning rate keeps the teacher's weights; both take two Euler steps."""
    held_out = AnchorJudgeConfig(every=1, held_out=2, scenes=2, samples=3, pictures=0)
    same = replace(DISTILLATION.teacher, method="euler", steps=2)
    own = {"steps": 1, "learning_rate": 1e-12, "teacher": same, "evaluation": held_out}
    near = distil("two", schedule=(0.0, 0.5, 1.0), **own)
    far = distil("one", schedule=(0.0, 1.0), **own)
    for run in (near, far):
        run.fit()
    assert near.evaluations[0]["distance"] < 1e-4
    assert far.evaluations[0]["distance"] > 1e-2
    assert near.evaluations[0]["teacher_success"] == near.evaluations[0]["success"]


def test_only_scenes_that_are_trained_on_have_pairs(distil: Distil) -> None:
    held_out = replace(DISTILLATION.evaluation, held_out=2)
    assert distil(evaluation=held_out).bank.scenes == 4
    few = replace(DISTILLATION.teacher, scenes=3)
    assert distil(teacher=few).bank.scenes == 3


def test_consistency_makes_no_pairs(distil: Distil) -> None:
    run = distil(method="consistency", steps=1)
    run.fit()
    assert not run.bank.path.exists()


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"schedule": [0.2, 1.0]}, "schedule: expected its first time to be 0"),
        ({"schedule": [0.0, 0.9]}, "strictly rising to 1"),
        ({"method": "magic"}, "method: expected one of reflow, direct, consistency"),
        ({"cost_weight": -1}, "cost_weight: expected at least 0"),
        ({"at_schedule": 1.5}, "at_schedule: expected at most 1"),
        ({"teacher": {"method": "rk5"}}, "teacher.method: expected one of euler"),
    ],
)
def test_a_wrong_setting_is_named(values: dict[str, object], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        build(DistillConfig, values, source="distill.yaml")


def test_pairs_cannot_be_of_fewer_scenes_than_a_batch(distil: Distil) -> None:
    with pytest.raises(ConfigError, match=r"teacher\.scenes: expected at least 2"):
        distil(teacher=replace(DISTILLATION.teacher, scenes=1))

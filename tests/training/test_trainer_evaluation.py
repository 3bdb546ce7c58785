"""The validation judge: on what it is asked, what it leaves, and when it ends a run."""

from __future__ import annotations

import json
import logging
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from training_runs import QUICK, SMALL

from anchorflow_models import create_l2_safety_cfm
from anchorflow_training.checkpoint import load_checkpoint
from anchorflow_training.config import EvaluationConfig
from anchorflow_training.dataset import SceneDataset
from anchorflow_training.evaluation import (
    States,
    flow_evaluator,
    judge,
    sample_picture,
    scores,
)
from anchorflow_training.settings import ConfigError
from anchorflow_training.trainer import CFMTrainer, split
from anchorflow_trajectory.cost.clearance import GridField, clearance_field
from anchorflow_trajectory.motion import MotionLimits

LIMITS = MotionLimits(v_max=2.0, a_max=3.0)
CONFIG = replace(
    QUICK, steps=3, evaluation=EvaluationConfig(every=1, held_out=2, samples=3, steps=1, pictures=0)
)


def evaluated(dataset: SceneDataset, out: Path, **options: object) -> CFMTrainer:
    evaluation = replace(CONFIG.evaluation, **options)
    run = CFMTrainer(replace(CONFIG, evaluation=evaluation), dataset, out)
    run.fit()
    return run


def straight_lines(*, y: list[float], end: float = 2.0) -> States:
    """Positions, velocities and accelerations [N, T, 2] from x = -2 at 0.5 m/s, one line a y."""
    x = np.linspace(-2.0, end, SMALL.num_steps)
    position = np.stack([np.stack([x, np.full_like(x, line)], -1) for line in y])
    velocity = np.broadcast_to(np.array([0.5, 0.0], np.float32), position.shape)
    still = np.zeros_like(position, np.float32)
    return position.astype(np.float32), velocity.astype(np.float32), still


@pytest.fixture
def clearance() -> GridField:
    """A block of 0.8 m in the middle of an 8 m map, for a robot of 0.25 m."""
    occupied = np.zeros((80, 80), bool)
    occupied[36:44, 36:44] = True
    return GridField(clearance_field(occupied, 0.1, 0.25), 0.1, np.array([-4.0, -4.0]))


def test_an_anchor_is_free_beyond_the_robots_radius(clearance: GridField) -> None:
    # The block ends at 0.4 m: 0.65 m is where the robot touches it.
    states = straight_lines(y=[0.0, 0.55, 0.75, -0.75, 3.99])
    verdict = judge(states, clearance, x_goal=np.array([2, 0.75, 0, 0], np.float32), limits=LIMITS)
    assert verdict.free.tolist() == [False, False, True, True, False]
    assert verdict.reached.tolist() == [False, False, True, False, False]
    assert verdict.success.tolist() == [False, False, True, False, False]


def test_judged_anchors_meet_both_ends_and_are_always_the_same(tiny_dataset: SceneDataset) -> None:
    evaluator = flow_evaluator(tiny_dataset, EvaluationConfig(scenes=2, samples=3, steps=1))
    model = create_l2_safety_cfm(SMALL).eval()
    first, second = evaluator.judged(model), evaluator.judged(model)
    assert len(first) == 2
    for scene, again in zip(first, second, strict=True):
        assert scene.positions.shape == (3, SMALL.num_steps, 2)
        np.testing.assert_allclose(scene.positions[:, 0] - scene.x_curr[:2], 0, atol=1e-3)
        np.testing.assert_allclose(scene.positions[:, -1] - scene.x_goal[:2], 0, atol=1e-3)
        np.testing.assert_array_equal(scene.positions, again.positions)
    row = scores(first)
    assert row["reached"] == 1.0
    assert 0 <= row["success"] <= min(row["free"], row["feasible"], row["any"])


def test_anchors_are_judged_by_the_limits_and_the_horizon_of_their_own_scene(
    tiny_dataset: SceneDataset,
) -> None:
    """An untrained flow draws its prior: within the robot's limits, beyond those of a slow one."""
    model = create_l2_safety_cfm(SMALL).eval()
    model.prior.widen(0.01)
    config = EvaluationConfig(scenes=6, samples=4, steps=1)

    def feasible(v_max: float, horizon_s: float) -> list[float]:
        limits = np.array(tiny_dataset.arrays["limits"])
        limits[:, 0], limits[:, 3] = v_max, horizon_s
        arrays = {**tiny_dataset.arrays, "limits": limits}
        judged = flow_evaluator(replace(tiny_dataset, arrays=arrays), config).judged(model)
        return [scene.checks.feasible.mean() for scene in judged]

    assert min(feasible(2.0, 20.0)) == 1.0
    assert max(feasible(0.2, 20.0)) == 0.0  # 6 m in 20 s are faster
    assert max(feasible(2.0, 2.0)) == 0.0


def test_more_sampler_steps_are_another_answer(tiny_dataset: SceneDataset) -> None:
    torch.manual_seed(0)
    model = create_l2_safety_cfm(SMALL).eval()
    for parameter in model.parameters():  # an untrained field is zero
        torch.nn.init.normal_(parameter, std=0.05)
    one, four = (
        flow_evaluator(tiny_dataset, EvaluationConfig(scenes=1, samples=2, steps=steps)).judged(
            model
        )
        for steps in (1, 4)
    )
    assert not np.allclose(one[0].positions, four[0].positions, atol=1e-4)


def test_held_out_scenes_are_not_trained_on(tiny_dataset: SceneDataset) -> None:
    training, judged = split(tiny_dataset, CONFIG)
    assert judged is not None
    assert (len(training), len(judged)) == (4, 2)
    whole = tiny_dataset.arrays["x_curr"]
    np.testing.assert_array_equal(training.arrays["x_curr"], whole[:4])
    np.testing.assert_array_equal(judged.arrays["x_curr"], whole[4:])


def test_another_dataset_may_judge(tiny_dataset: SceneDataset) -> None:
    path = str(tiny_dataset.path)
    config = replace(CONFIG, evaluation=EvaluationConfig(dataset=path))
    training, judged = split(tiny_dataset, config)
    assert judged is not None
    assert (len(training), len(judged)) == (6, 6)
    both = replace(CONFIG, evaluation=EvaluationConfig(dataset=path, held_out=1))
    with pytest.raises(ConfigError, match="held_out or dataset, got both"):
        split(tiny_dataset, both)


def test_a_model_of_another_shape_than_the_dataset_is_refused(tiny_dataset: SceneDataset) -> None:
    config = replace(CONFIG, model=replace(SMALL, num_steps=32))
    with pytest.raises(ConfigError, match=r"model\.num_steps: expected 64.*got 32"):
        split(tiny_dataset, config)


def test_every_evaluation_is_written_and_reported(
    tiny_dataset: SceneDataset, tmp_path: Path
) -> None:
    run = evaluated(tiny_dataset, tmp_path, every=2)
    lines = (tmp_path / "evaluations.jsonl").read_text().splitlines()
    assert [json.loads(line)["step"] for line in lines] == [2, 3]  # and at the end
    assert [json.loads(line) for line in lines] == run.evaluations
    assert not (tmp_path / "samples").exists()  # no pictures
    assert not (tmp_path / "tensorboard").exists()


@pytest.mark.parametrize(("patience", "steps"), [(0, 6), (1, 3), (2, 4)])
def test_the_best_weights_are_kept_and_patience_stops_the_run_for_good(
    patience: int,
    steps: int,
    tiny_dataset: SceneDataset,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    course = iter([0.2, 0.6, 0.4, 0.6, 0.5, 0.1])
    monkeypatch.setattr("anchorflow_training.trainer.scores", lambda _: {"success": next(course)})
    evaluation = replace(CONFIG.evaluation, patience=patience)
    config = replace(CONFIG, steps=6, evaluation=evaluation)
    for _ in range(2):  # the second time it stops before it begins
        run = CFMTrainer(config, tiny_dataset, tmp_path)
        run.fit()
        assert load_checkpoint(run.checkpoint_path).step == steps
        assert load_checkpoint(run.best_path).step == 2
        assert run.stopped == (patience > 0)


def test_each_evaluation_leaves_a_picture_of_as_many_scenes_as_asked(
    tiny_dataset: SceneDataset, tmp_path: Path
) -> None:
    from matplotlib.image import imread

    evaluated(tiny_dataset, tmp_path, every=3, pictures=2)
    (file,) = (tmp_path / "samples").iterdir()
    assert file.name == "000003.png"
    height, width, _ = imread(file).shape
    assert width == 2 * height
    assert imread(file).std() > 0.01


def test_without_matplotlib_a_line_says_so(
    tiny_dataset: SceneDataset, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib.backends.backend_agg", None)
    scenes = flow_evaluator(tiny_dataset, EvaluationConfig(scenes=1, samples=1, steps=1)).judged(
        create_l2_safety_cfm(SMALL)
    )
    with caplog.at_level(logging.WARNING):
        assert sample_picture(scenes) is None
    assert "matplotlib is not installed" in caplog.text


def test_tensorboard_gets_every_scalar_and_the_picture(
    tiny_dataset: SceneDataset, tmp_path: Path
) -> None:
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    evaluation = replace(CONFIG.evaluation, pictures=1, every=2)
    config = replace(CONFIG, tensorboard=True, evaluation=evaluation)
    CFMTrainer(config, tiny_dataset, tmp_path).fit()
    events = EventAccumulator(str(tmp_path / "tensorboard")).Reload()

    fields = {"velocity_field", "acceleration_field", "jerk_field", "roughness", "duration_field"}
    course = {"loss", "gradient_norm", "learning_rate", "samples_per_s"}
    tags = set(events.Tags()["scalars"])
    assert {f"train/{name}" for name in fields | course} <= tags
    assert {f"validation/{name}" for name in ("success", "any", "free", "feasible")} <= tags
    assert [event.step for event in events.Scalars("train/loss")] == [1, 2, 3]
    assert [event.step for event in events.Images("anchors")] == [2, 3]

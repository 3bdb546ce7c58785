"""V2X-VLM's run: what it learns from, that it resumes, and what its options leave out."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from threading import Barrier

import numpy as np
import pytest
import torch
from small_v2x import small_sizes
from training_runs import (
    assert_same_weights,
    descended,
    resumed_and_whole,
)

from anchorflow_driving.cooperative.crossings import draw_crossing
from anchorflow_driving.cooperative.layout import write_recording
from anchorflow_models.v2x_vlm import V2XVLM, V2XConfig
from anchorflow_training.batches import BatchConfig
from anchorflow_training.checkpoint import CheckpointError, load_checkpoint, restore_model
from anchorflow_training.config import JudgeConfig
from anchorflow_training.settings import ConfigError
from anchorflow_training.v2x.dataset import PairDataset, make_pairs
from anchorflow_training.v2x.evaluation import judge
from anchorflow_training.v2x.run import LossConfig, V2XRun, V2XRunConfig


@pytest.fixture(scope="module", autouse=True)
def _small() -> Iterator[None]:
    with small_sizes():
        yield


@pytest.fixture(scope="module")
def pairs(tmp_path_factory: pytest.TempPathFactory) -> PairDataset:
    folder = tmp_path_factory.mktemp("v2x")
    drives = ((str(n), draw_crossing(n, size=(48, 32)).frames) for n in range(4))
    write_recording(folder / "recording", drives)
    return make_pairs(folder / "recording", folder / "pairs", image_size=32)


@pytest.fixture
def other_words(pairs: PairDataset) -> PairDataset:
    """The same pairs; their tokenizer is as large, and gives two letters each other's tokens."""
    tokenizer = json.loads(pairs.tokenizer)
    words = tokenizer["model"]["vocab"]
    words["e"], words["r"] = words["r"], words["e"]
    return replace(pairs, tokenizer=json.dumps(tokenizer).encode())


@pytest.fixture
def config(pairs: PairDataset) -> V2XRunConfig:
    return V2XRunConfig(
        steps=3,
        warmup=1,
        learning_rate=1e-3,
        report_every=1,
        checkpoint_every=1,
        tensorboard=False,
        batch=BatchConfig(scenes=3),
        evaluation=JudgeConfig(every=100, scenes=4),
        model=V2XConfig(**V2XRun.model_settings(pairs), positions=256, dropout=0.0),
    )


@pytest.fixture
def run_with(pairs: PairDataset, config: V2XRunConfig, tmp_path: Path) -> Callable[..., V2XRun]:
    """Makes a run of changed settings in a folder of the test's own."""
    return lambda name="run", **changed: V2XRun(replace(config, **changed), pairs, tmp_path / name)


def test_a_run_that_stops_goes_on_as_if_it_had_not(
    pairs: PairDataset, config: V2XRunConfig, run_with: Callable[..., V2XRun]
) -> None:
    model = replace(config.model, dropout=0.1)
    resumed, whole = resumed_and_whole(lambda name: run_with(name, model=model))
    assert_same_weights(resumed.model, whole.model)

    saved = load_checkpoint(whole.checkpoint_path)
    assert {"loss", "regression", "alignment"} <= {*saved.curve[0]}
    assert {"success", "l2_4.5s", "collision_mean"} <= {*saved.evaluations[-1]}
    model = restore_model(saved)
    assert isinstance(model, V2XVLM)
    assert model.tokenizer == pairs.tokenizer
    driven = np.asarray(pairs.arrays["waypoints"][whole.trained_on])
    np.testing.assert_allclose(model.mean.numpy(), driven.mean(0), rtol=1e-5)


def test_weights_that_know_another_tokenizer_are_refused(
    pairs: PairDataset, other_words: PairDataset, config: V2XRunConfig, tmp_path: Path
) -> None:
    assert other_words.vocabulary == pairs.vocabulary
    config = replace(config, steps=1)
    V2XRun(config, pairs, tmp_path / "one").fit()
    path = tmp_path / "one" / "checkpoint.pt"
    words = rf"{path}: expected the tokenizer of the pairs in .*, got another"
    with pytest.raises(CheckpointError, match=words):
        V2XRun(config, other_words, tmp_path / "one")
    for option in ("before", "teacher"):
        with pytest.raises(CheckpointError, match=words):
            V2XRun(replace(config, **{option: str(path)}), other_words, tmp_path / option)
        V2XRun(replace(config, **{option: str(path)}), pairs, tmp_path / option)


def test_published_weights_are_refused_beside_those_of_a_run_before(
    run_with: Callable[..., V2XRun],
) -> None:
    with pytest.raises(ConfigError, match=r"pretrained: expected none beside before.* florence"):
        run_with(before="runs/before.pt", pretrained="florence")


def test_held_out_pairs_are_judged_evenly_spread(
    pairs: PairDataset, config: V2XRunConfig, tmp_path: Path
) -> None:
    held = pairs.indices(held_out=True)
    for scenes, judged in ((2, held[[0, -1]]), (100, held)):
        evaluation = JudgeConfig(scenes=scenes)
        run = V2XRun(replace(config, evaluation=evaluation), pairs, tmp_path)
        row, _ = run.evaluate(run.model)
        plans, loss = run.plans(run.model, judged)
        assert row == {**judge(pairs, judged, plans), "loss": loss}


def test_several_loaders_read_the_same_batches(run_with: Callable[..., V2XRun]) -> None:
    alone, together = (run_with(loaders=count) for count in (1, 3))
    for one, other in zip(alone.stream(range(7)), together.stream(range(7)), strict=True):
        for name, array in one.items():
            np.testing.assert_array_equal(other[name], array)
    with pytest.MonkeyPatch.context() as patched:
        three = Barrier(3, timeout=20)  # which no two threads pass
        patched.setattr(together, "batch", lambda index: {"n": np.array([three.wait(), index])})
        assert [int(each["n"][1]) for each in together.stream(range(6))] == [*range(6)]


def test_it_learns_what_it_is_shown(run_with: Callable[..., V2XRun]) -> None:
    run = run_with()
    batch = {name: torch.from_numpy(each) for name, each in run.batch(0).items()}
    nothing = torch.zeros(3, dtype=torch.bool)
    first, *_, last = descended(run.objective.module, batch, [nothing])
    assert last["regression"] < 0.3 * first["regression"]


def test_the_tower_learns_where_the_nearest_other_is(run_with: Callable[..., V2XRun]) -> None:
    run = run_with(loss=LossConfig(alignment=0.0, location=1.0))
    batch = {name: torch.from_numpy(each) for name, each in run.batch(0).items()}
    _, terms = run.objective.module(batch, torch.zeros(3, dtype=torch.bool))
    assert {*terms} == {"regression", "location"}
    terms["location"].backward()
    tower = [each.grad for each in run.model.florence.model.vision_tower.parameters()]
    assert any(grad is not None and grad.abs().max() > 0 for grad in tower)
    assert all(each.grad is None for each in run.model.head.parameters())


def test_the_nearest_other_is_seen_from_the_ego(pairs: PairDataset) -> None:
    every = np.arange(len(pairs))
    nearest = pairs.nearest_others(every)
    assert 0 < nearest[:, 0].mean() < 1
    for index in every:
        frame = pairs.arrays["frame"][index]
        boxes, pose = pairs.boxes_of(frame), pairs.arrays["poses"][frame]
        away = [float(np.hypot(*(box[:2] - pose[:2]))) for box in boxes]
        there, *place = nearest[index]
        assert there == float(min(away, default=np.inf) < 60.0)
        if there:
            assert np.hypot(*place) == pytest.approx(min(away), abs=1e-3)


def test_a_withheld_picture_is_never_used(run_with: Callable[..., V2XRun]) -> None:
    withheld = run_with(roadside_dropout=1.0)
    batch = {name: torch.from_numpy(each) for name, each in withheld.batch(0).items()}
    changed = {**batch, "infrastructure_image": 255 - batch["infrastructure_image"]}
    objective = withheld.objective.module
    (drawn,) = objective.draw(3, 1, torch.Generator().manual_seed(0))
    assert drawn.all()
    losses = [objective(each, drawn)[0].item() for each in (batch, changed)]
    assert losses[0] == losses[1]
    shows = run_with("b", roadside_dropout=0.0).objective.module
    (shown,) = shows.draw(3, 1, torch.Generator().manual_seed(0))
    assert not shown.any()


def test_without_text_all_prompts_are_the_same(run_with: Callable[..., V2XRun]) -> None:
    tokens = run_with(text=False).batch(0)["tokens"]
    assert (tokens == tokens[0]).all()


@pytest.mark.parametrize("distil", ["distribution", "regression"])
def test_a_student_learns_from_its_teacher(
    pairs: PairDataset, config: V2XRunConfig, tmp_path: Path, distil: str
) -> None:
    V2XRun(replace(config, steps=1), pairs, tmp_path / "teacher").fit()
    loss = LossConfig(distil=distil, next_token=0.1)  # type: ignore[arg-type]
    teacher = str(tmp_path / "teacher" / "checkpoint.pt")
    student = V2XRun(replace(config, loss=loss, teacher=teacher), pairs, tmp_path / "student")
    before = {name: each.clone() for name, each in student._teacher.state_dict().items()}  # type: ignore[union-attr]
    student.fit()
    assert {"distillation", "next_token"} <= {*student.curve[0]}
    assert student.curve[0]["distillation"] > 0
    after = student._teacher.state_dict()  # type: ignore[union-attr]
    assert all(torch.equal(before[name], after[name]) for name in before)
    digest = hashlib.sha256(Path(teacher).read_bytes()).hexdigest()
    assert load_checkpoint(student.checkpoint_path).teacher == {"sha256": digest, "step": 1}
    with pytest.raises(CheckpointError, match="expected the teacher"):
        V2XRun(replace(config, loss=loss), pairs, tmp_path / "student")
    V2XRun(replace(config, steps=2), pairs, tmp_path / "teacher").fit()
    with pytest.raises(CheckpointError, match=f"expected the teacher .*{digest}"):
        V2XRun(student.config, pairs, tmp_path / "student")


def test_a_model_of_another_shape_than_the_pairs_is_refused(
    config: V2XRunConfig, run_with: Callable[..., V2XRun]
) -> None:
    model = replace(config.model, image_size=64)
    with pytest.raises(ConfigError, match=r"model\.image_size: expected 32, as the pairs have"):
        run_with(model=model)
    batch = replace(config.batch, scenes=1000)
    with pytest.raises(ConfigError, match=r"batch\.scenes: expected at most 15, the pairs"):
        run_with(batch=batch)

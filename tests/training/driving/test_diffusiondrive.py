"""DiffusionDriveV2 learns: its stages, and what a run begins with."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from drawn_bend import drawn as told
from driven_bend import bend
from driving_runs import DIFFUSIONDRIVE as CONFIG
from tiny_diffusiondrive import TINY, tiny_diffusiondrive
from torch import Tensor
from training_runs import (
    changed_since,
    copied_weights,
    descended,
    launched,
)

from anchorflow_driving.log import open_logs
from anchorflow_driving.pdm import PdmScorer
from anchorflow_driving.window import Scenes
from anchorflow_export.adapter import ExportChoices
from anchorflow_export.planners import adapter_of
from anchorflow_export.tracing import ExportError
from anchorflow_models.layers.geometry import standing_still
from anchorflow_training.checkpoint import load_checkpoint, restore_model, save_checkpoint
from anchorflow_training.driving import sensor_windows
from anchorflow_training.driving.diffusiondrive_objective import (
    DiffusionDriveObjective,
    DiffusionDriveObjectiveConfig,
    denoised,
)
from anchorflow_training.driving.diffusiondrive_run import (
    DiffusionDriveRun,
)
from anchorflow_training.driving.sensor_windows import SensorSizes, open_sensor_windows
from anchorflow_training.settings import ConfigError, config_text

B, T = 2, 8
MODEL = CONFIG.model
IMITATION = {"classes", "poses", "agents", "semantics", "occupancy"}
STAGES = ("imitation", "scorers", "together", "reinforcement")


def batch() -> dict[str, Tensor]:
    generator = torch.Generator().manual_seed(3)
    future = torch.cat([tiny_diffusiondrive().anchors[[1, 2]], torch.zeros(B, T, 1)], -1)
    return {
        "camera": torch.randint(0, 256, (B, 3, 16, 32), generator=generator).byte(),
        "lidar": torch.rand(B, 1, 16, 16, generator=generator),
        "ego_status": torch.randn(B, 8, generator=generator),
        "future": future + torch.tensor([0.4, 0.2, 0.1]),
        "is_example": torch.ones(B),
        "agents": 10 * torch.rand(B, 30, 5, generator=generator),
        "agent_velocity": torch.randn(B, 30, 2, generator=generator),
        "randomised_velocity": torch.randn(B, 30, 2, generator=generator),
        "agent_count": torch.tensor([3, 0]),
        "far_others": torch.tensor([44.0, 0.0, 0.0, 30.0, 30.0]).expand(B, 48, 5),
        "far_velocity": torch.randn(B, 48, 2, generator=generator),
        "far_count": torch.tensor([1, 0]),
        "semantics": torch.randint(0, TINY.classes, (B, 8, 16), generator=generator),
        "occupancy": (torch.rand(B, T, 4, 4, generator=generator) < 0.2).byte(),
        "window": torch.tensor([4, 9]),
        "signs": torch.ones(B, 3),
    }


def farther_is_better(windows: Tensor, trajectories: Tensor, speeds: Tensor | None) -> Tensor:
    """A judge that scores progress up to 60 m and fails ends far to the right."""
    assert speeds is not None
    assert speeds.isnan().all()
    told = torch.ones(*trajectories.shape[:2], 5)
    told[..., 2] = (trajectories[..., -1, 0] / 60).clamp(0, 1)
    told[..., 1] = (trajectories[..., -1, 1] > -15).float()
    assert windows.tolist() == [4, 9]
    return told


def objective(stage: Any, **config: Any) -> DiffusionDriveObjective:
    settings = DiffusionDriveObjectiveConfig(stage=stage, judged=12, group=3, **config)
    return DiffusionDriveObjective(tiny_diffusiondrive().train(), settings, farther_is_better)


def drawn_for(objective: DiffusionDriveObjective) -> tuple[Tensor, ...]:
    return objective.draw(B, 1, torch.Generator().manual_seed(0))


TERMS = {
    "imitation": IMITATION,
    "scorers": {"coarse", "fine", "rank"},
    "together": IMITATION | {"coarse", "fine", "rank"},
    "reinforcement": IMITATION | {"reinforcement"},
}
LEARNS = {
    "imitation": {"perception", "denoiser"},
    "scorers": {"coarse_scorer", "fine_scorer"},
    "together": {"perception", "denoiser", "coarse_scorer", "fine_scorer"},
    "reinforcement": {"perception", "denoiser"},
}


@pytest.mark.parametrize("stage", STAGES)
def test_each_stage_reaches_its_own_weights_and_no_others(stage: str) -> None:
    loss_of = objective(stage)
    loss, terms = loss_of(batch(), *drawn_for(loss_of))
    weighted = [getattr(loss_of.config, name) * terms[name] for name in TERMS[stage]]
    torch.testing.assert_close(loss, torch.stack(weighted).sum())
    loss.backward()
    reached: dict[bool, set[str]] = {True: set(), False: set()}
    for name, weight in loss_of.model.named_parameters():
        reached[weight.grad is not None].add(name.split(".")[0])
    assert reached[True] == LEARNS[stage]
    assert not reached[False] & LEARNS[stage]


@pytest.mark.parametrize("stage", ["imitation", "scorers"])
def test_steps_make_every_term_smaller(stage: str) -> None:
    loss_of, given = objective(stage, rank=1.0, occupancy=1.0), batch()
    first, *_, last = descended(loss_of, given, drawn_for(loss_of), steps=10)
    for name in TERMS[stage]:
        assert last[name] < first[name], name


def scored(loss_of: DiffusionDriveObjective, name: str) -> list[tuple[Any, ...]]:
    """Record inputs and outputs of a scorer from now on."""
    calls: list[tuple[Any, ...]] = []
    scorer = getattr(loss_of.model, name)
    scorer.register_forward_hook(lambda _module, given, made: calls.append((*given, made)))
    return calls


def test_the_coarse_scorers_best_are_judged_and_scored_finely() -> None:
    judged: list[Tensor] = []

    def judge(_windows: Tensor, candidates: Tensor, _speeds: Tensor | None) -> Tensor:
        judged.append(candidates)
        return torch.rand(*candidates.shape[:2], 5)

    settings = DiffusionDriveObjectiveConfig(stage="scorers", judged=12)
    loss_of = DiffusionDriveObjective(tiny_diffusiondrive(), settings, judge)
    coarse, fine = scored(loss_of, "coarse_scorer"), scored(loss_of, "fine_scorer")
    loss_of(batch(), *drawn_for(loss_of))
    candidates, _, made = coarse[0]
    best = made.scores.topk(TINY.keep).indices[..., None, None]
    wanted = torch.take_along_dim(candidates, best, 1)
    torch.testing.assert_close(judged[0][:, : TINY.keep], wanted)
    torch.testing.assert_close(fine[0][0], wanted)


def test_the_first_variant_is_what_was_denoised() -> None:
    loss_of = objective("scorers")
    coarse, draws = scored(loss_of, "coarse_scorer"), drawn_for(loss_of)
    loss_of(batch(), *draws)
    candidates, scene, _ = coarse[0]
    with torch.no_grad():
        plain = denoised(loss_of.model, scene, draws[0]).trajectories
        plain = loss_of.model.variants(plain, torch.zeros(*plain.shape[:2], 1, 2))
        plain = standing_still(plain)
    first, second = candidates[:, : -TINY.vocabulary].unflatten(1, (-1, 2)).unbind(2)
    torch.testing.assert_close(first, plain)
    assert not torch.allclose(second, plain, atol=0.1)


def test_which_candidate_would_be_driven_is_learnt_from_windows_as_recorded() -> None:
    model = tiny_diffusiondrive(replace(TINY, imitation=0.1)).train()
    settings = DiffusionDriveObjectiveConfig(stage="scorers", judged=12, speed=4.0)

    def judge(_windows: Tensor, candidates: Tensor, _speeds: Tensor | None) -> Tensor:
        return torch.rand(*candidates.shape[:2], 5)

    loss_of, given = DiffusionDriveObjective(model, settings, judge), batch()
    *draws, change = drawn_for(loss_of)
    change[:, 3] = torch.tensor([0.1, 0.9])  # the first begins at another speed
    first, *_, last = descended(loss_of, given, (*draws, change), steps=10)
    assert last["imitation"] < first["imitation"] - 0.05
    term = loss_of(given, *draws, change)[1]["imitation"]
    for window, changes in enumerate((False, True)):
        elsewhere = {**given, "future": given["future"].clone()}
        elsewhere["future"][window] += 9.0
        after = loss_of(elsewhere, *draws, change)[1]["imitation"]
        assert torch.allclose(after, term) is not changes


def test_reinforcement_drives_farther() -> None:
    loss_of = objective("reinforcement", classes=0, poses=0, agents=0, semantics=0)
    given, optimiser = batch(), torch.optim.AdamW(loss_of.model.denoiser.parameters(), 1e-2)
    before = loss_of(given, *drawn_for(loss_of))[1]["pdms"]
    for seed in range(20):
        draws = loss_of.draw(B, 1, torch.Generator().manual_seed(seed + 1))
        loss, _ = loss_of(given, *draws)
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
    assert loss_of(given, *drawn_for(loss_of))[1]["pdms"] > before + 0.1


def test_the_scorers_learn_other_speeds_and_imitation_does_not() -> None:
    asked = []

    def judge(_windows: Tensor, trajectories: Tensor, speeds: Tensor | None) -> Tensor:
        assert speeds is not None
        asked.append(speeds)
        return torch.rand(*trajectories.shape[:2], 5)

    settings = DiffusionDriveObjectiveConfig(stage="together", judged=12, speed=4.0)
    loss_of = DiffusionDriveObjective(tiny_diffusiondrive(), settings, judge)
    told: list[Tensor] = []
    loss_of.model.perception.register_forward_pre_hook(
        lambda _module, _, named: told.append(named["ego_status"]), with_kwargs=True
    )
    given = batch()
    given["ego_status"][:, 4] = torch.tensor([6.0, 3.0])
    given["ego_status"][:, 7] = 1.8
    *draws, change = drawn_for(loss_of)
    change = torch.tensor([[0.5, 0.0, 0.0, 0.1], [0.5, 0.0, 0.0, 0.9]])
    _, terms = loss_of(given, *draws, change)
    # The first begins 2 m/s faster on the same curve; the second as it was.
    assert asked[0][0].item() == 8.0
    assert asked[0][1].isnan()
    expected = given["ego_status"].clone()
    expected[0, 4], expected[0, 7] = 8.0, 1.8 * (8 / 6) ** 2
    torch.testing.assert_close(told[0], expected)
    # The record of the first window does not fit that speed.
    elsewhere = given | {"future": given["future"] + torch.tensor([9.0, 0.0])[:, None, None]}
    torch.testing.assert_close(loss_of(elsewhere, *draws, change)[1]["poses"], terms["poses"])


def test_recorded_accelerations_are_told_roughly() -> None:
    loss_of, given = objective("imitation", acceleration=0.5), batch()
    status, speeds = loss_of._changed(given["ego_status"], torch.ones(B, 4))
    expected = given["ego_status"] + torch.tensor([0.0] * 6 + [0.5] * 2)
    torch.testing.assert_close(status, expected)
    assert speeds.isnan().all()


def test_how_others_move_is_learnt_where_sweeps_are_compared() -> None:
    config = replace(
        TINY, backbone=replace(TINY.backbone, lidar_before=True), encounters=TINY.footprint
    )
    settings = DiffusionDriveObjectiveConfig(stage="imitation")
    loss_of = DiffusionDriveObjective(tiny_diffusiondrive(config).train(), settings)
    sweeps = ("lidar_before", "lidar_randomised")
    given = batch() | {name: torch.rand(B, 1, 16, 16) for name in sweeps}
    given["agents"][..., 3:] = 30.0  # large enough to contain middles of the large cells
    loss, terms = loss_of(given, *drawn_for(loss_of))
    loss.backward()
    assert set(terms) == IMITATION | {"motion", "far"}
    motion = loss_of.model.perception.sweeps
    assert motion is not None
    learns = {n for n, p in motion.named_parameters() if p.grad is not None and p.grad.any()}
    assert {"more.weight", "match.weight", "key.weight", "there.0.weight"} <= learns
    far = loss_of.model.perception.far
    assert far is not None
    assert all(weight.grad is not None and weight.grad.any() for weight in far.parameters())
    given.pop("lidar_before")
    _, without = loss_of(given, *drawn_for(loss_of))
    assert without["motion"] != terms["motion"]  # of those that move as chance has it alone


def test_the_road_ahead_is_learnt_by_its_semantics_and_by_what_looks_at_it() -> None:
    settings = DiffusionDriveObjectiveConfig(stage="imitation")
    model = tiny_diffusiondrive(replace(TINY, ground_sight=True)).train()
    loss_of = DiffusionDriveObjective(model, settings)
    _, terms = loss_of(batch(), *drawn_for(loss_of))
    for name in ("semantics", "poses"):
        model.zero_grad()
        terms[name].backward(retain_graph=True)
        ground = model.perception.ground
        assert ground is not None
        silent = [n for n, p in ground.named_parameters() if p.grad is None or not p.grad.any()]
        assert silent == [], name


def test_the_winner_is_the_nearest_anchor() -> None:
    loss_of = objective("imitation")
    assert loss_of.nearest(batch()["future"]).tolist() == [1, 2]


def test_training_denoises_as_the_service_does() -> None:
    from anchorflow_models.torch_graphs import TorchGraphs
    from anchorflow_service.engine.samplers.truncated_diffusion import (
        Noise,
        TruncatedDiffusionSampler,
    )

    model, given = tiny_diffusiondrive(), batch()
    adapter = adapter_of("diffusiondrive", model, ExportChoices())
    names = {
        name: SimpleNamespace(input_names=role.inputs, output_names=role.outputs)
        for name, role in adapter.roles.items()
    }
    parts = adapter.parts
    manifest: Any = SimpleNamespace(
        **vars(parts),
        graphs=names,
        request=SimpleNamespace(inputs=parts.inputs),
        sampled_extras=parts.answer.extras,
    )
    sampler = TruncatedDiffusionSampler(manifest, TorchGraphs(adapter.roles), threads=1)
    own = {name: given[name][:1] for name in ("camera", "lidar", "ego_status")}
    count = TINY.anchors * TINY.groups
    start = torch.randn(count, T, 2)
    noise = Noise(start.numpy(), np.zeros((count, 1, 2), np.float32))
    with torch.no_grad():
        scene = model.perception(**own).scene
        wanted = denoised(model, scene, start[None]).trajectories[0]
        context = {name: each.numpy() for name, each in model.encode(**own).items()}
    served = sampler.denoised(context, noise, steps=TINY.steps, check=lambda: None)
    torch.testing.assert_close(
        torch.from_numpy(served["trajectories"][0]), wanted, atol=1e-4, rtol=0.0
    )


def test_candidates_begin_with_the_noise_of_the_models_start() -> None:
    apart = []
    for start in (0, 8, 200):
        model = tiny_diffusiondrive(replace(TINY, start=start))
        given, noise = batch(), torch.randn(B, TINY.anchors, T, 2)
        own = (given[name] for name in ("camera", "lidar", "ego_status"))
        with torch.no_grad():
            made = denoised(model, model.perception(*own).scene, noise).trajectories
        apart.append(float((made[..., :2] - model.anchors).norm(dim=-1).mean()))
    assert apart[0] < apart[1] < apart[2]


def test_the_denoiser_learns_of_so_many_levels() -> None:
    drawn = [
        objective("imitation", levels=3).draw(64, 1, torch.Generator().manual_seed(seed))[1]
        for seed in range(3)
    ]
    assert set(torch.cat(drawn).tolist()) == {0, 1, 2}


@pytest.fixture
def logs(folder: Path, monkeypatch: pytest.MonkeyPatch) -> list[Path]:
    monkeypatch.setattr(sensor_windows, "sensed", told)
    return [*open_logs(folder)]


@pytest.mark.parametrize("mirrored", [False, True])
def test_candidates_in_a_reflected_window_are_judged_as_in_that_of_the_mirrored_bend(
    logs: list[Path], tmp_path: Path, *, mirrored: bool
) -> None:
    window = Scenes(bend(0, mirrored=mirrored))[0]
    aside = np.linspace(-4.0, 4.0, 5)[:, None, None] * [0.0, 1.0, 0.0]
    plans = window.recorded(np.arange(1, 9) / 2) + aside
    run = DiffusionDriveRun(CONFIG, logs, tmp_path)
    drawn = run.window_batch(np.array([0]), mirrored=mirrored)
    given = {name: torch.from_numpy(drawn[name]) for name in ("window", "signs")}
    told = run.new_objective(run.model)._judged(
        given, torch.from_numpy(plans).float()[None], torch.tensor([torch.nan])
    )
    wanted = PdmScorer(window).score(plans).sub_scores
    np.testing.assert_allclose(told[0, :, :5], wanted, atol=1e-4)
    assert np.ptp(wanted[:, 1]) == 1


def test_the_stages_follow_one_another(logs: list[Path], tmp_path: Path) -> None:
    scorers = replace(CONFIG, objective=replace(CONFIG.objective, stage="scorers"))
    with pytest.raises(ConfigError, match="before: expected a checkpoint"):
        DiffusionDriveRun(scorers, logs, tmp_path)
    first = DiffusionDriveRun(replace(CONFIG, steps=1), logs, tmp_path / "imitation")
    assert first.model.anchors.abs().max() > 1  # clustered from what was driven
    first.fit()

    before = first.checkpoint_path
    for stage in STAGES[1:]:
        settings = replace(CONFIG.objective, stage=stage)
        config = replace(CONFIG, objective=settings, before=str(before))
        run = DiffusionDriveRun(config, logs, tmp_path / stage)
        start, saved = copied_weights(run.model), restore_model(load_checkpoint(before))
        torch.testing.assert_close(start, {**saved.state_dict()}, rtol=0, atol=0)
        run.fit()
        changed = changed_since(start, run.model)
        assert {name.split(".")[0] for name in changed} == LEARNS[stage]
        row = run.evaluations[-1]
        best = row["pdms_of_the_best"]
        assert 0 <= row["success"] <= best <= 1
        assert row["pdms_of_the_best_plain"] <= best
        assert row["spread_m"] > 0


def test_a_run_begins_with_the_weights_of_the_one_before(logs: list[Path], tmp_path: Path) -> None:
    """Its noise may be another, which decides no weight; a network's width may not."""
    DiffusionDriveRun(replace(CONFIG, steps=1), logs, tmp_path / "first").fit()
    after = replace(CONFIG, before=str(tmp_path / "first" / "checkpoint.pt"))
    noisy = replace(after, model=replace(CONFIG.model, noise=(1e-5, 1e-3)))
    DiffusionDriveRun(noisy, logs, tmp_path / "noisy")
    wide = replace(after, model=replace(CONFIG.model, hidden=MODEL.hidden * 2))
    said = rf"before: .*first/checkpoint.pt: expected model.hidden {MODEL.hidden * 2}, got"
    with pytest.raises(ConfigError, match=said):
        DiffusionDriveRun(wide, logs, tmp_path / "wide")


def test_a_vocabulary_is_clustered_or_read_and_refused_while_it_is_empty(
    logs: list[Path], tmp_path: Path
) -> None:
    run = DiffusionDriveRun(replace(CONFIG, steps=1), logs, tmp_path / "clustered")
    run.fit()
    ends = run.model.vocabulary[:, -1, :2]
    assert ends.norm(dim=-1).min() > 1.0  # the cars of the bend drive
    own = np.random.default_rng(0).normal(size=(TINY.vocabulary, T, 3)).astype(np.float32)
    np.save(tmp_path / "own.npy", own)
    read = replace(CONFIG, vocabulary=str(tmp_path / "own.npy"))
    found = DiffusionDriveRun(read, logs, tmp_path / "read").model.vocabulary
    np.testing.assert_array_equal(found.numpy(), own)

    before = tmp_path / "clustered" / "checkpoint.pt"
    saved = load_checkpoint(before)
    saved.average["vocabulary"].zero_()
    save_checkpoint(tmp_path / "empty.pt", saved)
    said = "vocabulary: expected 3 trajectories, got zeros alone"
    with pytest.raises(ConfigError, match=f"before: .*empty.pt: {said}"):
        DiffusionDriveRun(replace(CONFIG, before=str(tmp_path / "empty.pt")), logs, tmp_path / "x")
    with pytest.raises(ExportError, match=said):
        adapter_of("diffusiondrive", restore_model(saved), ExportChoices())
    with pytest.raises(ConfigError, match="vocabulary: expected none beside before"):
        DiffusionDriveRun(replace(read, before=str(before)), logs, tmp_path / "y")


def test_two_processes_learn_a_stage_that_does_not_ask_all_weights(
    logs: list[Path], tmp_path: Path
) -> None:
    open_sensor_windows(logs, SensorSizes.of(MODEL.backbone))
    (tmp_path / "train.yaml").write_text(config_text(replace(CONFIG, devices=2, threads=1)))
    words = ["train", logs[0].parent, "--out", tmp_path, "--config", tmp_path / "train.yaml"]
    launched(tmp_path, *words)
    assert load_checkpoint(tmp_path / "checkpoint.pt").step == CONFIG.steps

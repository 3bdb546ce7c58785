"""A trajectory's quality is what it counts in training."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from training_runs import QUICK, SMALL
from trajectory_files import COUNT, RNG, STEPS, l2_arrays, saved

from anchorflow_training.batches import FlowBatchConfig, draw_batch
from anchorflow_training.data import TrajectoryDataset
from anchorflow_training.dataset import DatasetError, SceneDataset, open_dataset, own_time_states
from anchorflow_training.objective import prior_covariance
from anchorflow_training.trainer import CFMTrainer, TrainerConfig

SCENES, TRAJECTORIES = 6, 4
CONFIG = replace(QUICK, steps=3)


def with_quality(dataset: SceneDataset, quality: np.ndarray) -> SceneDataset:
    return replace(dataset, arrays={**dataset.arrays, "quality": quality.astype(np.float32)})


def fitted(
    datasets: Sequence[SceneDataset], out: Path, config: TrainerConfig = CONFIG
) -> list[CFMTrainer]:
    runs = [CFMTrainer(config, data, out / f"{n}") for n, data in enumerate(datasets)]
    for run in runs:
        run.fit()
    return runs


def test_a_batch_weighs_each_sample_by_its_trajectory(tiny_dataset: SceneDataset) -> None:
    quality = np.linspace(0.0, 1.0, SCENES * TRAJECTORIES).reshape(SCENES, TRAJECTORIES)
    weighed = with_quality(tiny_dataset, quality)
    # One scene a batch: six batches show every trajectory once.
    config = FlowBatchConfig(scenes=1, samples=TRAJECTORIES, mirror=False)
    seen = []
    for index in range(SCENES):
        batch, plain = (draw_batch(each, config, index) for each in (weighed, tiny_dataset))
        assert "sample_weights" not in plain
        np.testing.assert_array_equal(batch["states"], plain["states"])
        [scene] = np.flatnonzero(tiny_dataset.arrays["x_curr"][:, 1] == batch["x_curr"][0, 1])
        for state, weight in zip(batch["states"][0], batch["sample_weights"][0], strict=True):
            arrays = tiny_dataset.arrays
            every = own_time_states(arrays["states"][scene], arrays["durations"][scene])
            [own] = np.flatnonzero((every == state).all((1, 2)))
            assert weight == pytest.approx(quality[scene, own] / quality.mean())
            seen.append(weight)
    assert np.mean(seen) == pytest.approx(1.0)


def test_trajectories_of_no_quality_teach_nothing(
    tiny_dataset: SceneDataset, tmp_path: Path
) -> None:
    """What they are makes no difference to the weights that are learnt."""
    quality = np.ones((SCENES, TRAJECTORIES))
    quality[:, 2:] = 0.0
    states = np.array(tiny_dataset.arrays["states"])
    states[:, 2:] += 1.5
    arrays = {**tiny_dataset.arrays, "states": states}
    # Optimal transport would pair noise with them all the same, so it is off.
    config = replace(CONFIG, flow=replace(CONFIG.flow, optimal_transport=False))
    moved = replace(tiny_dataset, arrays=arrays)
    datasets = with_quality(tiny_dataset, quality), with_quality(moved, quality), moved
    same, ignored, counted = fitted(datasets, tmp_path, config)
    torch.testing.assert_close(same.average, ignored.average)
    assert counted.curve[-1]["loss"] != pytest.approx(ignored.curve[-1]["loss"], rel=1e-3)


def test_the_prior_has_the_spread_of_what_counts(tiny_dataset: SceneDataset) -> None:
    quality = np.ones((SCENES, TRAJECTORIES))
    quality[1:] = 0.0
    quality[0, 2:] = 0.0
    first = {name: array[:1] for name, array in tiny_dataset.arrays.items()}
    for name in ("states", "durations", "route"):
        first[name] = first[name][:, :2]
    np.testing.assert_allclose(
        prior_covariance(with_quality(tiny_dataset, quality), SMALL),
        prior_covariance(replace(tiny_dataset, arrays=first), SMALL),
        rtol=0,
        atol=1e-7,  # the largest are 0.01; float32 rounds the fit to 2e-8
    )


def test_equal_qualities_change_nothing(tiny_dataset: SceneDataset, tmp_path: Path) -> None:
    half = with_quality(tiny_dataset, np.full((SCENES, TRAJECTORIES), 0.5))
    runs = fitted((tiny_dataset, half), tmp_path)
    losses = [[row["loss"] for row in run.curve] for run in runs]
    np.testing.assert_allclose(*losses, rtol=1e-5)


@pytest.mark.parametrize(
    ("quality", "said"),
    [
        (np.ones((SCENES, 2)), r"\[6, 4\].*found \[6, 2\]"),
        (np.full((SCENES, TRAJECTORIES), 1.5), r"values in \[0, 1\], found 1\.5 in scene 0"),
        (np.full((SCENES, TRAJECTORIES), np.nan), r"values in \[0, 1\], found nan in scene 0"),
    ],
)
def test_a_wrong_quality_is_named(
    quality: np.ndarray, said: str, write_dataset: Callable[[Path], Path], tmp_path: Path
) -> None:
    path = write_dataset(tmp_path / "data")
    np.save(path / "quality.npy", quality.astype(np.float32))
    with pytest.raises(DatasetError, match=r"quality\.npy: expected " + said):
        open_dataset(path)


def test_a_quality_of_nothing_is_refused(tiny_dataset: SceneDataset, tmp_path: Path) -> None:
    nothing = with_quality(tiny_dataset, np.zeros((SCENES, TRAJECTORIES)))
    with pytest.raises(DatasetError, match=r"quality\.npy: expected more than 0"):
        CFMTrainer(CONFIG, nothing, tmp_path)


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"positions": np.zeros((4, 9))}, r"positions: expected \[N, T, D\].*found \[4, 9\]"),
        ({"positions": np.zeros((4, 2, 2))}, r"positions: .*T >= 3.*found \[4, 2, 2\]"),
        ({"positions": np.zeros((4, 9, 4))}, r"positions: .*D 2 or 3.*found \[4, 9, 4\]"),
        (
            {"velocities": np.zeros((COUNT, STEPS - 1, 2))},
            r"velocities: expected \[12, 9, 2\] beside positions \[12, 9, 2\], found \[12, 8, 2\]",
        ),
        (
            {"goal_states": np.zeros((COUNT, 6))},
            r"goal_states: expected \[12, 4\].*found \[12, 6\]",
        ),
        ({"quality": np.zeros((COUNT, 1))}, r"quality: expected \[12\].*found \[12, 1\]"),
        ({"origin": np.zeros(3)}, r"origin: expected \[2\] or \[12, 2\].*found \[3\]"),
        ({"cost_maps": np.zeros((COUNT, 16, 16))}, r"cost_maps: expected \[12, C, H, W\]"),
        (
            {"cost_maps": np.zeros((COUNT, 1, 8, 16))},
            r"cost_maps: .*H and W 16\.\.512, found \[12, 1, 8, 16\]",
        ),
        ({"cost_maps": np.full((COUNT, 1, 16, 16), 100.0)}, r"cost_maps: .*\[0, 1\].*row 0"),
        (
            {"cost_maps": np.eye(16, dtype=np.uint8)[None, None].repeat(COUNT, 0)},
            r"cost_maps: expected 255 for 1 in 8 bits, found at most 1",
        ),
        (
            {"cost_maps": np.full((COUNT, 1, 16, 16), 100, np.uint8)},
            r"cost_maps: expected 255 for 1 in 8 bits, found at most 100",
        ),
        ({"style_weights": np.zeros((COUNT, 3))}, r"style_weights: .*not all 0.*row 0"),
        ({"quality": np.arange(COUNT) / 5}, r"quality: .*in \[0, 1\], found 1\.2.*row 6"),
        ({"safety_margins": -np.ones(COUNT)}, r"safety_margins: expected values at least 0"),
        ({"resolution": 0.0}, r"resolution: expected values more than 0"),
        ({"dt": -1.0}, r"dt: expected seconds above 0, found -1"),
        (
            {"horizon_s": 5.0},
            r"expected one time step.* found 0\.1 s from dt, 0\.625 s from horizon_s",
        ),
        ({"positions": np.full((COUNT, STEPS, 2), np.nan)}, r"expected a row of finite numbers"),
        (
            {"positions": np.zeros((COUNT, STEPS, 2), "U3")},
            r"positions: expected numbers, found <U3",
        ),
    ],
)
def test_errors_name_file_array_and_shapes(
    changed: dict[str, Any], said: str, tmp_path: Path
) -> None:
    with pytest.raises(DatasetError, match=r"wrong\.npz: " + said):
        TrajectoryDataset(saved(tmp_path / "wrong.npz", **l2_arrays(**changed)))


def test_no_positions_lists_what_there_is(tmp_path: Path) -> None:
    np.savez(tmp_path / "p.npz", RNG.normal(size=(3, 4, 2)))
    with pytest.raises(DatasetError, match=r"positions: expected .* found only arr_0"):
        TrajectoryDataset(tmp_path / "p.npz")

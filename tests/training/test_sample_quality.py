"""A trajectory's quality is what it counts in training."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from anchorflow_models import L2Config
from anchorflow_training.batches import FlowBatchConfig, draw_batch
from anchorflow_training.config import TrainerConfig
from anchorflow_training.dataset import DatasetError, SceneDataset, open_dataset, own_time_states
from anchorflow_training.objective import prior_covariance
from anchorflow_training.trainer import CFMTrainer

SCENES, TRAJECTORIES = 6, 4
MODEL = L2Config(map_size=16, feature_channels=4)
CONFIG = TrainerConfig(
    steps=3,
    warmup=0,
    report_every=1,
    tensorboard=False,
    batch=FlowBatchConfig(scenes=2, samples=4),
    model=MODEL,
)


def with_quality(dataset: SceneDataset, quality: np.ndarray) -> SceneDataset:
    return replace(dataset, arrays={**dataset.arrays, "quality": quality.astype(np.float32)})


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
    runs = []
    for name, dataset in (("a", tiny_dataset), ("b", replace(tiny_dataset, arrays=arrays))):
        runs.append(CFMTrainer(config, with_quality(dataset, quality), tmp_path / name))
        runs[-1].fit()
    torch.testing.assert_close(runs[0].average, runs[1].average)
    counted = CFMTrainer(config, replace(tiny_dataset, arrays=arrays), tmp_path / "c")
    counted.fit()
    assert counted.curve[-1]["loss"] != pytest.approx(runs[1].curve[-1]["loss"], rel=1e-3)


def test_the_prior_has_the_spread_of_what_counts(tiny_dataset: SceneDataset) -> None:
    quality = np.ones((SCENES, TRAJECTORIES))
    quality[1:] = 0.0
    quality[0, 2:] = 0.0
    first = {name: array[:1] for name, array in tiny_dataset.arrays.items()}
    for name in ("states", "durations", "route"):
        first[name] = first[name][:, :2]
    np.testing.assert_allclose(
        prior_covariance(with_quality(tiny_dataset, quality), MODEL),
        prior_covariance(replace(tiny_dataset, arrays=first), MODEL),
        rtol=0,
        atol=1e-7,  # the largest are 0.01; float32 rounds the fit to 2e-8
    )


def test_equal_qualities_change_nothing(tiny_dataset: SceneDataset, tmp_path: Path) -> None:
    half = with_quality(tiny_dataset, np.full((SCENES, TRAJECTORIES), 0.5))
    runs = []
    for name, dataset in (("plain", tiny_dataset), ("half", half)):
        runs.append(CFMTrainer(CONFIG, dataset, tmp_path / name))
        runs[-1].fit()
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

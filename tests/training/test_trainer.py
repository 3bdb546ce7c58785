"""Training: the loss falls, a run that was cut off goes on as if it had not been."""

from pathlib import Path

import numpy as np
import pytest
import torch

from anchorflow_training.batches import BatchConfig
from anchorflow_training.checkpoint import CheckpointError, load_checkpoint
from anchorflow_training.coupling import couple
from anchorflow_training.dataset import SceneDataset, open_dataset
from anchorflow_training.make_data import DataConfig, make_dataset
from anchorflow_training.restore import restore_model
from anchorflow_training.trainer import CFMTrainer, TrainerConfig

BATCH = BatchConfig(scenes=2, samples=8)


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> SceneDataset:
    path = tmp_path_factory.mktemp("data")
    make_dataset(path, DataConfig(scenes=4, trajectories=8), workers=2)
    return open_dataset(path)


def trainer(dataset: SceneDataset, out: Path, steps: int) -> CFMTrainer:
    torch.manual_seed(0)
    config = TrainerConfig(steps=steps, warmup=2, report_every=1, checkpoint_every=3, batch=BATCH)
    return CFMTrainer(config, dataset, out)


def test_the_loss_falls(dataset: SceneDataset, tmp_path: Path) -> None:
    run = trainer(dataset, tmp_path, 40)
    run.fit()
    losses = [row["loss"] for row in run.curve]
    assert np.mean(losses[-10:]) < 0.9 * np.mean(losses[:5])


def test_a_resumed_run_joins_the_uninterrupted_one(dataset: SceneDataset, tmp_path: Path) -> None:
    whole = trainer(dataset, tmp_path / "whole", 6)
    whole.fit()
    cut = trainer(dataset, tmp_path / "cut", 6)
    stop = RuntimeError("killed")

    def killed(step: int, _: dict[str, float]) -> None:
        if step == 5:
            raise stop

    with pytest.raises(RuntimeError, match="killed"):
        cut.fit(killed)
    resumed = trainer(dataset, tmp_path / "cut", 6)
    assert resumed.step == 3
    resumed.fit()
    losses = [[row["loss"] for row in run.curve] for run in (whole, resumed)]
    np.testing.assert_allclose(losses[0], losses[1], rtol=1e-4)


def test_a_restored_model_has_the_averaged_weights(dataset: SceneDataset, tmp_path: Path) -> None:
    run = trainer(dataset, tmp_path, 3)
    run.fit()
    model = restore_model(load_checkpoint(run.checkpoint_path))
    for name, value in model.state_dict().items():
        torch.testing.assert_close(value, run.average[name])
    assert model.prior.factor.abs().max() > 0


def test_a_file_that_is_no_checkpoint_is_named(tmp_path: Path) -> None:
    path = tmp_path / "checkpoint.pt"
    path.write_bytes(b"nothing of the kind")
    with pytest.raises(CheckpointError, match=r"checkpoint\.pt"):
        load_checkpoint(path)


def test_coupling_shortens_the_way() -> None:
    rng = np.random.default_rng(0)
    start, end = (rng.normal(size=(3, 16, 5)).astype(np.float32) for _ in range(2))
    order = couple(start, end)
    paired = np.take_along_axis(end, order[..., None], 1)
    assert np.square(start - paired).sum() < 0.8 * np.square(start - end).sum()
    np.testing.assert_array_equal(np.sort(order, 1), np.tile(np.arange(16), (3, 1)))

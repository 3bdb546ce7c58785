"""A teacher that no one has trained: random weights, every branch open."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
import torch
from torch import nn

from anchorflow_models import L2Config, create_l2_safety_cfm
from anchorflow_training.batches import FlowBatchConfig, dealt_routes, encode_inputs, prior_means
from anchorflow_training.config import AnchorJudgeConfig
from anchorflow_training.dataset import SceneDataset
from anchorflow_training.distillation.distiller import Distiller
from anchorflow_training.distillation.pairs import DistillConfig, TeacherConfig
from anchorflow_training.distillation.teacher import Teacher

MODEL = L2Config(map_size=16, map_scales=1, feature_channels=4)
CONFIG = DistillConfig(
    steps=4,
    warmup=0,
    report_every=1,
    checkpoint_every=2,
    tensorboard=False,
    batch=FlowBatchConfig(scenes=2, samples=3),
    evaluation=AnchorJudgeConfig(every=2, samples=2, scenes=2, pictures=0),
    teacher=TeacherConfig(steps=2, pairs=3),
    model=MODEL,
)

Distil = Callable[..., Distiller]


@pytest.fixture(scope="session")
def teacher() -> Teacher:
    """Always of the same weights."""
    with torch.random.fork_rng():
        torch.manual_seed(0)
        model = create_l2_safety_cfm(MODEL)
        for parameter in model.parameters():
            if not parameter.any():
                nn.init.normal_(parameter, std=0.05)
    return Teacher(model.eval().requires_grad_(False), sha256="5" * 64, step=7)


@pytest.fixture
def inputs(tiny_dataset: SceneDataset) -> dict[str, torch.Tensor]:
    """What encode takes, of three scenes."""
    batch = encode_inputs(tiny_dataset.batch(torch.arange(3).numpy()))
    return {name: torch.from_numpy(array) for name, array in batch.items()}


@pytest.fixture
def prior_mean(tiny_dataset: SceneDataset) -> torch.Tensor:
    """[3, 5, T, S]: of the same scenes, their routes dealt out to five samples."""
    batch = tiny_dataset.batch(torch.arange(3).numpy())
    return torch.from_numpy(prior_means(batch, dealt_routes(batch, 5)))


@pytest.fixture
def distil(teacher: Teacher, tiny_dataset: SceneDataset, tmp_path: Path) -> Distil:
    """Makes a run of a configuration in a folder of the test's own."""

    def make(config: DistillConfig = CONFIG, name: str = "run") -> Distiller:
        pairs = tmp_path / "pairs"
        return Distiller(config, tiny_dataset, tmp_path / name, teacher=teacher, pairs=pairs)

    return make


@pytest.fixture(scope="session")
def config() -> DistillConfig:
    """A run of seconds."""
    return CONFIG

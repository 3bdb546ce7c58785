"""A teacher that no one has trained: random weights, every branch open."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import pytest
import torch
from flowmp_scenes import make_model
from training_runs import DISTILLATION

from anchorflow_training.batches import dealt_routes, encode_inputs, prior_means
from anchorflow_training.dataset import SceneDataset
from anchorflow_training.distillation.distiller import Distiller
from anchorflow_training.distillation.teacher import Teacher

Distil = Callable[..., Distiller]


@pytest.fixture(scope="session")
def teacher() -> Teacher:
    """Always of the same weights."""
    model = make_model(**asdict(DISTILLATION.model))
    return Teacher(model.requires_grad_(False), sha256="5" * 64, step=7)


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
    """Makes a run of changed settings in a folder of the test's own."""

    def make(name: str = "run", **changed: Any) -> Distiller:
        config, pairs = replace(DISTILLATION, **changed), tmp_path / "pairs"
        return Distiller(config, tiny_dataset, tmp_path / name, teacher=teacher, pairs=pairs)

    return make

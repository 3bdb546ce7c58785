"""Make a teacher's pairs: its ODE solved from every noise of every scene."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import torch
from numpy.typing import NDArray

from anchorflow_training.batches import encode_inputs
from anchorflow_training.dataset import SceneDataset
from anchorflow_training.distillation.config import TeacherConfig
from anchorflow_training.distillation.normalised_flow import NormalisedFlow, started
from anchorflow_training.distillation.pairs import PairBank
from anchorflow_training.distillation.teacher import Teacher
from anchorflow_trajectory.ode.method import method_named
from anchorflow_trajectory.ode.schedule import uniform_schedule

Progress = Callable[[int, int], None]

CHUNK = 8  # scenes solved at a time


def make_pairs(
    bank: PairBank,
    blocks: Sequence[int],
    *,
    teacher: Teacher,
    dataset: SceneDataset,
    config: TeacherConfig,
    progress: Progress = lambda *_: None,
) -> None:
    """Solve and write some blocks of a bank.

    progress: called with the blocks that are done and all of them
    """
    for done, block in enumerate(blocks, 1):
        scenes = np.array(bank.scenes_of(block))
        parts = [
            _ends(bank, scenes[start : start + CHUNK], teacher, dataset, config)
            for start in range(0, len(scenes), CHUNK)
        ]
        bank.write(block, np.concatenate(parts))
        progress(done, len(blocks))


def _ends(
    bank: PairBank,
    scenes: NDArray[np.int64],
    teacher: Teacher,
    dataset: SceneDataset,
    config: TeacherConfig,
) -> NDArray[np.float16]:
    """[scenes, N, T, S]"""
    model, batch = teacher.model, encode_inputs(dataset.batch(scenes))
    device = model.prior.spread.device
    inputs = {name: torch.from_numpy(array).to(device) for name, array in batch.items()}
    noise = np.stack([bank.noise(int(scene)) for scene in scenes])
    with torch.no_grad():
        z_0 = started(model, torch.from_numpy(noise).to(device))
        z_1 = NormalisedFlow.of(model, inputs).carried(
            z_0, schedule=uniform_schedule(config.steps), method=method_named(config.method)
        )
    return z_1.half().cpu().numpy()

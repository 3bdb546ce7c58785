"""Make a teacher's pairs: its ODE solved from every noise of every scene."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import torch
from numpy.typing import NDArray

from anchorflow_client.contract import uniform_schedule
from anchorflow_training.batches import dealt_routes, encode_inputs, prior_means
from anchorflow_training.dataset import SceneDataset
from anchorflow_training.distillation.config import TeacherConfig
from anchorflow_training.distillation.normalised_flow import NormalisedFlow, started
from anchorflow_training.distillation.pairs import PairBank
from anchorflow_training.distillation.teacher import Teacher
from anchorflow_trajectory.ode.method import method_named

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
    model, batch = teacher.model, dataset.batch(scenes)
    device = model.prior.spread.device
    inputs = {n: torch.from_numpy(array).to(device) for n, array in encode_inputs(batch).items()}
    mean = torch.from_numpy(prior_means(batch, dealt_routes(batch, bank.samples))).to(device)
    noise = np.stack([bank.noise(int(scene)) for scene in scenes])
    with torch.no_grad():
        z_0 = started(model, torch.from_numpy(noise).to(device), inputs["limits"])
        z_1 = NormalisedFlow.of(model, inputs, mean).carried(
            z_0, schedule=uniform_schedule(config.steps), method=method_named(config.method)
        )
    return z_1.half().cpu().numpy()

"""Trajectories that a GoalFlow proposes in the windows of logs, and their PDM sub-scores."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from anchorflow_client.sensors import route_ahead
from anchorflow_driving.log import read_log
from anchorflow_driving.pdm import SUB_SCORES, PdmScorer
from anchorflow_driving.sensors.bev import DRAWING, draw_bev
from anchorflow_driving.sensors.inputs import status_of
from anchorflow_driving.window import Scenes, Window
from anchorflow_models.goalflow import GoalFlow
from anchorflow_models.goalflow.config import ASIDE, HALTINGS, PACES, TURNS
from anchorflow_models.goalflow.goalflow import POSE, SETTLED
from anchorflow_training.driving.log_cache import Arrays, digest, log_arrays

PER_WAY = 2
"""Trajectories that are drawn to each goal, and to none; ways that no flow moves stand for
themselves."""


@dataclass(frozen=True)
class Proposals:
    """trajectories: [W, N, T, 3] m and rad, in W windows; scores: [W, N, 5] by SUB_SCORES."""

    trajectories: NDArray[np.float32]
    scores: NDArray[np.float32]


def proposals(logs: Sequence[Path], model: GoalFlow) -> Proposals:
    """Those of a model in all windows of logs.

    Those of each log are made once, on every core, and kept beside it under the digest of the
    weights that they hang on. Raises `LogError` where a log or what is kept of it cannot be read,
    or there is no place to write beside it.
    """
    weights = {n: w.cpu().numpy() for n, w in model.state_dict().items()}
    asked = [weight for name, weight in weights.items() if not name.startswith("outcomes.")]
    suffix = f".proposals-{digest((DRAWING, TURNS, HALTINGS, PACES, ASIDE), *asked)}"
    parts = [*log_arrays(logs, suffix, partial(_proposed, model=model))]
    return Proposals(
        np.concatenate([part["trajectories"] for part in parts]),
        np.concatenate([part["scores"].astype(np.float32) for part in parts]),
    )


def _proposed(log: Path, *, model: GoalFlow) -> Arrays:
    torch.set_num_threads(1)
    seed = int.from_bytes(hashlib.sha256(log.name.encode()).digest()[:4], "big")
    generator = torch.Generator().manual_seed(seed)
    windows = Scenes(read_log(log))
    plans = [drawn(model, window, generator) for window in windows]
    scored = zip(windows, plans, strict=True)
    told = [PdmScorer(window).score(each.astype(np.float64)).sub_scores for window, each in scored]
    # A log without windows has no rows, not even of a shape.
    flowing, steps = model.config.picked + 1, model.config.num_steps
    count = model.config.ways + (PER_WAY - 1) * flowing
    trajectories = np.array(plans, np.float32).reshape(-1, count, steps, POSE)
    scores = np.array(told, np.float16).reshape(-1, count, len(SUB_SCORES))
    return {"trajectories": trajectories, "scores": scores}


@torch.no_grad()
def drawn(model: GoalFlow, window: Window, generator: torch.Generator) -> NDArray[np.float32]:
    """Trajectories [N, T, 3] of one step of the flow, told the route, and ways that it leaves."""
    view = window.view
    route, size = route_ahead(view.route.points), view.vehicle.size.astype(np.float32)
    told = (draw_bev(view), status_of(view), size, route)
    context = model.encode(*(torch.from_numpy(each)[None] for each in told))
    ways = context["prior_mean"][:, : model.config.ways]
    flowing = ways[:, ways[0, :, 0, POSE] != SETTLED]
    mean = torch.cat([ways, flowing.repeat(1, PER_WAY - 1, 1, 1)], 1)
    noise = torch.randn(*mean.shape[:2], POSE * model.config.num_steps, generator=generator)
    x_0 = model.draw(noise, mean)
    x_1 = x_0 + model.field(x_0, mean, model.modulate(torch.zeros(1), context)[:, 0], context)
    return x_1[0, ..., :POSE].numpy()

"""V2X-VLM at Florence-2's own size, its weights drawn at random: does it train, export and serve?

It says nothing of quality: published weights are not part of this.
"""

from __future__ import annotations

import resource
import tempfile
from collections.abc import Callable
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
import torch

from anchorflow_benchmarks.report import ResultTable, Row
from anchorflow_export.adapter import ExportChoices
from anchorflow_export.bundle import BundleDescription, export_bundle
from anchorflow_export.planners.v2x_vlm import v2x_vlm_adapter
from anchorflow_models.v2x_vlm import V2XConfig, create_v2x_vlm
from anchorflow_service.local import LocalClient
from anchorflow_training.v2x.config import V2XRunConfig
from anchorflow_training.v2x.objective import V2XObjective
from anchorflow_training.v2x.prompts import prompt
from anchorflow_training.v2x.tokenizer import opened, token_rows, train_tokenizer

PUBLISHED = {"image_size": 768, "vocabulary": 51289, "positions": 4096}
TOLERANCE = 1e-3
"""m of a trajectory; of max(1, largest magnitude) for a graph's outputs."""
PROMPT = prompt(speed=8.2, turn_rate=0.0, scene="")


def florence_size_table(
    variant: str, *, tell: Callable[[str], object] = lambda _: None, freeze_vision: bool = True
) -> ResultTable:
    """One training step, export and parity, three requests; `tell` hears of each part.

    freeze_vision: leaves the tower out of the step, which needs half the memory
    """
    config = V2XConfig(variant=variant, **PUBLISHED)  # type: ignore[arg-type]
    tokenizer = train_tokenizer([PROMPT])
    model = create_v2x_vlm(config)
    model.tokenizer = tokenizer
    rows: list[Row] = [{"what": "parameters, millions", "figure": _millions(model)}]

    def note(what: str, figure: float) -> None:
        rows.append({"what": what, "figure": figure})
        tell(f"{what}: {figure:.4g}")

    run = V2XRunConfig(model=config, freeze_vision=freeze_vision)
    note("training step of one pair, s", _timed(lambda: _train_once(model, run, tokenizer)))
    model.eval().requires_grad_(False)
    with tempfile.TemporaryDirectory() as scratch:
        out = Path(scratch, "bundle")
        description = BundleDescription(name=variant, version="0", planner="v2x_vlm")
        began = perf_counter()
        adapter = v2x_vlm_adapter(model, ExportChoices())
        differences = export_bundle(adapter, description, out=out, tolerance=TOLERANCE)
        note("export with its proof, s", perf_counter() - began)
        note("largest difference from torch", max(each.error for each in differences))
        for file in sorted(out.glob("*.onnx")):
            note(f"{file.name}, MB", file.stat().st_size / 1e6)
        client = LocalClient.of(out)
        pictures = np.random.default_rng(0).integers(0, 256, (2, 3, 1200, 1920), np.uint8)
        inputs: dict[str, Any] = {
            "vehicle_image": pictures[0],
            "infrastructure_image": pictures[1],
            "prompt": PROMPT,
        }
        note("request, both pictures new, ms", 1e3 * _timed(lambda: client.plan(inputs=inputs)))
        note("request, roadside known, ms", 1e3 * _timed(lambda: client.plan(inputs=inputs)))
        del inputs["infrastructure_image"]
        note("request without roadside, ms", 1e3 * _timed(lambda: client.plan(inputs=inputs)))
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    note("most memory at once, GiB", peak)
    words = f"Florence-2 {variant} at {config.image_size} pixels, random weights; vision "
    words += "frozen in the step." if freeze_vision else "trained in the step."
    return ResultTable(f"V2X-VLM {variant}", rows, words)


def _train_once(model: Any, run: V2XRunConfig, tokenizer: bytes) -> None:
    size = run.model.image_size
    generator = torch.Generator().manual_seed(0)
    pictures = torch.randint(0, 256, (2, 1, 3, size, size), generator=generator)
    tokens, mask = token_rows(opened(tokenizer), [PROMPT], most=run.model.max_tokens)
    times = run.model.dt * torch.arange(1, run.model.waypoints + 1)
    batch = {
        "vehicle_image": pictures[0].to(torch.uint8),
        "infrastructure_image": pictures[1].to(torch.uint8),
        "waypoints": torch.stack([8.2 * times, 0.0 * times], -1)[None],
        "tokens": torch.from_numpy(tokens),
        "mask": torch.from_numpy(mask),
    }
    objective = V2XObjective(model.train(), run, None)
    learnt = [each for each in model.parameters() if each.requires_grad]
    optimiser = torch.optim.AdamW(learnt, 1e-5)
    before = model.head[0].weight.detach().clone()
    loss, _ = objective(batch, torch.tensor([False]))
    loss.backward()
    optimiser.step()
    if not torch.isfinite(loss) or torch.equal(before, model.head[0].weight):
        raise AssertionError("the step changed nothing")


def _timed(work: Callable[[], object]) -> float:
    began = perf_counter()
    work()
    return perf_counter() - began


def _millions(model: torch.nn.Module) -> float:
    return sum(each.numel() for each in model.parameters()) / 1e6

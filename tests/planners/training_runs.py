"""Training runs in tests: a small configuration, steps on one batch, an end in the middle."""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

import pytest
import torch
from torch import Tensor, nn
from typer import Typer
from typer.testing import CliRunner

from anchorflow_cli.main import main
from anchorflow_models import L2Config
from anchorflow_training.batches import FlowBatchConfig
from anchorflow_training.config import AnchorJudgeConfig, TrainerConfig
from anchorflow_training.distillation.pairs import DistillConfig, TeacherConfig
from anchorflow_training.run import TrainingRun
from anchorflow_training.settings import Setting

Run = TypeVar("Run", bound=TrainingRun)

SMALL = L2Config(map_size=16, feature_channels=4, layers=1)
QUICK = TrainerConfig(
    steps=2,
    warmup=0,
    report_every=1,
    tensorboard=False,
    batch=FlowBatchConfig(scenes=2, samples=4),
    model=SMALL,
)
DISTILLATION = DistillConfig(
    steps=4,
    warmup=0,
    report_every=1,
    checkpoint_every=2,
    tensorboard=False,
    batch=FlowBatchConfig(scenes=2, samples=3),
    evaluation=AnchorJudgeConfig(every=2, samples=2, scenes=2, pictures=0),
    teacher=TeacherConfig(steps=2, pairs=3),
    model=L2Config(map_size=16, map_scales=1, feature_channels=4),
)


def fit_until(run: TrainingRun, last: int) -> None:
    """Train until the report of a step, which interrupts the run."""

    def report(step: int, _: object) -> None:
        if step == last:
            raise InterruptedError

    with pytest.raises(InterruptedError):
        run.fit(report)


def resumed_and_whole(make: Callable[[str], Run]) -> tuple[Run, Run]:
    """A run that is cut off in its third step and goes on from its second, and a whole one."""
    fit_until(make("cut"), 3)
    resumed, whole = make("cut"), make("whole")
    assert resumed.step == 2
    for run in (resumed, whole):
        run.fit()
    return resumed, whole


def assert_same_weights(*models: nn.Module) -> None:
    """To the bit."""
    torch.testing.assert_close(*(copied_weights(model) for model in models), rtol=0, atol=0)


def descended(
    objective: nn.Module,
    batch: Mapping[str, Tensor],
    draws: Sequence[Tensor],
    *,
    steps: int = 40,
    rate: float = 3e-3,
) -> list[dict[str, float]]:
    """Take optimiser steps on one batch; return the loss's terms before each and after the last."""
    optimiser, history = torch.optim.AdamW(objective.parameters(), rate), []
    for _ in range(steps):
        loss, terms = objective(batch, *draws)
        history.append(_floats(terms))
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
    return [*history, _floats(objective(batch, *draws)[1])]


def _floats(terms: Mapping[str, Tensor]) -> dict[str, float]:
    return {name: float(term.detach()) for name, term in terms.items()}


def changed_since(before: Mapping[str, Tensor], model: nn.Module) -> set[str]:
    """Return the names of the weights that are no longer as they were."""
    return {n for n, w in model.state_dict().items() if not torch.equal(w, before[n])}


def copied_weights(model: nn.Module) -> dict[str, Tensor]:
    return {name: weight.clone() for name, weight in model.state_dict().items()}


def launched(folder: Path, *words: Any) -> str:
    """Run a command as a program in a folder, which a launcher of processes can start once more."""
    program = folder / "program.py"
    program.write_text("from anchorflow_cli.main import main\n\nmain()\n")
    answer = subprocess.run(
        [sys.executable, program, *words], check=False, capture_output=True, text=True, timeout=300
    )
    assert answer.returncode == 0, answer.stderr
    return answer.stdout


def command(*words: Any) -> str:
    """Run a command; return its error message, or "" or "0" if it has none."""
    try:
        main([str(word) for word in words])
    except SystemExit as error:
        return str(error)
    return ""


def assert_documented(leaves: Iterable[Setting], app: Typer, page: Path) -> None:
    """Each setting is an option of the command, and a row of the page has its default."""
    text = page.read_text()
    help_text = CliRunner().invoke(app, ["--help"], env={"COLUMNS": "300"}).output
    for leaf in leaves:
        option = "--" + leaf.path.replace("_", "-")
        assert re.search(rf"{re.escape(option)}\b", help_text), option
        row = re.search(rf"^\| `{re.escape(leaf.path)}` \| ([^|]*) \|", text, re.MULTILINE)
        assert row, f"{page.name} has no row `{leaf.path}`"
        assert row[1].strip() == f"`{_shown(leaf.default)}`", leaf.path


def _shown(default: object) -> str:
    if isinstance(default, tuple):
        return ",".join(f"{part:g}" for part in default)
    return str(default).lower()

"""A second planner goes through training, checkpoints, export and the command line by its name."""

from __future__ import annotations

import re
import signal
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
import torch
from image_planner import HEIGHT, WIDTH
from torch import Tensor, nn
from torch_camera_planner import NAME, PLANNER, CameraConfig, CameraPlanner, camera_adapter
from training_runs import QUICK, command
from typer.testing import CliRunner

from anchorflow_cli.options import command_app
from anchorflow_cli.training import with_settings
from anchorflow_export import planners as adapters
from anchorflow_models import registry
from anchorflow_service.bundle import load_bundle
from anchorflow_service.local import LocalClient
from anchorflow_training import planners
from anchorflow_training.batches import Batch
from anchorflow_training.checkpoint import (
    CheckpointError,
    load_checkpoint,
    restore_model,
    save_checkpoint,
)
from anchorflow_training.config import RunConfig, TrainerConfig
from anchorflow_training.dataset import SceneDataset
from anchorflow_training.planners import Training
from anchorflow_training.record import Row
from anchorflow_training.run import TrainingRun
from anchorflow_training.trainer import CFMTrainer

Arrays = dict[str, np.ndarray]

SCENES = 5
SHIPPED = "flowmp, goalflow, wote, diffusiondrive, v2x_vlm, futures"


@dataclass(frozen=True)
class CameraRunConfig(RunConfig):
    planner: ClassVar[str] = NAME

    steps: int = 3
    model: CameraConfig = field(default_factory=CameraConfig)


class CameraObjective(nn.Module):
    """How far the score's aim is from the trajectory that was driven."""

    def __init__(self, model: CameraPlanner) -> None:
        super().__init__()
        self.model = model

    def draw(self, *_: Any) -> tuple[Tensor, ...]:
        return ()

    def forward(self, batch: dict[str, Tensor]) -> tuple[Tensor, dict[str, Tensor]]:
        context = self.model.encode(batch["camera"], batch["ego_status"])
        scores = self.model.score(context["brightness"], context["speed"])["scores"]
        loss = nn.functional.cross_entropy(scores, batch["driven"])
        return loss, {"cross_entropy": loss}


class CameraRun(TrainingRun):
    def __init__(self, config: CameraRunConfig, arrays: Arrays, out: Path) -> None:
        self.arrays = arrays
        super().__init__(config, out)

    @staticmethod
    def model_settings(data: Arrays) -> dict[str, Any]:  # noqa: ARG004
        return {"spread": 2.0}

    def begin(self, model: CameraPlanner) -> None:
        """Its weights are good to begin with."""

    def new_objective(self, model: CameraPlanner) -> nn.Module:
        return CameraObjective(model)

    def batch(self, index: int) -> Batch:
        rows = np.arange(2) + index
        return {name: array[rows % SCENES] for name, array in self.arrays.items()}

    @property
    def data(self) -> dict[str, Any]:
        return {"scenes": SCENES}

    @property
    def evaluates(self) -> bool:
        return True

    def evaluate(self, model: CameraPlanner) -> tuple[Row, None]:
        with torch.no_grad():
            context = model.encode(*(torch.from_numpy(self.arrays[n]) for n in INPUTS))
            scores = model.score(context["brightness"], context["speed"])["scores"]
        return {"success": float((scores.argmax(-1).numpy() == self.arrays["driven"]).mean())}, None


INPUTS = ("camera", "ego_status")
TRAINING = Training(
    CameraRunConfig,
    lambda folder: dict(np.load(folder / "scenes.npz")),
    CameraRun,
)


@pytest.fixture
def second_planner(monkeypatch: pytest.MonkeyPatch) -> str:
    """The lines that a planner adds; its name."""
    monkeypatch.setattr(registry, "PLANNERS", {**registry.PLANNERS, NAME: PLANNER})
    monkeypatch.setattr(planners, "TRAININGS", {**planners.TRAININGS, NAME: TRAINING})
    monkeypatch.setattr(adapters, "ADAPTERS", {**adapters.ADAPTERS, NAME: camera_adapter})
    return NAME


@pytest.fixture
def data(tmp_path: Path) -> Path:
    greys = np.linspace(0, 255, SCENES).astype(np.uint8)
    np.savez(
        tmp_path / "scenes.npz",
        camera=np.broadcast_to(greys[:, None, None, None], (SCENES, 3, HEIGHT, WIDTH)),
        ego_status=np.ones((SCENES, 4), np.float32),
        driven=np.arange(SCENES),
    )
    return tmp_path


@pytest.fixture
def config_file(tmp_path: Path) -> Path:
    path = tmp_path / "train.yaml"
    path.write_text(f"planner: {NAME}\nsteps: 2\nreport_every: 1\ntensorboard: false\n")
    return path


@pytest.fixture
def trained(second_planner: str, data: Path, config_file: Path, tmp_path: Path) -> Path:
    """The folder of a run of the second planner."""
    out = tmp_path / "run"
    words = ["--planner", second_planner, "--config", config_file]
    assert command("train", data, "--out", out, *words) in ("", "0")
    return out


def test_a_run_creates_checkpoints_and_restores_its_planner(trained: Path, data: Path) -> None:
    saved = load_checkpoint(trained / "checkpoint.pt")
    assert (saved.planner, saved.step, saved.data) == (NAME, 2, {"scenes": SCENES})
    assert [*saved.curve[0]][:3] == ["step", "loss", "cross_entropy"]
    assert 0 <= saved.evaluations[-1]["success"] <= 1

    model = restore_model(saved)
    assert isinstance(model, CameraPlanner)
    assert model.config == CameraConfig(spread=2.0)  # as the data say
    assert model.aim != 5.0  # it learnt

    # The run's config file holds all its settings and resumes it.
    words = ["--config", trained / "config.yaml", "--steps", "3"]
    assert command("train", data, "--out", trained, *words) in ("", "0")
    assert load_checkpoint(trained / "checkpoint.pt").step == 3


def test_a_checkpoint_is_exported_by_its_planners_adapter(trained: Path, tmp_path: Path) -> None:
    out = tmp_path / "bundle"
    assert command("export", trained / "checkpoint.pt", "--out", out) in ("", "0")
    card = load_bundle(out).card
    assert (card.name, card.planner, card.sampler.kind) == (NAME, NAME, "vocabulary")
    camera = np.zeros((3, HEIGHT, WIDTH), np.uint8)
    inputs = {"camera": camera, "ego_status": np.ones(4, np.float32)}
    anchors = LocalClient.of(out, threads=1).plan(inputs=inputs, num_samples=1)
    model = restore_model(load_checkpoint(trained / "checkpoint.pt"))
    assert anchors.trajectories[0, -1, 1] == pytest.approx(4.0 * model.aside[0].item(), rel=1e-5)


def test_an_export_that_is_ended_leaves_nothing(
    trained: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    repository = tmp_path / "bundles"

    def ended(*_: Any, **__: Any) -> None:
        (scratch,) = repository.iterdir()
        assert scratch.name.startswith(".")  # which no service takes for a bundle
        signal.raise_signal(signal.SIGTERM)

    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    monkeypatch.setattr("anchorflow_export.bundle.prove_parity", ended)
    try:
        said = command("export", trained / "checkpoint.pt", "--out", repository / "mine")
        assert signal.getsignal(signal.SIGTERM) is signal.default_int_handler
    finally:
        signal.signal(signal.SIGTERM, before)

    assert said == str(128 + signal.SIGTERM)
    assert list(repository.iterdir()) == []


def test_the_commands_of_flowmp_refuse_another_planner(trained: Path, data: Path) -> None:
    wanted = f"expected a checkpoint of flowmp, got one of {NAME}"
    ends = ["--start", "0,0", "--goal", "1,1"]
    said = command("generate", "--checkpoint", trained / "checkpoint.pt", *ends)
    assert said == f"anchorflow generate: {wanted}"
    said = command("distill", trained / "checkpoint.pt", data, "--out", data / "student")
    assert said == f"anchorflow distill: {wanted}"


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (
            ["--planner", "nobody"],
            f"expected one of {SHIPPED}, tiny_camera, got 'nobody'",
        ),
        (["--planner", "flowmp"], "train.yaml: planner: expected 'flowmp', got 'tiny_camera'"),
        (["--model.variant", "small"], "command line: unknown key 'model.variant'"),
    ],
)
@pytest.mark.usefixtures("second_planner")
def test_a_wrong_planner_is_one_line(
    words: list[str], message: str, data: Path, config_file: Path, tiny_dataset_path: Path
) -> None:
    folder = tiny_dataset_path if "flowmp" in words else data
    said = command("train", folder, "--config", config_file, "--print-config", *words)
    assert said.startswith("anchorflow train: ")
    assert message in said
    assert "\n" not in said


def test_a_file_of_a_planner_that_there_is_not_is_one_line(data: Path, config_file: Path) -> None:
    said = command("train", data, "--config", config_file, "--print-config")
    assert said == f"anchorflow train: planner: expected one of {SHIPPED}, got 'tiny_camera'"


def test_a_checkpoint_of_a_planner_that_there_is_not_is_one_line(
    trained: Path, tmp_path: Path
) -> None:
    path = tmp_path / "other.pt"
    save_checkpoint(path, replace(load_checkpoint(trained / "checkpoint.pt"), planner="goalflux"))
    wanted = f"planner: expected one of {SHIPPED}, tiny_camera, got 'goalflux'"
    with pytest.raises(CheckpointError, match=wanted):
        restore_model(load_checkpoint(path))
    assert command("export", path, "--out", tmp_path / "b") == f"anchorflow export: {wanted}"


def test_a_planner_without_an_adapter_is_one_line(
    trained: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(adapters, "ADAPTERS", {"flowmp": adapters.ADAPTERS["flowmp"]})
    said = command("export", trained / "checkpoint.pt", "--out", tmp_path / "bundle")
    assert said == f"anchorflow export: planner: expected one of flowmp, got {NAME!r}"


def test_the_folder_of_another_planners_run_is_not_gone_on_with(
    trained: Path, tiny_dataset: SceneDataset
) -> None:
    with pytest.raises(CheckpointError, match=f"expected planner '{NAME}'.* got 'flowmp'"):
        CFMTrainer(QUICK, tiny_dataset, trained)


@pytest.mark.usefixtures("second_planner")
def test_what_names_no_planner_is_flowmps(tiny_dataset: SceneDataset, tmp_path: Path) -> None:
    run = CFMTrainer(QUICK, tiny_dataset, tmp_path)
    run.fit()
    saved = torch.load(run.checkpoint_path, weights_only=True)
    assert saved.pop("planner") == "flowmp"
    torch.save(saved, run.checkpoint_path)
    assert restore_model(load_checkpoint(run.checkpoint_path)).config == QUICK.model
    file = tmp_path / "old.yaml"
    file.write_text("steps: 2\n")
    assert planners.training_of(None, file).config is TrainerConfig


def test_the_options_are_those_of_every_planner() -> None:
    app, seen = command_app(), {}

    @app.command()
    @with_settings([TrainerConfig, CameraRunConfig], {})
    def show(**given: Any) -> None:
        seen.update(given)

    help_text = CliRunner().invoke(app, ["--help"], env={"COLUMNS": "300"}).output
    helped = " ".join(help_text.split())
    assert "--steps INTEGER Optimiser steps in all. [default: the planner's]" in helped
    assert re.search(r"--model\.spread \S+ \[default: 1\.0\]", helped)
    assert re.search(r"--model\.variant \S+ \[default: small\]", helped)
    result = CliRunner().invoke(app, ["--model.spread", "3", "--compile"])
    assert result.exit_code == 0, result.output
    assert seen == {"model.spread": "3", "compile": True}

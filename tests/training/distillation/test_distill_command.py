"""`anchorflow distill`, from a teacher's checkpoint to a bundle that plans."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from training_runs import DISTILLATION, QUICK, assert_documented, command

from anchorflow_cli.training import DISTILL_SHORT, distill_app
from anchorflow_export.adapter import PlannerAdapter
from anchorflow_export.bundle import BundleDescription
from anchorflow_training.config import TrainerConfig
from anchorflow_training.dataset import open_dataset
from anchorflow_training.distillation.pairs import DistillConfig
from anchorflow_training.settings import layers, settings
from anchorflow_training.trainer import CFMTrainer

DOCS = Path(__file__).resolve().parents[3] / "docs" / "distillation.md"
FEW = ["--scenes", "2", "--samples", "2", "--teacher.pairs", "2", "--teacher.steps", "1"]


@pytest.fixture(scope="module")
def checkpoint(tiny_dataset_path: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A teacher of one step."""
    settings = replace(QUICK, steps=1, model=DISTILLATION.model)
    dataset = open_dataset(tiny_dataset_path)
    run = CFMTrainer(settings, dataset, tmp_path_factory.mktemp("teacher"))
    run.fit()
    return run.checkpoint_path


def test_a_student_is_taught_and_exported_as_it_was(
    checkpoint: Path,
    tiny_dataset_path: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A student is traced and served in `tests/test_own_data.py`."""
    out, exported = tmp_path / "run", []
    words = [checkpoint, tiny_dataset_path, "--out", out, *FEW, "--no-tensorboard"]
    own = ["--layers", "2", "--schedule", "0,0.8,1", "--cost-weight", "0.5"]
    said = command("distill", *words, "--steps", "2", *own)
    assert said in ("", "0")
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "pairs 1/1"
    assert lines[-1].endswith("checkpoint.pt: step 2")
    found = layers(DistillConfig, {}, out / "config.yaml")
    assert (found.schedule, found.cost_weight) == ((0.0, 0.8, 1.0), 0.5)

    def export(adapter: PlannerAdapter, description: BundleDescription, *, out: Path) -> tuple:
        exported.append((adapter.parts, description.training, out))
        return ()

    monkeypatch.setattr("anchorflow_cli.export.export_bundle", export)
    said = command("export", out / "checkpoint.pt", "--out", tmp_path / "bundle")
    assert said in ("", "0")
    ((parts, training, to),) = exported
    assert to == tmp_path / "bundle"
    assert (parts.sampler.method, parts.sampler.schedule) == ("euler", (0.0, 0.8, 1.0))
    assert training["config"]["method"] == "direct"
    assert len(training["teacher"]["sha256"]) == 64
    limits, ranges = parts.conditioning.limits, parts.conditioning.ranges
    assert (limits.v_max, limits.a_max, limits.horizon_s) == (2.0, 3.0, None)
    assert ranges == {"v_max": (1.0, 3.0), "horizon_s": (4.0, 20.0)}


def test_the_teacher_s_network_and_the_options_make_the_configuration(
    checkpoint: Path, tiny_dataset_path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "distill.yaml"
    file.write_text("method: reflow\nteacher: {pairs: 8}\nmodel: {layers: 1}\n")
    words = ["--print-config", "--config", file, "--layers", "3", "--noise-scale", "1.5"]
    command("distill", checkpoint, tiny_dataset_path, *words)
    file.write_text(capsys.readouterr().out)
    printed = layers(DistillConfig, {}, file)
    assert printed.method == "reflow"
    assert (printed.teacher.pairs, printed.teacher.noise_scale) == (8, 1.5)
    assert (printed.model.layers, printed.model.map_size) == (3, 16)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ([], "--out: expected the folder of the run"),
        (["--schedule", "0.5,1", "--out", "x"], "schedule: expected its first time to be 0"),
        (["--model.degree", "5", "--out", "x"], "model.degree: expected 4, the teacher's"),
        (["--method", "magic"], "method: expected one of reflow, direct, consistency"),
    ],
)
def test_a_wrong_command_is_one_line_and_makes_nothing(
    words: list[str],
    message: str,
    checkpoint: Path,
    tiny_dataset_path: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    said = command("distill", checkpoint, tiny_dataset_path, *words)
    assert message in said
    assert said.startswith("anchorflow distill: ")
    assert "\n" not in said
    assert list(tmp_path.iterdir()) == []


def test_a_teacher_that_is_no_checkpoint_is_named(tiny_dataset_path: Path, tmp_path: Path) -> None:
    file = tmp_path / "teacher.pt"
    file.write_text("nothing of the kind")
    assert "teacher.pt: not a checkpoint" in command(
        "distill", file, tiny_dataset_path, "--out", tmp_path
    )


def test_every_setting_of_its_own_is_an_option_and_stands_in_the_docs() -> None:
    known = {leaf.path: leaf for leaf in settings(TrainerConfig)}
    own = [
        leaf
        for leaf in settings(DistillConfig)
        if leaf.path not in known or known[leaf.path].default != leaf.default
    ]
    assert {leaf.path for leaf in own} >= {"method", "schedule", "teacher.pairs", "learning_rate"}
    assert_documented(own, distill_app, DOCS)
    assert set(DISTILL_SHORT) <= {leaf.path for leaf in settings(DistillConfig)}

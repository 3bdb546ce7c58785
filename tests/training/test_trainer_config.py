"""One configuration from defaults, dataset, file and options; what is wrong is named."""

from __future__ import annotations

import re
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

import pytest
from training_runs import assert_documented, command

from anchorflow_cli.training import TRAIN_SHORT, train_app
from anchorflow_training.config import TrainerConfig
from anchorflow_training.dataset import SceneDataset
from anchorflow_training.planners import TRAININGS, Training
from anchorflow_training.settings import (
    ConfigError,
    build,
    config_text,
    layers,
    other_default,
    setting,
    settings,
)
from anchorflow_training.trainer import CFMTrainer

DOCS = Path(__file__).resolve().parents[2] / "docs" / "training.md"


@dataclass(frozen=True)
class Inner:
    kind: Literal["a", "b"] = "a"
    sizes: tuple[int, ...] = (1, 2)
    pair: tuple[int, float] = (1, 2.0)
    place: str | None = None


@dataclass(frozen=True)
class Outer:
    count: int = setting(1, "", ge=1)
    rate: float = setting(0.5, "", gt=0, lt=1)
    on: bool = False
    inner: Inner = field(default_factory=Inner)


@dataclass(frozen=True)
class Others(Outer):
    count: int = other_default(Outer, "count", 5)


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        ({}, Outer()),
        ({"rate": "1e-3", "count": "7", "on": "true"}, Outer(count=7, rate=1e-3, on=True)),
        ({"inner": {"sizes": [3], "pair": "4,5"}}, Outer(inner=Inner(sizes=(3,), pair=(4, 5.0)))),
        ({"inner": {"kind": "b", "place": "here"}}, Outer(inner=Inner(kind="b", place="here"))),
        ({"inner": {"place": "none"}}, Outer()),
    ],
)
def test_values_are_converted_to_the_fields_types(values: dict[str, Any], expected: Outer) -> None:
    built = build(Outer, values, source="file.yaml")
    assert built == expected
    assert [type(v) for v in asdict(built).values()] == [type(v) for v in asdict(expected).values()]


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"coutn": 1}, "unknown key 'coutn'; did you mean 'count'"),
        ({"inner": {"zzz": 1}}, "unknown key 'inner.zzz'; known: kind, sizes, pair, place"),
        ({"count": 0}, "count: expected at least 1, got 0"),
        ({"count": 1.5}, "count: expected a whole number, got 1.5"),
        ({"count": True}, "count: expected a whole number, got True"),
        ({"rate": "fast"}, "rate: expected a number, got 'fast'"),
        ({"rate": 1.0}, "rate: expected less than 1, got 1.0"),
        ({"rate": "nan"}, "rate: expected a finite number, got 'nan'"),
        ({"rate": 0}, "rate: expected more than 0, got 0"),
        ({"on": "maybe"}, "on: expected true or false, got 'maybe'"),
        ({"inner": {"kind": "c"}}, "inner.kind: expected one of a, b, got 'c'"),
        ({"inner": {"pair": [1]}}, "inner.pair: expected 2 values, got [1]"),
        ({"inner": 3}, "inner: expected keys and values, got 3"),
        ({"rate": 10**400}, "rate: expected a number, got 1000"),
    ],
)
def test_what_is_wrong_is_named_with_its_file(values: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=re.escape(f"file.yaml: {message}")):
        build(Outer, values, source="file.yaml")


def test_another_default_keeps_what_was_said_of_a_setting() -> None:
    assert build(Others, {}, source="file.yaml").count == 5
    with pytest.raises(ConfigError, match="count: expected at least 1, got 0"):
        build(Others, {"count": 0}, source="file.yaml")


@pytest.mark.parametrize("training", TRAININGS.values(), ids=[*TRAININGS])
def test_every_planner_bounds_and_explains_the_common_settings(training: Training) -> None:
    for name, wrong in {"steps": 0, "learning_rate": -1.0, "warmup": -3}.items():
        with pytest.raises(ConfigError, match=f"{name}: expected "):
            build(training.config, {name: wrong}, source="file.yaml")
    assert all(entry.about for entry in settings(training.config) if "." not in entry.path)


def layered(
    dataset: SceneDataset, file: Path | None = None, options: dict[str, Any] | None = None
) -> TrainerConfig:
    return layers(TrainerConfig, {"model": CFMTrainer.model_settings(dataset)}, file, options)


def test_each_layer_goes_over_the_one_before(tiny_dataset: SceneDataset, tmp_path: Path) -> None:
    file = tmp_path / "train.yaml"
    file.write_text("learning_rate: 1e-4\nbatch:\n  scenes: 4\n  samples: 2\n")
    config = layered(tiny_dataset, file, {"batch.scenes": "3", "compile": True})
    assert config.learning_rate == 1e-4
    assert (config.batch.scenes, config.batch.samples) == (3, 2)
    assert config.compile
    assert config.warmup == TrainerConfig().warmup


@pytest.mark.parametrize(
    ("planner", "path"),
    [("v2x_vlm", "evaluation.held_out"), ("wote", "batch.samples"), ("goalflow", "batch.mirror")],
)
def test_what_a_planner_has_no_use_for_is_refused(planner: str, path: str) -> None:
    with pytest.raises(ConfigError, match=f"unknown key '{path}'"):
        layers(TRAININGS[planner].config, {}, options={path: "1"})


def test_the_model_has_the_datasets_shape(tiny_dataset: SceneDataset) -> None:
    model = layered(tiny_dataset).model
    assert (model.num_steps, model.dim, model.map_channels) == (64, 2, 3)
    assert layered(tiny_dataset, options={"model.degree": "5"}).model.degree == 5


def test_the_printed_configuration_reads_back_as_itself(
    tiny_dataset: SceneDataset, tmp_path: Path
) -> None:
    config = layered(tiny_dataset, options={"evaluation.held_out": "2", "ema_decay": "0.5"})
    file = tmp_path / "train.yaml"
    file.write_text(config_text(config))
    assert layered(tiny_dataset, file) == config


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("batch:\n  scnes: 3", "unknown key 'batch.scnes'; did you mean 'scenes'"),
        ("- 1", "expected keys and values, got list"),
        ("a: [", "while parsing"),
        ("model:\n  variant: huge", "variant"),
    ],
)
def test_a_wrong_file_is_named(
    text: str, message: str, tiny_dataset: SceneDataset, tmp_path: Path
) -> None:
    file = tmp_path / "train.yaml"
    file.write_text(text)
    with pytest.raises(ConfigError, match=re.escape(message)):
        layered(tiny_dataset, file)
    with pytest.raises(ConfigError, match=r"absent\.yaml"):
        layered(tiny_dataset, tmp_path / "absent.yaml")


def test_every_setting_is_an_option_and_stands_in_the_docs() -> None:
    leaves = list(settings(TrainerConfig))
    assert len(leaves) > 30
    assert_documented(leaves, train_app, DOCS)
    assert set(TRAIN_SHORT) <= {leaf.path for leaf in leaves}
    section = DOCS.read_text().partition("\n## Every setting\n")[2].partition("\n## ")[0]
    assert {*re.findall(r"^\| `([^`]+)`", section, re.MULTILINE)} == {leaf.path for leaf in leaves}


def test_print_config_prints_and_trains_nothing(
    tiny_dataset_path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["--scenes", "3", "--flow.weights.lambda-vel", "0.7", "--no-tensorboard"]
    command("train", tiny_dataset_path, "--print-config", "--out", tmp_path / "run", *words)
    text = capsys.readouterr().out
    file = tmp_path / "train.yaml"
    file.write_text(text)
    config = layers(TrainerConfig, {}, file)
    assert (config.batch.scenes, config.flow.weights.lambda_vel) == (3, 0.7)
    assert not config.tensorboard
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--print-config", "--batch.scenes", "many"], "batch.scenes: expected a whole number"),
        ([], "--out: expected the folder of the run"),
        (["--config", "absent.yaml"], "absent.yaml"),
        (["--flow.weights.lambda-vel", "-1"], "lambda_vel: expected at least 0, got -1"),
        (["--held-out", "6", "--out", "run"], "held_out: expected less than 6"),
        (
            ["--bfloat16", "--precision", "float32", "--out", "run"],
            "precision: expected --bfloat16 alone, got float32 beside it",
        ),
    ],
)
def test_a_wrong_command_is_one_line_and_makes_nothing(
    words: list[str],
    message: str,
    tiny_dataset_path: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    said = command("train", tiny_dataset_path, *words)
    assert message in said
    assert said.startswith("anchorflow train: ")
    assert "\n" not in said
    assert list(tmp_path.iterdir()) == []


def test_without_a_terminal_each_report_is_a_plain_line(
    tiny_dataset_path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "train.yaml"
    file.write_text(
        "steps: 2\nreport_every: 1\nbatch: {scenes: 2, samples: 2}\ntensorboard: false\n"
        "evaluation: {held_out: 2, samples: 2, steps: 1, pictures: 0, every: 2}\n"
        "model: {map_size: 16, feature_channels: 4}\n"
    )
    out = tmp_path / "run"
    assert command("train", tiny_dataset_path, "--out", out, "--config", file) in ("", "0")
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[:3] for line in lines[:2]] == [["step", str(n), "loss"] for n in (1, 2)]
    assert lines[2].startswith("step 2 success ")
    told = (
        r"checkpoint\.pt: step 2; success on what is held out \S+, best \S+ at step 2 \(best\.pt\)$"
    )
    assert re.search(told, lines[-1])
    assert layers(TrainerConfig, {}, out / "config.yaml").steps == 2

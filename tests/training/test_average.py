"""The mean of checkpoints, and a run that begins with another's weights."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path

import pytest
import torch
import yaml
from training_runs import QUICK

from anchorflow_cli.main import main
from anchorflow_training.checkpoint import (
    CheckpointError,
    load_checkpoint,
    mean_checkpoint,
    provenance,
    restore_model,
    save_checkpoint,
)
from anchorflow_training.dataset import SceneDataset
from anchorflow_training.settings import ConfigError
from anchorflow_training.trainer import CFMTrainer, TrainerConfig

TWO = replace(QUICK.model, layers=2)


@pytest.fixture
def first(tiny_dataset: SceneDataset, tmp_path: Path) -> Path:
    return trained(QUICK, tiny_dataset, tmp_path / "first")


def trained(config: TrainerConfig, data: SceneDataset, out: Path) -> Path:
    CFMTrainer(config, data, out).fit()
    return out / "checkpoint.pt"


def test_a_run_begins_with_the_averaged_weights_of_the_one_before(
    first: Path, tiny_dataset: SceneDataset, tmp_path: Path
) -> None:
    begun = CFMTrainer(replace(QUICK, before=str(first)), tiny_dataset, tmp_path / "next")
    assert begun.step == 0
    wanted = load_checkpoint(first).average
    assert any(not torch.equal(wanted[n], w) for n, w in load_checkpoint(first).model.items())
    for name, weight in begun.model.state_dict().items():
        torch.testing.assert_close(weight, wanted[name], rtol=0, atol=0)


def test_a_run_has_the_network_of_the_one_before_unless_it_says_otherwise(
    first: Path,
    write_dataset: Callable[[Path], Path],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    data, file = write_dataset(tmp_path / "data"), tmp_path / "train.yaml"
    file.write_text(f"before: {first}\n")
    distilled = ["distill", str(first), str(data)]
    for words, wanted in (
        (["train", str(data), "--before", str(first)], QUICK.model),
        (["train", str(data), "--config", str(file)], QUICK.model),
        ([*distilled, "--config", str(file)], QUICK.model),
        (["train", str(data), "--before", str(first), "--model.layers", "2"], TWO),
        ([*distilled, "--model.layers", "2"], TWO),
    ):
        with pytest.raises(SystemExit) as end:
            main([*words, "--print-config"])
        assert not end.value.code
        assert yaml.safe_load(capsys.readouterr().out)["model"] == asdict(wanted), words


def test_a_run_begins_with_no_other_planner_and_no_other_network(
    first: Path, tiny_dataset: SceneDataset, tmp_path: Path
) -> None:
    after = replace(QUICK, before=str(first))
    other = replace(after, model=replace(QUICK.model, feature_channels=6))
    with pytest.raises(ConfigError, match=r"before: .*expected model\.feature_channels 6, got 4"):
        CFMTrainer(other, tiny_dataset, tmp_path / "other")
    save_checkpoint(first, replace(load_checkpoint(first), planner="wote"))
    with pytest.raises(ConfigError, match=r"before: .*checkpoint of flowmp, got one of wote"):
        CFMTrainer(after, tiny_dataset, tmp_path / "wote")


def test_a_mean_is_half_of_each_and_says_whose_it_is(
    first: Path, tiny_dataset: SceneDataset, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    longer = replace(QUICK, steps=3, before=str(first))
    second = trained(longer, tiny_dataset, tmp_path / "second")
    out = tmp_path / "mean.pt"
    with pytest.raises(SystemExit) as end:
        main(["average", str(first), str(second), "--out", str(out)])
    assert not end.value.code
    assert capsys.readouterr().out.strip() == str(out)
    one, two, mean = load_checkpoint(first), load_checkpoint(second), load_checkpoint(out)
    for name, weight in mean.average.items():
        torch.testing.assert_close(weight, (one.average[name] + two.average[name]) / 2)
    assert mean.config == asdict(longer)
    restore_model(mean)
    told = provenance(mean)["mean_of"]
    assert told == [{"steps": 2, "data": one.data}, {"steps": 3, "data": two.data}]
    assert "mean_of" not in provenance(two)


def test_a_mean_of_what_does_not_fit_is_refused(
    first: Path, tiny_dataset: SceneDataset, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    wide = replace(QUICK, model=replace(QUICK.model, feature_channels=6))
    other = trained(wide, tiny_dataset, tmp_path / "wide")
    with pytest.raises(CheckpointError, match=r"first.*expected model\.feature_channels 6, got 4"):
        mean_checkpoint([first, other])
    save_checkpoint(other, replace(load_checkpoint(other), planner="wote"))
    with pytest.raises(CheckpointError, match=r"wide.*expected flowmp, got wote"):
        mean_checkpoint([other, first])
    with pytest.raises(SystemExit):
        main(["average", str(first), "--out", str(tmp_path / "mean.pt")])
    assert "expected two or more" in capsys.readouterr().err


def test_a_mean_is_of_one_tokenizer(first: Path, tmp_path: Path) -> None:
    saved = load_checkpoint(first)

    def knowing(words: bytes, *, steps: int) -> Path:
        own = {
            "_extra_state": torch.tensor([*words], dtype=torch.uint8),
            "norm.num_batches_tracked": torch.tensor(steps),  # is no reason to refuse
        }
        path = tmp_path / f"{steps}.pt"
        save_checkpoint(path, replace(saved, average={**saved.average, **own}))
        return path

    one, other, same = (knowing(w, steps=s) for s, w in enumerate((b"one", b"two", b"two")))
    with pytest.raises(CheckpointError, match=r"0\.pt: expected the tokenizer of .*1\.pt, got an"):
        mean_checkpoint([one, other])
    mean_checkpoint([other, same])


def test_a_file_of_something_else_is_no_checkpoint(first: Path, tmp_path: Path) -> None:
    (tmp_path / "text.pt").write_text("weights")
    (tmp_path / "cut.pt").write_bytes(first.read_bytes()[:1000])
    for name in ("text.pt", "cut.pt"):
        with pytest.raises(CheckpointError) as caught:
            load_checkpoint(tmp_path / name)
        assert str(caught.value) == (
            f"{tmp_path / name}: not a checkpoint, or one that is cut short"
        )
    with pytest.raises(CheckpointError, match="Is a directory"):
        load_checkpoint(tmp_path)

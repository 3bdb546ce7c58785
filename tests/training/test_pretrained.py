"""Seeing begins with ResNet weights from a folder, or with what another planner learnt."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from small_configs import BACKBONE as SMALL
from tiny_diffusiondrive import TINY as TINY_DIFFUSIONDRIVE, tiny_diffusiondrive
from tiny_wote import TINY as TINY_WOTE, tiny_wote
from torch import nn
from transformers import ResNetBackbone, ResNetConfig

from anchorflow_models.transfuser import TransfuserBackbone
from anchorflow_training.checkpoint import Checkpoint, save_checkpoint
from anchorflow_training.pretrained import (
    FIRST,
    folded_normalisation,
    load_resnet,
    load_sight,
    measure_normalisation,
    sight_of,
)
from anchorflow_training.settings import ConfigError


@pytest.fixture
def resnet(tmp_path: Path) -> tuple[Path, ResNetBackbone]:
    """A folder as `transformers` writes it, and what is in it."""
    torch.manual_seed(0)
    network = ResNetBackbone(
        ResNetConfig(
            embedding_size=SMALL.stem_width,
            hidden_sizes=[*SMALL.widths],
            depths=[*SMALL.depths],
            layer_type="basic",
        )
    )
    network.save_pretrained(tmp_path / "resnet")
    return tmp_path / "resnet", network


def test_both_networks_begin_with_the_folders_weights(
    resnet: tuple[Path, ResNetBackbone],
) -> None:
    folder, network = resnet
    backbone, wanted = TransfuserBackbone(SMALL), network.state_dict()
    load_resnet(backbone, folder)
    for name, weight in backbone.image.state_dict().items():
        torch.testing.assert_close(weight, wanted[name], msg=name)
    lidar = backbone.lidar.state_dict()
    torch.testing.assert_close(lidar[FIRST][:, 0], wanted[FIRST].sum(1))
    assert not lidar[FIRST][:, 1:].any()
    assert all(torch.equal(lidar[name], wanted[name]) for name in wanted if name != FIRST)


def test_a_resnet_of_another_shape_is_named(resnet: tuple[Path, ResNetBackbone]) -> None:
    wide = replace(SMALL, widths=(16, 32, 64, 128))
    with pytest.raises(ConfigError, match="resnet: its ResNet does not fit the backbone"):
        load_resnet(TransfuserBackbone(wide), resnet[0])


def test_a_folder_without_one_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"expected a ResNet's config.json and model.safetensors"):
        load_resnet(TransfuserBackbone(SMALL), tmp_path)


def test_folded_normalisation_is_measured_and_changes_nothing() -> None:
    """Weights of a bundle compute the same before and after, and while the network trains too."""
    torch.manual_seed(0)
    model = tiny_wote(TINY_WOTE).eval()
    parts = [part for part in model.modules() if isinstance(part, nn.BatchNorm2d)]
    for part in parts:
        nn.init.normal_(part.bias)
        nn.init.constant_(part.state_dict()["running_var"], 1.0 - part.eps)
    size = TINY_WOTE.backbone
    rng = np.random.default_rng(0)
    batch = {
        "camera": rng.integers(0, 256, (4, 3, size.image_height, size.image_width), dtype=np.uint8),
        "lidar": rng.random((4, 1, size.lidar_size, size.lidar_size), dtype=np.float32),
        "ego_status": rng.random((4, 8), dtype=np.float32),
    }
    tensors = [torch.from_numpy(each) for each in batch.values()]

    def seen() -> torch.Tensor:
        return model.encode(*tensors)["bev_tokens"].detach()

    before = seen()
    assert folded_normalisation(model) == parts
    measure_normalisation(model.train(), [batch])
    assert model.training
    assert not folded_normalisation(model)
    torch.testing.assert_close(model.eval() and seen(), before, rtol=1e-3, atol=1e-4)
    for part in parts:
        part.train()
    torch.testing.assert_close(seen(), before, rtol=1e-2, atol=1e-3)


EYES = replace(TINY_WOTE.backbone, lidar_before=True, lidar_size=64)
MET = ((0.0, 0.0),)


def saved(model: nn.Module, path: Path) -> Path:
    checkpoint = Checkpoint(
        step=1, config={}, data={}, model={}, average=model.state_dict(), optimiser={}, curve=[]
    )
    save_checkpoint(path, checkpoint)
    return path


@pytest.mark.parametrize("learnt", ["wote", "diffusiondrive"])
def test_either_planner_begins_with_the_others_perception(learnt: str, tmp_path: Path) -> None:
    told = {"backbone": EYES, "encounters": MET, "ground_sight": True}
    models: dict[str, nn.Module] = {
        "wote": tiny_wote(replace(TINY_WOTE, **told)),
        "diffusiondrive": tiny_diffusiondrive(replace(TINY_DIFFUSIONDRIVE, **told)),
    }
    first = models.pop(learnt)
    (second,) = models.values()
    with torch.no_grad():
        for weight in first.parameters():
            weight.add_(torch.rand_like(weight))
    before = {name: value.clone() for name, value in second.state_dict().items()}
    load_sight(sight_of(second), saved(first, tmp_path / "first.pt"))
    parts = sight_of(first)
    assert set(parts) == {"backbone", "ground", "sweeps", "far"}
    for name, part in sight_of(second).items():
        torch.testing.assert_close(part.state_dict(), parts[name].state_dict(), rtol=0, atol=0)
    seen = {id(weight) for part in sight_of(second).values() for weight in part.parameters()}
    own = [name for name, weight in second.named_parameters() if id(weight) not in seen]
    assert own
    assert all(torch.equal(second.state_dict()[name], before[name]) for name in own)


def test_a_part_that_the_other_has_not_stays_as_it_is(tmp_path: Path) -> None:
    path = saved(tiny_wote(replace(TINY_WOTE, backbone=EYES)), tmp_path / "blind.pt")
    sees = tiny_wote(replace(TINY_WOTE, backbone=EYES, encounters=MET))
    before = {name: value.clone() for name, value in sight_of(sees)["far"].state_dict().items()}
    load_sight(sight_of(sees), path)
    torch.testing.assert_close(sight_of(sees)["far"].state_dict(), before, rtol=0, atol=0)


def test_a_perception_of_another_shape_is_named(tmp_path: Path) -> None:
    path = saved(tiny_diffusiondrive(), tmp_path / "small.pt")
    with pytest.raises(ConfigError, match=r"perception: .*small.pt: its backbone does not fit"):
        load_sight(sight_of(tiny_wote()), path)
    path = saved(nn.Linear(2, 2), tmp_path / "none.pt")
    with pytest.raises(ConfigError, match=r"perception: .*none.pt: its backbone does not fit"):
        load_sight(sight_of(tiny_wote()), path)

"""A backbone begins with ResNet weights from a folder."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
import torch
from transformers import ResNetBackbone, ResNetConfig

from anchorflow_models.transfuser import TransfuserBackbone, small_transfuser
from anchorflow_training.pretrained import FIRST, load_resnet
from anchorflow_training.settings import ConfigError

SMALL = small_transfuser()


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

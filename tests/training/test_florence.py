"""Published Florence-2 folders, in small: both layouts are read whole, broken ones named."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from command_line import failure, succeed
from small_configs import EXAMPLES
from small_v2x import PROMPTS, small_sizes
from torch import Tensor
from transformers import Florence2ForConditionalGeneration

from anchorflow_driving.cooperative.crossings import draw_crossing
from anchorflow_driving.cooperative.layout import write_recording
from anchorflow_models.v2x_vlm import V2XVLM, V2XConfig
from anchorflow_models.v2x_vlm.config import END, PAD, florence_config
from anchorflow_training.checkpoint import load_checkpoint
from anchorflow_training.settings import ConfigError
from anchorflow_training.v2x.florence import TABLES, load_pretrained
from anchorflow_training.v2x.text import opened, train_tokenizer

TOKENIZER = train_tokenizer(PROMPTS)
WORDS = opened(TOKENIZER).get_vocab_size()
CONFIG = V2XConfig(image_size=64, vocabulary=WORDS, max_tokens=64, positions=200)
MICROSOFT = (
    (".conv.", ".proj."),
    (".conv1.", ".conv1.fn.dw."),
    (".conv2.", ".conv2.fn.dw."),
    ("spatial_block.norm1.", "spatial_block.window_attn.norm."),
    ("channel_block.norm1.", "channel_block.channel_attn.norm."),
    ("block.norm2.", "block.ffn.norm."),
    ("_attn.qkv.", "_attn.fn.qkv."),
    ("_attn.proj.", "_attn.fn.proj."),
    ("ffn.fc", "ffn.fn.net.fc"),
    ("model.vision_tower.", "vision_tower."),
    ("model.multi_modal_projector.image_projection.weight", "image_projection"),
    ("model.multi_modal_projector.image_position_embed.", "image_pos_embed."),
    ("model.multi_modal_projector.", ""),
    ("model.language_model.", "language_model.model."),
    ("lm_head.", "language_model.lm_head."),
)
"""The converter of `transformers` backwards."""
CONVERTED = {  # some of the names that the converter reads
    "image_projection",
    "language_model.model.decoder.layers.0.encoder_attn.k_proj.weight",
    "vision_tower.blocks.0.0.spatial_block.conv1.fn.dw.weight",
    "vision_tower.blocks.2.0.channel_block.channel_attn.fn.proj.weight",
    "vision_tower.blocks.3.0.channel_block.ffn.norm.weight",
    "vision_tower.convs.3.proj.weight",
    "visual_temporal_embed.pos_idx_to_embed",
}


@pytest.fixture(autouse=True)
def _small() -> Iterator[None]:
    with small_sizes():
        yield


def published(words: int) -> Florence2ForConditionalGeneration:
    """Weights that float16 holds, of more words and positions than the network has."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        settings = florence_config(replace(CONFIG, vocabulary=words, positions=1100))
        return Florence2ForConditionalGeneration(settings).half().float().eval()


def write_converted(folder: Path) -> Florence2ForConditionalGeneration:
    """As the converter ends: a token for pictures, a table padded to 64 rows, float16."""
    florence = published(WORDS)
    florence.resize_token_embeddings(WORDS + 1, 64, mean_resizing=False)
    assert len(florence.lm_head.weight) % 64 == 0
    florence.half().save_pretrained(folder)
    (folder / "tokenizer.json").write_bytes(TOKENIZER)
    return florence.float()


def write_microsofts(folder: Path) -> Florence2ForConditionalGeneration:
    """As remote code keeps it, with tokens that tokenizer.json lacks."""
    florence = published(WORDS + 24)
    weights: dict[str, Tensor] = {"language_model.final_logits_bias": torch.zeros(1, WORDS + 24)}
    for name, value in florence.state_dict().items():
        for own, theirs in MICROSOFT:
            name = name.replace(own, theirs)
        weights[name] = (value.T if name == "image_projection" else value).half().contiguous()
    assert weights.keys() >= CONVERTED
    folder.mkdir()
    torch.save(weights, folder / "pytorch_model.bin")
    (folder / "tokenizer.json").write_bytes(TOKENIZER)
    settings = florence.config.to_dict()
    vision = settings["vision_config"]
    for name in ("in_channels", "mlp_ratio", "qkv_bias", "activation_function"):
        del vision[name]
    positions, times = (vision.pop(f"max_{kind}_embeddings") for kind in ("position", "temporal"))
    vision |= {
        "model_type": "davit",
        "dim_embed": vision.pop("embed_dim"),
        "image_pos_embed": {"max_pos_embeddings": positions},
        "visual_temporal_embedding": {"max_temporal_embeddings": times},
        "image_feature_source": ["spatial_avg_pool", "temporal_avg_pool"],
    }
    settings["text_config"] |= {"model_type": "florence2_language", "output_attentions": True}
    (folder / "config.json").write_text(json.dumps(settings))
    return florence


@pytest.fixture
def model() -> V2XVLM:
    model = V2XVLM(CONFIG)
    model.tokenizer = TOKENIZER
    return model.eval()


@pytest.mark.parametrize("write", [write_converted, write_microsofts])
@torch.no_grad()
def test_every_tensor_of_a_published_folder_is_read(
    write: Callable[[Path], Florence2ForConditionalGeneration], model: V2XVLM, tmp_path: Path
) -> None:
    theirs = write(tmp_path / "folder")
    load_pretrained(model, tmp_path / "folder")

    wanted = theirs.state_dict()
    for name, value in model.florence.state_dict().items():
        expected = wanted.pop(name)[: len(value) if name in TABLES else None]
        torch.testing.assert_close(value, expected, atol=0, rtol=0, msg=name)
    assert not wanted
    pixels = torch.randn(2, 3, 64, 64)
    cells = torch.full((2, CONFIG.cells**2 + 1), PAD)
    words = torch.randint(4, WORDS, (2, 9))
    asked = {"input_ids": torch.cat([cells, words], 1), "pixel_values": pixels}
    asked |= {"decoder_input_ids": torch.cat([words[:, :1] * 0 + END, words], 1)}
    got, expected = (each(**asked).logits[..., :WORDS] for each in (model.florence, theirs))
    torch.testing.assert_close(got, expected, atol=1e-5, rtol=0)


def edited(change: Callable[[dict[str, Any], dict[str, Tensor]], object]) -> Callable:
    """Change the settings and the weights of a folder."""

    def edit(folder: Path) -> None:
        settings = json.loads((folder / "config.json").read_text())
        weights = torch.load(folder / "pytorch_model.bin")
        change(settings, weights)
        (folder / "config.json").write_text(json.dumps(settings))
        torch.save(weights, folder / "pytorch_model.bin")

    return edit


def removed(name: str) -> Callable[[Path], None]:
    return lambda folder: (folder / name).unlink()


def cut_short(folder: Path) -> None:
    file = folder / "pytorch_model.bin"
    file.write_bytes(file.read_bytes()[:-3000])


NORM = "image_proj_norm.bias"
BROKEN: dict[str, tuple[Callable[[Path], Any], str]] = {
    "missing key": (
        edited(lambda _, weights: weights.pop(NORM)),
        rf"without model\.multi_modal_projector\.{NORM}, and with nothing",
    ),
    "extra key": (
        edited(lambda _, weights: weights.update({"vision_tower.norms.bias": torch.ones(3)})),
        r"without nothing, and with model\.vision_tower\.norms\.bias",
    ),
    "wrong shape": (
        edited(lambda _, weights: weights.update({NORM: torch.zeros(7)})),
        rf"{NORM}: expected floating-point numbers \[32\], found torch.float32 \[7\]",
    ),
    "a table of another vocabulary than its settings say": (
        edited(lambda settings, _: settings["text_config"].update(vocab_size=WORDS + 25)),
        rf"weight: expected {WORDS + 25} rows, by vocab_size of .*, found \[{WORDS + 24}, 32\]",
    ),
    "too few words": (
        edited(lambda settings, _: settings["text_config"].update(vocab_size=9)),
        rf"text_config\.vocab_size: expected {WORDS} or more, found 9",
    ),
    "another depth": (
        edited(lambda settings, _: settings["vision_config"].update(depths=[1, 1, 9, 1])),
        r"vision_config\.depths: expected \[1, 1, 1, 1\], found \[1, 1, 9, 1\]",
    ),
    "another model": (
        edited(lambda settings, _: settings.update(model_type="kosmos-2")),
        r"config\.json: model_type: expected florence2, found 'kosmos-2'",
    ),
    "truncated": (cut_short, "pytorch_model.bin: expected weights, found another file or one that"),
    "no config.json": (removed("config.json"), "config.json: expected the settings of a Florence"),
    "no tokenizer": (removed("tokenizer.json"), "tokenizer.json: expected a tokenizer"),
    "another tokenizer": (
        lambda folder: (folder / "tokenizer.json").write_bytes(train_tokenizer(["Turn left."])),
        "tokenizer.json: expected the pairs' tokenizer, .* found another",
    ),
}


@pytest.mark.parametrize("case", BROKEN)
def test_a_folder_that_does_not_fit_is_named(case: str, model: V2XVLM, tmp_path: Path) -> None:
    write_microsofts(tmp_path / "folder")
    spoil, words = BROKEN[case]
    spoil(tmp_path / "folder")
    with pytest.raises(ConfigError, match=f"^pretrained: {tmp_path}.*{words}"):
        load_pretrained(model, tmp_path / "folder")


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("v2x") / "recording"
    write_recording(folder, ((str(n), draw_crossing(n, size=(48, 32)).frames) for n in range(3)))
    return folder


def test_descriptions_reach_the_published_training(recording: Path, tmp_path: Path) -> None:
    """By the commands and the preset, from a folder in Microsoft's layout to two steps."""
    folder, file, pairs = tmp_path / "folder", tmp_path / "texts.jsonl", tmp_path / "pairs"
    wanted = write_microsofts(folder).state_dict()
    whole: list[str] = []
    for kept in (None, -3):  # the second time it goes on after a run that broke off
        file.write_text("".join(whole[:kept]))
        given = ("--florence", folder, "--image-size", 64)
        succeed("data", "descriptions", recording, file, *given)
        whole, before = file.read_text().splitlines(keepends=True), whole
    assert sorted(whole) == sorted(before)
    rows = [json.loads(line) for line in whole]
    assert len({row["picture"] for row in rows}) == len(rows) == 15

    made = ("data", "pairs", recording, pairs, "--image-size", 64, "--tokenizer", folder)
    for spoilt, words in (
        (whole[1:], f"expected a description of {rows[0]['picture']}, found none"),
        (['{"picture": 1}'], "line 1: expected an object of picture and description"),
    ):
        file.write_text("".join(spoilt))
        assert words in failure(*made, "--descriptions", file)
    told = "The ego vehicle drives. " * 43  # 258 tokens, which a large Florence-2 would tell
    file.write_text("".join(json.dumps({**row, "description": told}) + "\n" for row in rows))
    succeed(*made, "--descriptions", file)
    assert json.loads((pairs / "dataset.json").read_text())["prompts"][0].startswith(told)

    preset = ("--config", EXAMPLES / "v2x-vlm-published.yaml", "--pretrained", folder)
    train = ("train", pairs, *preset, "--variant", "tiny", "--warmup", 1, "--report-every", 1)
    assert "model.max_tokens: expected at least 2" in failure(
        *train, "--out", tmp_path / "short", "--model.max-tokens", 64
    )
    succeed(*train, "--out", tmp_path / "run", "--epochs", 2)
    saved = load_checkpoint(tmp_path / "run" / "checkpoint.pt")
    assert [row["step"] for row in saved.evaluations] == [2, 4]  # 10 pairs in batches of 4
    assert all(0 < row["loss"] < 1000 for row in saved.evaluations)
    assert [row["learning_rate"] for row in saved.curve] == [1e-6] * 4
    assert all(row["next_token"] > 0 for row in saved.curve)
    for name, value in saved.average.items():
        if name.startswith("florence."):
            before = wanted[name.removeprefix("florence.")][: len(value)]
            frozen = "vision_tower" in name or "pos_idx_to_embed" in name
            assert torch.equal(value, before) == frozen, name

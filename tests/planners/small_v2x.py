"""V2X-VLM with a Florence-2 so small that it is traced in seconds, its weights drawn at random."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any
from unittest.mock import patch

import torch

from anchorflow_models.v2x_vlm import V2XVLM, V2XConfig, config as sizes, create_v2x_vlm
from anchorflow_training.v2x.text import opened, train_tokenizer

SMALL = sizes.FlorenceSize(
    (16, 16, 16, 32), (1, 1, 1, 2), (1, 1, 1, 1), 6, 0.0, 32, 1, 1, 2, dropout=0.0
)
PROMPTS = [f"The ego vehicle drives at {speed}.5 m/s. Plan its path." for speed in range(20)]
IMAGE_SIZE = 64


@contextmanager
def small_sizes() -> Iterator[None]:
    """Inside the block "tiny" is smaller still."""
    with patch.object(sizes, "SIZES", {**sizes.SIZES, "tiny": SMALL}):
        yield


def small_v2x(**changed: Any) -> V2XVLM:
    """A network that gives waypoints of some metres, each time the same."""
    tokenizer = train_tokenizer(PROMPTS)
    vocabulary = opened(tokenizer).get_vocab_size()
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        config = V2XConfig(image_size=IMAGE_SIZE, vocabulary=vocabulary, max_tokens=64, **changed)
        model = create_v2x_vlm(config)
        torch.nn.init.normal_(model.absent)
    model.tokenizer = tokenizer
    times = torch.arange(1, config.waypoints + 1) * config.dt
    model.mean.copy_(torch.stack([8 * times, 0.2 * times**2], -1))
    model.scale.fill_(3.0)
    return model.eval()

"""Describes the car's pictures of a recording by a published Florence-2, for `data pairs`."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from anchorflow_client.sensors import resized
from anchorflow_models.layers.blocks import PIXEL_MEAN, PIXEL_SPREAD
from anchorflow_models.v2x_vlm.config import BEGIN
from anchorflow_training.atomic_write import writing
from anchorflow_training.dataset import DatasetError
from anchorflow_training.v2x.florence import load_florence
from anchorflow_training.v2x.recording import read_picture, read_recording
from anchorflow_training.v2x.text import opened, read_descriptions, read_tokenizer

DETAILED_CAPTION = "Describe in detail what is shown in the image."
"""The prompt that Florence-2 was trained on for its task <DETAILED_CAPTION>."""
MAX_TOKENS = 256
"""The longest description."""
REPEATED = 3
"""Tokens in a row that no description has twice, by the published settings."""
BATCH = 4


class Captioner:
    """A Florence-2 that describes pictures, on a GPU if there is one.

    folder: a published one; image_size: pixels along a side; Florence-2's own are 768

    Raises `ConfigError` if the folder cannot be read; `DatasetError` if it has no tokenizer.
    """

    def __init__(self, folder: Path, *, image_size: int = 768) -> None:
        self.image_size = image_size
        self.device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
        self.tokenizer = opened(read_tokenizer(folder))
        self.florence = load_florence(folder)
        self.florence.to(device=self.device)  # type: ignore[arg-type]

    @torch.no_grad()
    def describe(self, pictures: list[NDArray[np.uint8]]) -> list[str]:
        """A text of each picture uint8 [3,H,W], of the likeliest token after token."""
        from transformers.modeling_outputs import BaseModelOutput

        pixels = np.stack([resized(each, self.image_size) for each in pictures])
        mean, spread = (torch.tensor(each).view(3, 1, 1) for each in (PIXEL_MEAN, PIXEL_SPREAD))
        scaled = (torch.from_numpy(pixels).float() / 255 - mean) / spread
        model = self.florence.model
        features = model.vision_tower(scaled.to(self.device)).last_hidden_state
        asked = torch.tensor(self.tokenizer.encode(DETAILED_CAPTION).ids, device=self.device)
        words = model.language_model.encoder.embed_tokens(asked.expand(len(pixels), -1))
        inputs = torch.cat([model.multi_modal_projector(features), words], 1)
        hidden = model.language_model.encoder(inputs_embeds=inputs).last_hidden_state
        texts = self.florence.generate(  # type: ignore[attr-defined]
            encoder_outputs=BaseModelOutput(last_hidden_state=hidden),
            attention_mask=torch.ones(hidden.shape[:2], dtype=torch.long, device=self.device),
            max_new_tokens=MAX_TOKENS,
            do_sample=False,
            num_beams=1,
            no_repeat_ngram_size=REPEATED,
            forced_bos_token_id=BEGIN,
        )
        known = self.tokenizer.get_vocab_size()
        return [
            " ".join(self.tokenizer.decode([word for word in ids if word < known]).split())
            for ids in texts.tolist()
        ]


def describe_recording(
    recording: Path,
    file: Path,
    captioner: Captioner,
    *,
    progress: Callable[[int, int], object] = lambda *_: None,
) -> int:
    """Append the descriptions that a file lacks, a line a picture; return how many it has.

    Raises `DatasetError`.
    """
    pairs = [
        sequence.pairs[frame]
        for sequence in read_recording(recording)
        for frame in sequence.askable()
    ]
    known = read_descriptions(file) if file.exists() else {}
    left = [each for each in pairs if each.name not in known]
    done = len(pairs) - len(left)
    for begin in range(0, len(left), BATCH):
        part = left[begin : begin + BATCH]
        texts = captioner.describe([read_picture(each.vehicle_image) for each in part])
        rows = [
            json.dumps({"picture": each.name, "description": text}) + "\n"
            for each, text in zip(part, texts, strict=True)
        ]
        with writing(file, DatasetError), file.open("a") as lines:
            lines.writelines(rows)
        progress(done + begin + len(part), len(pairs))
    return len(pairs)

"""Prompts and tokenizers of V2X-VLM."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from tokenizers import Tokenizer, decoders, models, pre_tokenizers, processors, trainers

from anchorflow_driving.geometry import into_frame
from anchorflow_models.v2x_vlm.config import BEGIN, END, PAD
from anchorflow_training.dataset import DatasetError

Array = NDArray[np.float64]

TASK = "Plan its path for 4.5 seconds."
UNTOLD = "Plan."
"""The prompt of a model that learns without text."""
NEAR = 40.0
"""m, within which others are described."""
STANDING = 0.3  # m/s


def prompt(*, speed: float, turn_rate: float, scene: str) -> str:
    """speed in m/s, turn_rate in rad/s to the left; scene: what a captioner says of it, or ''"""
    state = f"The ego vehicle drives at {max(speed, 0.0):.1f} m/s"
    if speed < STANDING:
        state = f"The ego vehicle stands at {max(speed, 0.0):.1f} m/s"
    elif abs(turn_rate) >= 0.02:
        side = "left" if turn_rate > 0 else "right"
        state += f", turning {side} by {abs(turn_rate):.2f} rad/s"
    return " ".join(part for part in (scene, f"{state}.", TASK) if part)


def seen_scene(boxes: Array, pose: Array) -> str:
    """How many others there are near a pose [3], of boxes [n,5], and where the nearest ahead is."""
    local = into_frame(boxes[:, :2], pose)
    near = local[np.linalg.norm(local, axis=1) < NEAR]
    if not len(near):
        return "No other vehicle is near."
    others = f"{len(near)} other vehicle" + ("s are near" if len(near) > 1 else " is near")
    ahead = near[(near[:, 0] > 0) & (np.abs(near[:, 1]) < 2.5)]
    if not len(ahead):
        return f"{others}."
    return f"{others}, one {ahead[:, 0].min():.0f} m ahead."


SPECIAL = ("<s>", "<pad>", "</s>", "<unk>")
"""Special tokens, in Florence-2's order."""
FILE_NAME = "tokenizer.json"


def read_descriptions(file: Path) -> dict[str, str]:
    """Texts by the names of pictures, of a file of `anchorflow data descriptions`.

    A line is `{"picture": "vehicle-side/image/000010.jpg", "description": "The image shows ..."}`.

    Raises `DatasetError`.
    """
    try:
        lines = file.read_text().splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise DatasetError(f"{file}: expected descriptions ({error})") from error
    return dict(_description(line, f"{file}: line {n}") for n, line in enumerate(lines, 1))


def _description(line: str, where: str) -> tuple[str, str]:
    try:
        row = json.loads(line)
        picture, text = row["picture"], row["description"]
    except (ValueError, KeyError, TypeError):
        picture = text = None
    if not isinstance(picture, str) or not isinstance(text, str):
        expected = "an object of picture and description, both texts"
        raise DatasetError(f"{where}: expected {expected}, found {line}")
    return picture, text


def train_tokenizer(texts: Iterable[str], *, vocabulary: int = 512) -> bytes:
    """The JSON of a byte-level BPE of at most `vocabulary` tokens; any text can be written in it.

    A digit is a token of its own, so that a number is read from its digits whatever they are.
    """
    tokenizer = Tokenizer(models.BPE())
    tokenizer.pre_tokenizer = pre_tokenizers.Sequence(
        [
            pre_tokenizers.Digits(individual_digits=True),
            pre_tokenizers.ByteLevel(add_prefix_space=False),
        ]
    )
    tokenizer.decoder = decoders.ByteLevel()
    trainer = trainers.BpeTrainer(
        vocab_size=vocabulary,
        special_tokens=list(SPECIAL),
        initial_alphabet=pre_tokenizers.ByteLevel.alphabet(),
        show_progress=False,
    )
    tokenizer.train_from_iterator(texts, trainer)
    tokenizer.post_processor = processors.TemplateProcessing(
        single="<s> $A </s>", special_tokens=[("<s>", BEGIN), ("</s>", END)]
    )
    return tokenizer.to_str().encode()


def read_tokenizer(path: Path) -> bytes:
    """The bytes of a tokenizer's file, or of the one in a folder. Raises `DatasetError`."""
    file = path / FILE_NAME if path.is_dir() else path
    try:
        data = file.read_bytes()
        opened(data)
    except Exception as error:  # the library's own exceptions are plain `Exception`s
        raise DatasetError(f"{file}: expected a tokenizer ({error})") from error
    return data


def opened(data: bytes) -> Tokenizer:
    """A tokenizer of its JSON."""
    return Tokenizer.from_str(data.decode())


def token_rows(
    tokenizer: Tokenizer, texts: Sequence[str], *, most: int
) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Tokens [B,L] and where there are any [B,L].

    Raises `DatasetError` if a text has more tokens than `most`.
    """
    rows = [tokenizer.encode(text).ids for text in texts]
    longest = max(map(len, rows))
    if longest > most:
        raise DatasetError(f"expected prompts of at most {most} tokens, found one of {longest}")
    tokens = np.full((len(rows), longest), PAD, np.int64)
    for row, ids in zip(tokens, rows, strict=True):
        row[: len(ids)] = ids
    return tokens, np.arange(longest) < np.array([len(ids) for ids in rows])[:, None]

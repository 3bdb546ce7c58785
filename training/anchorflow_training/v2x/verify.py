"""What is missing from, or wrong with, a cooperative recording."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from anchorflow_training.dataset import DatasetError
from anchorflow_training.v2x.boxes import read_boxes
from anchorflow_training.v2x.recording import (
    COOPERATIVE,
    FUTURE,
    INFO,
    VEHICLE,
    Pair,
    Sequence,
    read_recording,
    told,
)

BROKEN = (OSError, ValueError, SyntaxError, Image.DecompressionBombError)
THUMB = 8
"""The share of a JPEG's pixels, along a side, at which it is decoded to see whether it is whole."""


@dataclass(frozen=True)
class Verdict:
    """faults: each names a file; a recording without one can be trained on"""

    faults: tuple[str, ...]
    sequences: int
    frames: int
    pairs: int
    askable: int

    @property
    def lines(self) -> list[str]:
        """The faults and, at the end, what there is."""
        what = f"{self.sequences} sequences, {self.frames} frames, {self.pairs} pairs"
        return [*self.faults, f"{what}; {self.askable} can be asked about"]


def verify_recording(
    folder: Path, *, progress: Callable[[int, int], object] = lambda *_: None
) -> Verdict:
    """Everything that V2X-VLM reads of a recording, read once.

    progress: hears how many pairs are looked at, and of how many
    """
    faults: list[str] = []

    def note(error: DatasetError) -> None:
        faults.append(str(error))

    sequences = read_recording(folder, fault=note)
    pairs = [pair for sequence in sequences for pair in sequence.pairs.values()]
    for number, pair in enumerate(pairs):
        for check in (_check_pictures, _check_label):
            with told(note):
                check(pair)
        progress(number + 1, len(pairs))
    askable = sum(len([*sequence.askable()]) for sequence in sequences)
    if not askable and not faults:
        faults.append(_nothing_askable(folder, sequences))
    return Verdict(
        tuple(faults),
        len(sequences),
        sum(len(sequence.times) for sequence in sequences),
        len(pairs),
        askable,
    )


def read_picture(file: Path, *, thumb: bool = False) -> NDArray[np.uint8]:
    """Pixels [3,H,W], RGB; of a thumb far fewer. Raises `DatasetError`."""
    try:
        with Image.open(file) as picture:
            if thumb:
                picture.draft("RGB", tuple(max(1, side // THUMB) for side in picture.size))
            pixels = np.asarray(picture.convert("RGB"))
    except BROKEN as error:
        raise DatasetError(f"{file}: expected a picture ({error})") from error
    return np.ascontiguousarray(pixels.transpose(2, 0, 1))


def _check_pictures(pair: Pair) -> None:
    for file in (pair.vehicle_image, pair.infrastructure_image):
        read_picture(file, thumb=True)


def _check_label(pair: Pair) -> None:
    read_boxes(pair.label)


def _nothing_askable(folder: Path, sequences: list[Sequence]) -> str:
    if not any(sequence.pairs for sequence in sequences):
        return f"{folder / COOPERATIVE / INFO}: expected pairs, found none"
    sizes = Counter({sequence.name: len(sequence.times) for sequence in sequences})
    name, longest = sizes.most_common(1)[0]
    return (
        f"{folder / VEHICLE / INFO}: expected a pair with a frame before it and {FUTURE} after it, "
        f"0.1 s apart; the longest batch_id, {name}, has {longest} frames"
    )

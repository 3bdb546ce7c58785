"""Pairs to train on: pictures resized once, waypoints, prompts and boxes, in a folder.

N pairs that can be asked about, of sequences with F frames in all; S pixels along a side:

    vehicle_image         uint8   [N, 3, S, S]
    infrastructure_image  uint8   [N, 3, S, S]
    waypoints             float32 [N, 45, 2]   m ahead and to the left, of the rear axle
    speed                 float32 [N]          m/s, of the frame before to this one
    sequence              int32   [N]          a number in `names`
    frame                 int32   [N]          a row of `poses`
    poses                 float64 [F, 3]       of the rear axle in the world
    boxes                 float64 [M, 5]       x, y, heading, length, width in the world
    box_offsets           int64   [F + 1]      those of the k-th frame
    dataset.json          names, held_out, prompts, image_size, format
    tokenizer.json
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anchorflow_client.sensors import resized
from anchorflow_driving.cooperative.layout import GROUP
from anchorflow_driving.errors import UNREADABLE
from anchorflow_driving.geometry import into_frame
from anchorflow_training.dataset import DatasetError, reserve, write_meta
from anchorflow_training.v2x.recording import (
    FUTURE,
    Sequence,
    read_boxes,
    read_picture,
    read_recording,
    without_own,
)
from anchorflow_training.v2x.text import (
    FILE_NAME,
    UNTOLD,
    opened,
    prompt,
    read_descriptions,
    seen_scene,
    train_tokenizer,
)

Array = NDArray[Any]

FORMAT = "v2x pairs 1"
META = "dataset.json"
ARRAYS: Mapping[str, str] = {
    "vehicle_image": "uint8",
    "infrastructure_image": "uint8",
    "waypoints": "float32",
    "speed": "float32",
    "sequence": "int32",
    "frame": "int32",
    "poses": "float64",
    "boxes": "float64",
    "box_offsets": "int64",
}
SIDES = "vehicle_image", "infrastructure_image"
TOLD = (
    ("image_size", int, "a whole number"),
    *((name, list, "a list") for name in ("names", "held_out", "prompts")),
)
"""Required entries of META beside the format."""
IN_SIGHT = 60.0
"""m, within which the pictures may show another."""
HELD_OUT = 0.2
"""The share of the sequences that is kept from training."""


@dataclass(frozen=True, eq=False)
class PairDataset:
    """A folder of pairs, its arrays memory-mapped."""

    path: Path
    arrays: Mapping[str, Array]
    meta: Mapping[str, Any]
    tokenizer: bytes

    def __len__(self) -> int:
        return len(self.arrays["waypoints"])

    @property
    def prompts(self) -> list[str]:
        """One a pair."""
        return self.meta["prompts"]

    @property
    def vocabulary(self) -> int:
        return opened(self.tokenizer).get_vocab_size()

    def indices(self, *, held_out: bool) -> NDArray[np.int64]:
        """The pairs of the sequences that are held out, or of the others."""
        names = self.meta["names"]
        kept = [number for number, name in enumerate(names) if name in self.meta["held_out"]]
        return np.flatnonzero(np.isin(self.arrays["sequence"], kept) == held_out)

    def boxes_of(self, row: int) -> Array:
        """[n,5] of a frame, by its row of `poses`."""
        begin, end = self.arrays["box_offsets"][row : row + 2]
        return np.asarray(self.arrays["boxes"][begin:end])

    def nearest_others(self, indices: NDArray[np.integer]) -> NDArray[np.float32]:
        """[N,3] of pairs: 1 and x, y [m] in the ego's frame of the nearest box; or 0s."""
        nearest = np.zeros((len(indices), 3), np.float32)
        for row, index in zip(nearest, indices, strict=True):
            frame = int(self.arrays["frame"][index])
            boxes = self.boxes_of(frame)
            if not len(boxes):
                continue
            local = into_frame(boxes[:, :2], np.asarray(self.arrays["poses"][frame]))
            away = np.linalg.norm(local, axis=1)
            if away.min() < IN_SIGHT:
                row[:] = 1.0, *local[away.argmin()]
        return nearest


def make_pairs(
    recording: Path,
    out: Path,
    *,
    image_size: int,
    tokenizer: bytes | None = None,
    describe: bool = False,
    descriptions: Path | None = None,
    seed: int = 0,
    progress: Callable[[int, int], object] = lambda *_: None,
) -> PairDataset:
    """Write the pairs of a recording.

    image_size: S; the published 768 takes 3.5 MB a pair
    tokenizer: its JSON; None: a small one is trained on the prompts
    describe: whether prompts describe the boxes around, as a perception would
    descriptions: file of what the car's pictures show, by `anchorflow data descriptions`
    seed: of which sequences are held out

    Raises `DatasetError`, naming the file that is wrong, or the folder that is there already or
    cannot be written.
    """
    if out.exists() and any(out.iterdir()):
        raise DatasetError(f"{out}: expected a new or an empty folder, found files")
    sequences = read_recording(recording)
    scene_of = _scenes(describe=describe, descriptions=descriptions)
    asked = [(number, frame) for number, each in enumerate(sequences) for frame in each.askable()]
    present = [sequences[number].name for number in sorted({number for number, _ in asked})]
    if len({_group(name) for name in present}) < 2:
        what = f"pairs with {FUTURE} frames after them in two sequences or more, of different logs"
        raise DatasetError(f"{recording}: expected {what}, found {len(asked)} in fewer")
    prompts = [_prompt(sequences[number], frame, scene_of) for number, frame in asked]
    shape = (len(asked), 3, image_size, image_size)
    with _writing(out):
        out.mkdir(parents=True, exist_ok=True)
        pictures = {side: _picture_array(out / f"{side}.npy", shape) for side in SIDES}
    for index, (number, frame) in enumerate(asked):
        pair = sequences[number].pairs[frame]
        for side, array in pictures.items():
            array[index] = resized(read_picture(getattr(pair, side)), image_size)
        progress(index + 1, len(asked))
    driven = _driven(sequences, asked)
    words = tokenizer or train_tokenizer([*prompts, UNTOLD])
    with _writing(out):
        for name, values in driven.items():
            np.save(out / f"{name}.npy", np.asarray(values, ARRAYS[name]))
        (out / FILE_NAME).write_bytes(words)
    meta = {
        "format": FORMAT,
        "image_size": image_size,
        "names": [sequence.name for sequence in sequences],
        "held_out": _held_out(present, seed),
        "prompts": prompts,
    }
    write_meta(out, meta)
    return open_pairs(out)


@contextmanager
def _writing(out: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise DatasetError(f"{out}: expected a folder to write to ({error})") from error


def _picture_array(file: Path, shape: tuple[int, ...]) -> Array:
    array = np.lib.format.open_memmap(file, "w+", np.uint8, shape)
    reserve(file)
    return array


def refuse_pairs(path: Path) -> None:
    """Raises `DatasetError` of a folder of pairs, where scenes are expected."""
    try:
        meta = json.loads((path / META).read_text())
    except (OSError, ValueError):
        return  # opening it will report what is wrong
    if isinstance(meta, dict) and meta.get("format") == FORMAT:
        raise DatasetError(
            f"{path}: expected a dataset of scenes, found pairs of pictures, of which "
            "--planner v2x_vlm learns"
        )


def open_pairs(path: Path) -> PairDataset:
    """The pairs of a folder. Raises `DatasetError` naming the file that is wrong."""
    file = path / META
    try:
        meta = json.loads(file.read_text())
        found = meta["format"]
    except (OSError, ValueError, KeyError, TypeError) as error:
        what = "a folder of `anchorflow data pairs`"
        raise DatasetError(f"{file}: expected {what} ({error!r})") from error
    if found != FORMAT:
        raise DatasetError(f"{file}: format: expected {FORMAT!r}, found {found!r}")
    for name, kind, expected in TOLD:
        if not isinstance(meta.get(name), kind):
            raise DatasetError(f"{file}: {name}: expected {expected}, found {meta.get(name)!r}")
    arrays = {name: _array(path / f"{name}.npy", dtype) for name, dtype in ARRAYS.items()}
    try:
        tokenizer = (path / FILE_NAME).read_bytes()
    except OSError as error:
        raise DatasetError(f"{path / FILE_NAME}: {error.strerror}") from error
    return PairDataset(path, arrays, meta, tokenizer)


def _array(file: Path, dtype: str) -> Array:
    try:
        array = np.load(file, mmap_mode="r")
    except UNREADABLE as error:
        raise DatasetError(f"{file}: {error}") from error
    if array.dtype != dtype:
        raise DatasetError(f"{file}: expected {dtype}, found {array.dtype}")
    return array


def _held_out(names: list[str], seed: int) -> list[str]:
    """A fifth of the sequences, at least one; those of one simulated log stay together."""
    groups = sorted({_group(name) for name in names})
    order = np.random.default_rng([seed, 2]).permutation(len(groups))
    kept = {groups[number] for number in order[: max(1, round(HELD_OUT * len(groups)))]}
    return [name for name in names if _group(name) in kept]


def _group(name: str) -> str:
    """The simulated log of a sequence; of any other the sequence itself."""
    return name.partition(GROUP)[0]


def _prompt(sequence: Sequence, frame: int, scene_of: Callable[[Sequence, int], str]) -> str:
    speed, turn_rate = sequence.speed(frame), sequence.turn_rate(frame)
    return prompt(speed=speed, turn_rate=turn_rate, scene=scene_of(sequence, frame))


def _scenes(*, describe: bool, descriptions: Path | None) -> Callable[[Sequence, int], str]:
    """What a prompt says of the scene of a frame: a picture's description, the boxes, or ''."""
    texts = {} if descriptions is None else read_descriptions(descriptions)

    def scene(sequence: Sequence, frame: int) -> str:
        pair, pose, parts = sequence.pairs[frame], sequence.poses[frame], []
        if descriptions is not None:
            if pair.name not in texts:
                expected = f"a description of {pair.name}"
                raise DatasetError(f"{descriptions}: expected {expected}, found none")
            parts.append(texts[pair.name])
        if describe:
            parts.append(seen_scene(without_own(read_boxes(pair.label), pose), pose))
        return " ".join(parts)

    return scene


def _driven(sequences: list[Sequence], asked: list[tuple[int, int]]) -> dict[str, Any]:
    """The arrays that are no pictures, of pairs by their sequence and the frame in it."""
    rows = np.cumsum([0, *(len(sequence.times) for sequence in sequences)])
    return {
        "waypoints": [sequences[number].waypoints(frame) for number, frame in asked],
        "speed": [sequences[number].speed(frame) for number, frame in asked],
        "sequence": [number for number, _ in asked],
        "frame": [rows[number] + frame for number, frame in asked],
        "poses": np.concatenate([sequence.poses for sequence in sequences]),
        **_boxes(sequences),
    }


def _boxes(sequences: list[Sequence]) -> dict[str, Array]:
    """Boxes and offsets; the vehicle's own box is left out."""
    boxes, counts = [np.zeros((0, 5))], [0]
    for sequence in sequences:
        for frame, pose in enumerate(sequence.poses):
            file = sequence.label_of(frame)
            own = np.zeros((0, 5)) if file is None else without_own(read_boxes(file), pose)
            boxes.append(own)
            counts.append(len(own))
    return {"boxes": np.concatenate(boxes), "box_offsets": np.cumsum(counts)}

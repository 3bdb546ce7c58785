"""Pairs of a teacher on disk: where its ODE carries each noise, made once and read by every run.

A folder of blocks of BLOCK scenes, each written whole or not at all, so that making them may stop
and go on at any time:

    pairs.json   what the pairs are of
    00000.npy    float16 [scenes, N, T, S], normalised states at t = 1

The noise is not stored: it follows from the seed and the scene's number.
"""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from anchorflow_driving.errors import UNREADABLE
from anchorflow_training.dataset import SceneDataset
from anchorflow_training.distillation.config import TeacherConfig
from anchorflow_training.distillation.teacher import Teacher
from anchorflow_training.settings import ConfigError
from anchorflow_training.whole_file import whole_file

FloatArray = NDArray[np.float32]

BLOCK = 64  # scenes a file
FORMAT = 1
DESCRIPTION = "pairs.json"
ASKED = ("cost_map", "map_geometry", "x_curr", "x_goal", "w_style", "limits", "route_states")
"""Arrays of a dataset that decide what a teacher makes of a scene."""


@dataclass(frozen=True)
class PairBank:
    """The folder of one teacher's pairs.

    description: what the pairs are of
    rank: R, numbers of noise
    """

    path: Path
    description: Mapping[str, Any]
    rank: int

    @property
    def scenes(self) -> int:
        """First scenes of the dataset that have pairs."""
        return self.description["scenes"]

    @property
    def samples(self) -> int:
        """N, pairs a scene."""
        return self.description["pairs"]

    def noise(self, scene: int) -> FloatArray:
        """Standard normal noise of a scene's pairs, [N, R]."""
        generator = np.random.default_rng([self.description["seed"], scene])
        return generator.standard_normal((self.samples, self.rank), dtype=np.float32)

    def ends(self, scene: int) -> FloatArray:
        """Normalised states at t = 1 of a scene's pairs, [N, T, S]."""
        block, row = divmod(scene, BLOCK)
        return self._blocks[block][row].astype(np.float32)

    def begin(self) -> None:
        """Make the folder, where there is none; raises `ConfigError` where it has no place."""
        if not (self.path / DESCRIPTION).exists():
            text = json.dumps(self.description, indent=2) + "\n"
            self._put(self.path / DESCRIPTION, text.encode())

    def missing(self) -> list[int]:
        """Blocks that are not made yet, or not whole."""
        return [block for block in range(self.blocks) if not self._is_whole(block)]

    @property
    def blocks(self) -> int:
        return -(-self.scenes // BLOCK)

    def scenes_of(self, block: int) -> range:
        return range(block * BLOCK, min(self.scenes, (block + 1) * BLOCK))

    def file(self, block: int) -> Path:
        return self.path / f"{block:05d}.npy"

    def write(self, block: int, ends: NDArray[np.float16]) -> None:
        """Put a block's [scenes, N, T, S] in its place; raises `ConfigError` where it has none."""
        packed = io.BytesIO()
        np.save(packed, ends)
        self._put(self.file(block), packed.getbuffer())

    def _put(self, path: Path, content: bytes | memoryview) -> None:
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            with whole_file(path) as file:
                file.write(content)
        except OSError as error:
            raise ConfigError(f"{path}: expected a place to write ({error})") from error

    def _is_whole(self, block: int) -> bool:
        try:
            shape = self._mapped(block).shape
        except UNREADABLE:
            return False
        return shape[:2] == (len(self.scenes_of(block)), self.samples)

    def _mapped(self, block: int) -> NDArray[np.float16]:
        return np.lib.format.open_memmap(self.file(block), mode="r")

    @cached_property
    def _blocks(self) -> list[NDArray[np.float16]]:
        return [self._mapped(block) for block in range(self.blocks)]


def open_pairs(
    path: Path, teacher: Teacher, dataset: SceneDataset, config: TeacherConfig
) -> PairBank:
    """The pairs of this teacher on these scenes, which `path` holds or is to hold.

    Raises:
        ConfigError: the pairs that are there are others; the message says in what.
    """
    scenes = min(config.scenes or len(dataset), len(dataset))
    wanted = {
        "format": FORMAT,
        "teacher": teacher.sha256,
        "dataset": _fingerprint(dataset, scenes),
        "scenes": scenes,
        "pairs": config.pairs,
        "seed": config.seed,
        "noise_scale": config.noise_scale,
        "method": config.method,
        "steps": config.steps,
    }
    file = path / DESCRIPTION
    if file.exists():
        _check_same(file, wanted)
    return PairBank(path, wanted, teacher.model.prior.rank)


def _fingerprint(dataset: SceneDataset, scenes: int) -> str:
    """Of what a teacher is asked on the scenes."""
    digest = hashlib.sha256()
    for name in ASKED:
        digest.update(np.ascontiguousarray(dataset.arrays[name][:scenes]).data)
    return digest.hexdigest()


def _check_same(file: Path, wanted: Mapping[str, Any]) -> None:
    try:
        found = json.loads(file.read_text())
    except (OSError, ValueError) as error:
        raise ConfigError(f"{file}: {error}") from error
    if not isinstance(found, dict):
        raise ConfigError(f"{file}: expected an object, found {found}")
    for name, asked in wanted.items():
        if found.get(name) != asked:
            raise ConfigError(
                f"{file}: {name}: expected {asked}, as asked for, found {found.get(name)}; "
                "another folder begins new pairs"
            )

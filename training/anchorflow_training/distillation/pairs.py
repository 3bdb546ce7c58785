"""Pairs of noise and the teacher's answer on disk, made once and read by every run.

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
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from numpy.typing import NDArray

from anchorflow_client.contract import uniform_schedule
from anchorflow_driving.errors import UNREADABLE
from anchorflow_models.flow_matching import LossWeights
from anchorflow_training.atomic_write import atomic_write, writing
from anchorflow_training.batches import (
    Batch,
    FlowBatchConfig,
    batch_rng,
    batch_scenes,
    dealt_routes,
    encode_inputs,
    mirror,
    prior_means,
    reflection,
)
from anchorflow_training.config import CostMapRunConfig
from anchorflow_training.dataset import SceneDataset
from anchorflow_training.distillation.objective import NormalisedFlow, started
from anchorflow_training.distillation.teacher import Teacher
from anchorflow_training.settings import ConfigError, other_default, setting
from anchorflow_trajectory.motion import MotionLimits
from anchorflow_trajectory.ode.methods import method_named
from anchorflow_trajectory.ode.schedule import check_schedule
from anchorflow_trajectory.routes.splines import LEAST_WAY


@dataclass(frozen=True)
class TeacherConfig:
    """How the teacher is asked: its noise, and the solver that makes pairs."""

    noise_scale: float = setting(1.0, "Spread of the noise, as its bundle is exported.", gt=0)
    method: Literal["euler", "midpoint", "heun", "rk4", "ab2"] = setting(
        "midpoint", "Solver that makes pairs."
    )
    steps: int = setting(8, "Equal steps of that solver.", ge=1)
    pairs: int = setting(16, "Pairs a scene.", ge=1)
    scenes: int = setting(0, "First scenes of the dataset to make pairs on; 0: all.", ge=0)
    seed: int = setting(0, "Of the pairs' noise.", ge=0)


@dataclass(frozen=True)
class DistillConfig(CostMapRunConfig):
    """A run that teaches a student of FlowMP what a teacher does in many evaluations.

    schedule: flow times from 0 to 1; the student takes an Euler step from each to the next

    Raises `ValueError` if the schedule does not rise from 0 to 1.
    """

    method: Literal["reflow", "direct", "consistency"] = setting(
        "direct", "What the student learns; docs/distillation.md."
    )
    schedule: tuple[float, ...] = setting((0.0, 1.0), "Flow times of its Euler steps, from 0 to 1.")
    steps: int = other_default(CostMapRunConfig, "steps", 4000)
    learning_rate: float = other_default(CostMapRunConfig, "learning_rate", 5e-4)
    warmup: int = other_default(CostMapRunConfig, "warmup", 200)
    at_schedule: float = setting(
        0.5, "reflow: share of samples at the schedule's own times.", ge=0, le=1
    )
    cost_weight: float = setting(
        0.0, "direct: of log(1 + J), J the cost that the finish begins with.", ge=0
    )
    cost_margin: float = setting(
        0.1, "direct: m of clearance that J asks for, as the finish does.", ge=0
    )
    intervals: int = setting(8, "consistency: intervals that [0, 1] is cut into.", ge=1)
    weights: LossWeights = field(default_factory=LossWeights)
    teacher: TeacherConfig = field(default_factory=TeacherConfig)

    def __post_init__(self) -> None:
        if check_schedule(self.schedule)[0] != 0.0:
            raise ValueError(f"schedule: expected its first time to be 0, got {self.schedule}")


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
        """Create the folder if it is missing; raise `ConfigError` if it cannot be written."""
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
        with writing(path, ConfigError):
            path.parent.mkdir(parents=True, exist_ok=True)
            with atomic_write(path) as file:
                file.write(content)

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

    Raises `ConfigError` if the pairs that are there are others; the message says in what.
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
    """Return the digest of the arrays that the teacher's answers depend on."""
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


Progress = Callable[[int, int], None]

CHUNK = 8  # scenes solved at a time


def make_pairs(
    bank: PairBank,
    blocks: Sequence[int],
    *,
    teacher: Teacher,
    dataset: SceneDataset,
    config: TeacherConfig,
    progress: Progress = lambda *_: None,
) -> None:
    """Solve and write some blocks of a bank.

    progress: called with the blocks that are done and all of them
    """
    for done, block in enumerate(blocks, 1):
        scenes = np.array(bank.scenes_of(block))
        parts = [
            _ends(bank, scenes[start : start + CHUNK], teacher, dataset, config)
            for start in range(0, len(scenes), CHUNK)
        ]
        bank.write(block, np.concatenate(parts))
        progress(done, len(blocks))


def _ends(
    bank: PairBank,
    scenes: NDArray[np.int64],
    teacher: Teacher,
    dataset: SceneDataset,
    config: TeacherConfig,
) -> NDArray[np.float16]:
    """[scenes, N, T, S]"""
    model, batch = teacher.model, dataset.batch(scenes)
    device = model.prior.spread.device
    inputs = {n: torch.from_numpy(array).to(device) for n, array in encode_inputs(batch).items()}
    mean = torch.from_numpy(prior_means(batch, dealt_routes(batch, bank.samples))).to(device)
    noise = np.stack([bank.noise(int(scene)) for scene in scenes])
    with torch.no_grad():
        z_0 = started(model, torch.from_numpy(noise).to(device), inputs["limits"])
        z_1 = NormalisedFlow.of(model, inputs, mean).carried(
            z_0, schedule=uniform_schedule(config.steps), method=method_named(config.method)
        )
    return z_1.half().cpu().numpy()


@dataclass(frozen=True, eq=False)
class PairBatches:
    """starts: [R, T, S], the normalised state of each unit of noise"""

    dataset: SceneDataset
    bank: PairBank
    starts: FloatArray
    config: FlowBatchConfig

    def draw(self, index: int) -> Batch:
        """Batch number `index`: the inputs of encode; PAIRED.

        z_0, z_1, prior_mean: [B, N, T, S]; reference_s: [B] s, as of `Scene`

        Half of the batches are reflected, as in the teacher's training, where `mirror` says so.
        """
        scenes = batch_scenes(self.bank.scenes, self.config, index)
        rng = batch_rng(self.config, index)
        mirrored = bool(rng.random() < 0.5 and self.config.mirror)
        samples = self.bank.samples
        # Some of a scene's pairs, again where it has fewer than a batch wants.
        picked = np.stack(
            [np.resize(rng.permutation(samples), self.config.samples) for _ in scenes]
        )
        noise = np.stack([self.bank.noise(int(scene)) for scene in scenes])
        ends = np.stack([self.bank.ends(int(scene)) for scene in scenes])
        z_0 = np.tensordot(np.take_along_axis(noise, picked[..., None], 1), self.starts, 1)
        z_1 = np.take_along_axis(ends, picked[..., None, None], 1)
        batch = self.dataset.batch(scenes)
        z_0[..., -1] *= (batch["limits"][:, 3] <= 0)[:, None, None]
        if mirrored:
            mirror(batch)
            signs = np.append(reflection(self.dataset.dim, fields=3), np.float32(1.0))
            z_0, z_1 = z_0 * signs, z_1 * signs
        route = np.take_along_axis(dealt_routes(batch, samples), picked, 1)
        return encode_inputs(batch) | {
            "z_0": z_0,
            "z_1": z_1,
            "prior_mean": prior_means(batch, route),
            "reference_s": reference_times(batch),
        }


def reference_times(batch: Batch) -> FloatArray:
    """[B] s in which each scene's shortest route can be driven, by the length of its spline."""
    places = batch["route_states"][:, 0, :, :2]
    ways = np.linalg.norm(np.diff(places, axis=1), axis=-1).sum(-1)
    times = [
        MotionLimits(v_max, a_max).least_time(max(way, LEAST_WAY))
        for way, (v_max, a_max, *_) in zip(ways.tolist(), batch["limits"].tolist(), strict=True)
    ]
    return np.array(times, np.float32)

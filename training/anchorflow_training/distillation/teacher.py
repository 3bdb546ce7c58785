"""The teacher of a distillation, and the first weights of its student."""

from __future__ import annotations

import hashlib
from copy import deepcopy
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from anchorflow_models import L2Config, L2SafetyCFM
from anchorflow_models.layers.attention import CHUNKS
from anchorflow_training.checkpoint import Checkpoint, load_checkpoint, restore_flow
from anchorflow_training.settings import ConfigError
from anchorflow_trajectory.ode.schedule import Schedule


@dataclass(frozen=True, eq=False)
class Teacher:
    """A trained model that learns no more.

    sha256: of its checkpoint's file; step: at which that was written
    optimal_transport: whether noise and data were coupled in its training
    noise_scale: how wide the noise is drawn that it is asked with; 1: as in its training
    """

    model: L2SafetyCFM
    sha256: str
    step: int
    optimal_transport: bool = True
    noise_scale: float = 1.0

    @property
    def description(self) -> dict[str, Any]:
        """The entry in a student's checkpoint."""
        wider = {} if self.noise_scale == 1.0 else {"noise_scale": self.noise_scale}
        return {"sha256": self.sha256, "step": self.step, **wider}

    def widened(self, scale: float) -> Teacher:
        """The same teacher, which draws noise `scale` times as wide."""
        model = deepcopy(self.model)
        model.prior.widen(scale)
        return replace(self, model=model, noise_scale=scale * self.noise_scale)


def load_teacher(path: Path) -> Teacher:
    """The averaged weights of a checkpoint.

    Raises `CheckpointError` if it is no checkpoint of this version, or of another planner.
    """
    checkpoint = load_checkpoint(path)
    model = restore_flow(checkpoint).requires_grad_(False)
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    coupled = checkpoint.config.get("flow", {}).get("optimal_transport", True)
    return Teacher(model, digest, checkpoint.step, coupled)


# Settings that a student may choose; the others define an anchor.
OWN = (
    "variant",
    "map_size",
    "feature_channels",
    "steps_per_token",
    "backbone",
    "map_scales",
    "map_lookup",
    "map_attention",
    "layers",
)
BLOCKS, MODULATION = "transformer.blocks.", "transformer.to_modulation.1."


def check_student(student: L2Config, teacher: L2Config) -> None:
    """Raise `ConfigError` where the two would not answer the same request."""
    for name in (part.name for part in fields(student)):
        asked, found = getattr(student, name), getattr(teacher, name)
        if name not in OWN and asked != found:
            raise ConfigError(f"model.{name}: expected {found}, the teacher's, got {asked}")


def begin_as(student: L2SafetyCFM, teacher: L2SafetyCFM) -> None:
    """Give a student every weight of its teacher that fits; with the prior, the same noise.

    Of the teacher's blocks a student with fewer takes ones that are evenly spread, the first and
    the last among them.
    """
    known = _taken_over(teacher, student)
    own = student.state_dict()
    with torch.no_grad():
        for name, value in own.items():
            if name in known and known[name].shape == value.shape:
                value.copy_(known[name])


def student_schedule(checkpoint: Checkpoint) -> Schedule | None:
    """The flow times that FlowMP's student was taught to step over; None for any other network."""
    times = checkpoint.config.get("schedule") if checkpoint.teacher else None
    return tuple(times) if times else None


def kept_blocks(of: int, keep: int) -> list[int]:
    """Which of `of` blocks a student of `keep` takes: 4 to 2 is the first and the last."""
    return torch.linspace(0, of - 1, keep).round().long().tolist()


def _taken_over(teacher: L2SafetyCFM, student: L2SafetyCFM) -> dict[str, Tensor]:
    """The teacher's weights by the names that they have in the student."""
    known = dict(teacher.state_dict())
    configs = teacher.config, student.config
    if any(config.backbone != "transformer" for config in configs):
        return known
    of, keep = (config.size.layers for config in configs)
    if keep >= of:
        return known
    kept = kept_blocks(of, keep)
    blocks = {name: known.pop(name) for name in list(known) if name.startswith(BLOCKS)}
    for new, old in enumerate(kept):
        prefix = f"{BLOCKS}{old}."
        for name, value in blocks.items():
            if name.startswith(prefix):
                known[f"{BLOCKS}{new}.{name.removeprefix(prefix)}"] = value
    size = CHUNKS * teacher.config.size.width
    for name in (f"{MODULATION}weight", f"{MODULATION}bias"):
        *per_block, last = known[name].split([size] * of + [known[name].shape[0] - size * of])
        known[name] = torch.cat([*(per_block[old] for old in kept), last])
    return known

"""The teacher: a trained flow to learn from."""

from __future__ import annotations

import hashlib
from copy import deepcopy
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from anchorflow_models import L2SafetyCFM
from anchorflow_training.checkpoint import load_checkpoint
from anchorflow_training.restore import restore_flow


@dataclass(frozen=True, eq=False)
class Teacher:
    """A trained model that learns no more.

    sha256: of its checkpoint's file; step: at which that was written
    optimal_transport: whether noise and data were paired in its training
    noise_scale: how wide the noise is drawn that it is asked with; 1: as in its training
    """

    model: L2SafetyCFM
    sha256: str
    step: int
    optimal_transport: bool = True
    noise_scale: float = 1.0

    @property
    def description(self) -> dict[str, Any]:
        """What a student's checkpoint says of it."""
        wider = {} if self.noise_scale == 1.0 else {"noise_scale": self.noise_scale}
        return {"sha256": self.sha256, "step": self.step, **wider}

    def widened(self, scale: float) -> Teacher:
        """The same teacher, which draws noise `scale` times as wide."""
        model = deepcopy(self.model)
        model.prior.widen(scale)
        return replace(self, model=model, noise_scale=scale * self.noise_scale)


def load_teacher(path: Path) -> Teacher:
    """The averaged weights of a checkpoint.

    Raises:
        CheckpointError: it is no checkpoint of this version, or of another planner.
    """
    checkpoint = load_checkpoint(path)
    model = restore_flow(checkpoint).requires_grad_(False)
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    paired = checkpoint.config.get("flow", {}).get("optimal_transport", True)
    return Teacher(model, digest, checkpoint.step, paired)

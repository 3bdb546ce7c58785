"""What a generator answers."""

from __future__ import annotations

from dataclasses import dataclass, fields

from torch import Tensor


@dataclass(frozen=True, eq=False)
class AnchorTensors:
    """N anchors of a scene in SI and the map's frame, on the model's device.

    A B axis leads where scenes were batched.

    trajectories, velocities, accelerations: [N, T, D] in m, m/s, m/s^2
    scores: [N], minus the expert's cost for the style; higher is better
    clearance: [N] m beyond the robot's radius, smallest along the path
    safe: [N] bool: the clearance was looked up along the whole path and found sufficient, and
        speed and acceleration keep their limits
    durations: [N] s from the first to the last time step
    """

    trajectories: Tensor
    velocities: Tensor
    accelerations: Tensor
    scores: Tensor
    clearance: Tensor
    safe: Tensor
    durations: Tensor

    def scene(self, index: int) -> AnchorTensors:
        """The anchors of one scene of a batch."""
        return AnchorTensors(*(getattr(self, field.name)[index] for field in fields(self)))
